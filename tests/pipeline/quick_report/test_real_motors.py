"""The quick report at real logs, on small synthetic ones: what made them is told, whatever is known of their loads."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motorprior.pipeline.quick_report.findings import Errors
from motorprior.report.real_motor_tables import CONSTANT, FREE_RUN, RMSE, constant_table, error_rows, from_tensors

from motorprior.artifacts import read_tensors
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS, record
from motorprior.identification.baselines import response_fit
from motorprior.identification.judging import fit_quality
from motorprior.logs.formats.parquet_io import read_parquet, write_log
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.pipeline.demo import Demo, that_walks
from motorprior.pipeline.quick_report.real_motors import (
    TRACES,
    RealMotors,
    _loads,
    read_logs_of,
    run_real_motors,
)
from motorprior.report.page import page
from motorprior.report.real_motors import real_motors
from motorprior.results import Results
from motorprior.robots.load import load_robot

JOINTS = ("hip", "knee", "ankle")


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder with two logs of the same three motors of fleet ``mixed``, their loads known."""
    fleet = load_fleet("mixed")
    motors = fleet.sample(len(JOINTS), np.random.default_rng(5))
    for seed, name in enumerate(("first", "second")):
        log = record(motors, PRESETS["rollout"], 6000, seed, fleet)
        write_log(tmp_path / "logs" / f"{name}.parquet", replace(log, joint_names=JOINTS, joint_torque=None))
    return tmp_path / "logs"


def looked_at(logs: Path, out: Path, fleet: str | None = None) -> tuple[Results, list[str]]:
    said: list[str] = []
    found = run_real_motors(RealMotors(logs, out, fleet=fleet), show=lambda results, lines: said.extend(lines))
    return found, said


def test_the_prior_is_nearer_to_the_motors_than_a_pd(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fit_quality, "MISSING", -1.0)  # even the best fit is warned of
    out = tmp_path / "run" / "real_motors"
    found, said = looked_at(logs, out, "mixed")
    for quantity in (RMSE, FREE_RUN):
        prior, pd = (
            found.value(quantity=quantity, model=model, part=None, log=None) for model in ("prior", "tuned_pd")
        )
        assert prior < 0.4 * pd
    assert {row.part for row in found.where(quantity=f"{CONSTANT}kp", model=None)} == set(JOINTS)
    assert [row[0] for row in error_rows(found)] == [*JOINTS, "second", "mean"]
    assert any("armature" in row[0] for row in constant_table(found).rows)
    assert constant_table(found).columns[-2:] == ("fleet 5 %", "fleet 95 %")
    text = "\n".join(said)
    for words in (
        "the logs state them",
        "known: first; judged: second",
        "one tuned PD",
        "unlike the prior",
        "beside fleet 'mixed'",
        "of the PD's error is left",
    ):
        assert words in text
    assert from_tensors(*read_tensors(out / TRACES))[0].log == "second"
    html = page("t", real_motors(tmp_path / "run"), {}, "c")
    assert "Your motors" in html and html.count("<img") == 3
    before = (out / TRACES).stat().st_mtime_ns
    assert looked_at(logs, out, "mixed") == (found, said)
    assert (out / TRACES).stat().st_mtime_ns == before, "once"


def test_logs_without_loads_get_responses_and_a_line(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(response_fit, "GENERATIONS", 4)
    for path in sorted(logs.iterdir()):
        log = read_parquet(path)
        write_log(path, replace(log, load_inertia=None, external_torque=None))
    found, said = looked_at(logs, tmp_path / "out")
    assert set(found.where(quantity=RMSE).distinct("model")) == {"pure_delay", "second_order", "servo_limits"}
    assert any(line.startswith("loads: unknown, since no description") for line in said)
    assert any("bandwidth" in line for line in said)
    total = {row.model: row.value for row in found.where(quantity=RMSE, part=None, log=None)}
    assert total["second_order"] < total["pure_delay"]


ARM = """
name = "arm"
motor = "servo"
model = "arm.xml"
base = "fixed"
nominal_pose = 0.0
kp = 10.0
kd = 0.5
torque_limit = 3.0
"""
MODEL = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="hip" axis="0 1 0" range="-1 1" limited="true"/>
<body pos="0 0 -0.2"><inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>
<joint name="knee" axis="0 1 0" range="-1 1" limited="true"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> str:
    (tmp_path / "arm.toml").write_text(ARM, "utf-8")
    (tmp_path / "arm.xml").write_text(MODEL, "utf-8")
    return str(tmp_path / "arm.toml")


def stating(folder: Path, names: tuple[str, ...], *postures: str | None) -> Path:
    """A folder with a log of these joints for each posture, stated in all rows but the first, which was suspended."""
    log = a_log("a", [True] * len(names))
    for number, stated in enumerate(postures):
        codes = None if stated is None else np.array([1] + 49 * [POSTURES.index(stated)])
        write_log(folder / f"log_{number}.parquet", replace(log, joint_names=names, posture=codes))
    return folder


@pytest.mark.parametrize(
    ("postures", "told"),
    [
        (("suspended", "suspended"), "rigid body of pupper_v2, its base held"),
        (("suspended", None), r"unknown, since pupper_v2 may have stood on its feet \(set suspended"),
        (("suspended", "fixed"), "unknown, since pupper_v2 was fixed, as logs state"),
        (("standing", "fallen"), "unknown, since pupper_v2 was fallen and standing, as logs state"),
    ],
)
def test_a_free_base_is_held_where_every_row_says_that_it_suspended(
    tmp_path: Path, postures: tuple[str | None, ...], told: str
):
    robot = load_robot("pupper_v2")
    config = RealMotors(stating(tmp_path / "logs", robot.joint_names, *postures), tmp_path / "out")
    loads, why = _loads(config, read_logs_of(config).logs, robot)
    assert re.match(f"loads: {told}", why) and (loads is not None) == (set(postures) == {"suspended"})


def test_the_shipped_robot_walks_in_place_of_one_that_cannot(logs: Path, arm: str):
    given = Demo(robot=arm, logs=logs)
    assert that_walks(given) == replace(given, robot=Demo().robot)
    assert that_walks(Demo(robot=arm)).robot == arm, "without logs it is refused as it is"
    assert that_walks(Demo(logs=logs)) == Demo(logs=logs)


def a_log(name: str, moving: list[bool]) -> MotorLog:
    target = np.where(moving, np.linspace(0.0, 1.0, 50)[:, None], 0.0)
    return MotorLog(
        time=0.01 * np.arange(50), position_target=target, joint_pos=target, joint_names=JOINTS[:2], robot="r",
        motor="m", source=name,
    )  # fmt: skip


def test_joints_that_did_not_move_are_not_counted():
    logs = {"a": a_log("a", [True, False]), "b": a_log("b", [True, True])}
    found = {"a": {"prior": np.array([0.002, 9.0])}, "b": {"prior": np.array([0.004, 0.009])}}
    errors = Errors.of(logs, found)
    rows = errors.rows("e")
    assert rows.value(part=None, log=None) == pytest.approx(0.005)
    assert rows.value(part="knee") == pytest.approx(0.009) and rows.value(log="a") == pytest.approx(0.002)
    assert errors.worst("prior") == (1, 1) and errors.typical("prior") == (1, 0)
    assert "knee in b, 9.0 mrad off" in errors.unlike("prior")
