"""The quick report, on small synthetic logs with and without loads."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motor_logs import log_of
from weighed_arm import arm_table, slow_motion, write_arm

from motorprior.actuator.fleet import load_fleet
from motorprior.artifacts import read_json
from motorprior.bench.recording import BENCH_SCHEDULES, record
from motorprior.commands.demo import Demo, is_about_logs, run_demo
from motorprior.commands.quick_report import QuickReport, loads_of, read_logs_of, run_quick_report
from motorprior.evaluation.errors import FREE_RUN_RMSE, WHOLE_RUN_RMSE
from motorprior.logs.motor_log import POSTURES
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.report.page import page
from motorprior.report.sections import models_of_logs
from motorprior.results import Results
from motorprior.robots.load import load_robot

JOINTS = ("hip", "knee", "ankle")


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder with two logs of the same three motors of fleet ``mixed``, with their loads."""
    fleet = load_fleet("mixed")
    motors = fleet.sample(len(JOINTS), np.random.default_rng(5))
    for seed, name in enumerate(("first", "second")):
        log = record(motors, BENCH_SCHEDULES["rollout"], 6000, seed, fleet)
        log = replace(log, joint_names=JOINTS, joint_torque=None)
        write_log(tmp_path / "logs" / f"{name}.parquet", log)

    return tmp_path / "logs"


def report_of(logs: Path, out: Path) -> tuple[Results, dict[str, list]]:
    return run_quick_report(QuickReport(logs, out)), read_json(out / "notes.json")


def test_the_prior_has_a_smaller_error_than_a_tuned_pd_on_the_test_log(logs: Path, tmp_path: Path):
    out = tmp_path / "run"
    results, notes = report_of(logs, out)

    for quantity in (WHOLE_RUN_RMSE, FREE_RUN_RMSE):
        of_all_joints = results.where(quantity=quantity, part=None, log=None)
        assert of_all_joints.value(model="prior") < 0.4 * of_all_joints.value(model="tuned_pd")

    assert {"kp", "armature"} <= {row[0] for row in notes["constants"][1]}
    assert {"loads: from the log", "train: first; test: second"} <= set(notes["lines"])

    html = page("t", [models_of_logs(out, "Your motors", WHOLE_RUN_RMSE)], {}, "c")

    assert "Your motors" in html
    assert html.count("<img") == 2

    modified = (out / "traces.png").stat().st_mtime_ns

    assert report_of(logs, out) == (results, notes)
    assert (out / "traces.png").stat().st_mtime_ns == modified, "the report is made once"


def test_logs_without_loads_get_models_of_the_response(logs: Path, tmp_path: Path):
    for path in sorted(logs.iterdir()):
        log = read_parquet(path)
        write_log(path, replace(log, load_inertia=None, external_torque=None))

    results, notes = report_of(logs, tmp_path / "out")
    models = set(results.where(quantity=WHOLE_RUN_RMSE).distinct("model"))

    assert models == {"pure_delay", "second_order", "servo_limits"}
    assert any(line.startswith("loads: unknown") for line in notes["lines"])
    assert "bandwidth" in {row[0] for row in notes["constants"][1]}

    of_all_joints = results.where(quantity=WHOLE_RUN_RMSE, part=None, log=None)

    assert of_all_joints.value(model="second_order") < of_all_joints.value(model="pure_delay")


@pytest.mark.parametrize(
    "postures",
    [
        ("suspended", "suspended"),
        ("suspended", None),
        ("suspended", "fixed"),
        ("standing", "fallen"),
    ],
)
def test_loads_of_a_free_base_are_known_where_every_row_is_suspended(
    tmp_path: Path, postures: tuple[str | None, ...]
):
    robot = load_robot("pupper_v2")
    target = np.tile(np.linspace(0.0, 1.0, 50)[:, None], (1, robot.num_joints))
    log = log_of(0.01 * np.arange(50), target, joint_names=robot.joint_names)

    for number, posture in enumerate(postures):
        codes = None
        if posture is not None:  # the first row of every log is suspended
            codes = np.array([1] + 49 * [POSTURES.index(posture)])
        write_log(tmp_path / "logs" / f"log_{number}.parquet", replace(log, posture=codes))

    config = QuickReport(tmp_path / "logs", tmp_path / "out")
    source = loads_of(config, read_logs_of(config))

    assert (source.name == "model") == (set(postures) == {"suspended"})


@pytest.mark.slow
def test_a_demo_on_logs_of_an_arm_ends_after_their_motors(logs: Path, tmp_path: Path):
    out = tmp_path / "demo"
    demo = Demo(out, logs=logs, robot=write_arm(tmp_path), suspended=False)

    assert is_about_logs(demo)
    assert is_about_logs(Demo(logs=logs)), "the shipped robot has other joints"
    assert not is_about_logs(Demo(robot=demo.robot)), "without logs it is refused as it is"

    results = run_demo(demo)
    text = (out / "report.html").read_text("utf-8")

    assert results.where(quantity=WHOLE_RUN_RMSE)
    assert "armature" in text, "the constants stand on the page"
    assert not (out / "policies").exists()


def test_a_fixed_base_may_be_called_suspended_in_every_command(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot), tmp_path)
    config = QuickReport(table, tmp_path / "out", columns, robot=robot)
    sources = []
    for suspended in (False, True):
        stated = replace(config, suspended=suspended)
        sources.append(loads_of(stated, read_logs_of(stated)).name)

    assert sources == ["model", "model"]
