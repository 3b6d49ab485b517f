"""``motorprior calibrate`` from a log to a fleet that a bench takes; every command of docs/calibrate.md runs."""

import gzip
import json
import re
import shlex
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.cli.main import RUN, parse
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.posture import with_posture

ROOT = Path(__file__).resolve().parents[2]
BEGINNING, GO2 = (ROOT / "docs" / "calibrate.md").read_text("utf-8").split("\n## Another robot\n")
SMALL = ("--starts", "1", "--iterations", "1", "--draws", "3")


def commands(page: str) -> list[list[str]]:
    """The words of every `motorprior …` of a part of the page."""
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of one log per posture, 0.6 s each, of motors drawn from the shipped fleet."""
    folder = tmp_path_factory.mktemp("logs")
    motors = load_fleet("pupper_v2").sample(ROBOT.num_joints, 1).actuator()
    time = 0.002 * np.arange(300)
    targets = np.tile(ROBOT.nominal_pose, (len(time), 1))
    for joint in ROBOT.legs[0].joints[1:]:
        targets[:, joint] += 0.2 * np.sin(2.0 * np.pi * 2.0 * time)
    for name, hung in (("in_the_air", True), ("on_the_floor", False)):
        world = World(WorldConfig.of(ROBOT, physics_dt=0.001, control_dt=0.002, hung=hung))
        lead_in = np.tile(ROBOT.nominal_pose, (300, 1))
        measured = replay(world, motors, targets, ROBOT.nominal_pose, lead_in).measured_joint_pos
        log = MotorLog(
            time=time, position_target=targets, joint_pos=measured, joint_names=ROBOT.joint_names, robot=ROBOT.name,
            motor=ROBOT.motor, source=name, encoder=ROBOT.encoder,
        )  # fmt: skip
        write_log(folder / f"{name}.parquet", with_posture(log, "hung") if hung else log)
    return folder


def test_a_folder_of_logs_becomes_a_fleet_and_is_not_fitted_twice(motorprior, logs: Path, tmp_path: Path):
    out = tmp_path / "fitted"
    outcome = motorprior("calibrate", logs, "--out", out, *SMALL)
    assert outcome.code == 0, outcome.err
    assert "log in_the_air: hung, as the log states" in outcome.err
    assert "log on_the_floor: standing: replayed with" in outcome.err
    assert "identified" in outcome.out and "without this log" in outcome.out
    figures = json.loads((out / "figures.json").read_text("utf-8"))
    for model in ("start", "center", "left_out", "per_motor", "per_motor_left_out"):
        mean = np.mean([figures[f"calibrate_rmse/{log}/{model}"] for log in ("in_the_air", "on_the_floor")])
        assert figures[f"calibrate_rmse/{model}"] == pytest.approx(mean)
    assert {name.split("/")[1] for name in figures if name.startswith("calibrate_motor/")} == {"FR_hip", "FR_knee"}
    fleet = load_fleet(out / "fleet.toml")
    assert fleet.robot == ROBOT.name and fleet.parameters["kp"].center == pytest.approx(
        figures["calibrate_center/kp"], rel=1e-3
    )
    text = (out / "fleet.toml").read_text("utf-8")
    assert "the logs in_the_air, on_the_floor" in text and "as in fleet pupper_v2" in text
    before = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    again = motorprior("calibrate", logs, "--out", out, *SMALL)
    assert again.out == outcome.out and {path: path.stat().st_mtime_ns for path in out.iterdir()} == before
    other = motorprior("calibrate", logs, "--out", tmp_path / "again", *SMALL)
    assert other.code == 0
    for name in ("fleet.toml", "figures.json", "calibration.png"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name


def test_a_prior_s_bands_are_drawn_over_the_same_logs_without_another_fit(
    motorprior, logs: Path, prior: Path, tmp_path: Path
):
    out, one = tmp_path / "fitted", logs / "in_the_air.parquet"
    assert motorprior("calibrate", one, "--out", out, *SMALL).code == 0
    fitted = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    outcome = motorprior("calibrate", one, "--out", out, *SMALL, "--prior", prior)
    assert outcome.code == 0, outcome.err
    assert "in the prior's 90 %" in outcome.out and str(out / "prior" / "calibration.png") in outcome.err
    assert {path: path.stat().st_mtime_ns for path in fitted} == fitted
    assert (out / "prior" / "calibration.png").read_bytes() != (out / "calibration.png").read_bytes()
    figures = json.loads((out / "prior" / "figures.json").read_text("utf-8"))
    wide, narrow = (figures[f"calibrate_coverage{level}/in_the_air/prior"] for level in (90, 50))
    assert 0.0 <= narrow <= wide < 0.5, "motors without torque fall from where the real ones were"
    drawn = (out / "prior" / "calibration.png").stat().st_mtime_ns
    again = motorprior("calibrate", one, "--out", out, *SMALL, "--prior", prior)
    assert again.out == outcome.out and (out / "prior" / "calibration.png").stat().st_mtime_ns == drawn


def test_a_posture_on_the_command_line_goes_before_what_is_found(motorprior, logs: Path, tmp_path: Path):
    log = logs / "on_the_floor.parquet"
    outcome = motorprior("calibrate", log, "--out", tmp_path / "out", *SMALL, "--posture", "hung")
    assert outcome.code == 0, outcome.err
    assert "log on_the_floor: hung, as asked for" in outcome.err
    assert "without this log" not in outcome.out, "there is but one"


def test_gains_that_a_log_states_are_its_motors_and_not_fitted(motorprior, logs: Path, tmp_path: Path):
    log, center = read_log(logs / "in_the_air.parquet"), load_fleet("pupper_v2").center(1)
    gains = {"stated_kp": np.full(log.joint_pos.shape, center.kp), "stated_kd": np.full(log.joint_pos.shape, center.kd)}
    write_log(tmp_path / "told.parquet", replace(log, **gains))
    outcome = motorprior("calibrate", tmp_path / "told.parquet", "--out", tmp_path / "out", *SMALL)
    assert outcome.code == 0, outcome.err
    assert f"log told: it states kp {center.kp[0]:.3g} N·m/rad and kd " in outcome.err
    figures = json.loads((tmp_path / "out" / "figures.json").read_text("utf-8"))
    fitted = {name.split("/")[1] for name in figures if name.startswith("calibrate_center/")}
    assert fitted == {"coulomb", "load_friction", "armature", "delay"}
    assert "the logs state the gains that their motors had" in (tmp_path / "out" / "fleet.toml").read_text("utf-8")
    load_fleet(tmp_path / "out" / "fleet.toml")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--starts", 0), ("starts", "1")),
        (("--draws", 0), ("draws", "1")),
        (("--seed", -1), ("seed",)),
        (("--fleet", "nobody"), ("no fleet", "nobody")),
        (("--prior", "nowhere.safetensors"), ("nowhere.safetensors",)),
    ],
)
def test_what_cannot_be_calibrated_is_refused(refused, logs: Path, tmp_path: Path, options, words):
    refused("calibrate", logs, "--out", tmp_path / "out", *options, words=words)


@pytest.mark.slow
def test_the_commands_of_the_page_run_on_the_real_logs(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if not (shared_data / "pupper_v2").is_dir():
        pytest.skip("no logs of a real Pupper")
    shutil.copytree(shared_data / "pupper_v2", tmp_path / "logs")
    monkeypatch.chdir(tmp_path)
    small = {"calibrate": "--starts 1 --draws 2", "bench": "--motors 12 --steps 1500", "identify": "--steps 2"}
    words = commands(BEGINNING)
    assert [each[0] for each in words] == ["calibrate", "bench", "identify", "calibrate"]
    for each in words:
        config = parse([*each, *shlex.split(small[each[0]])])
        RUN[type(config)](config)
    figures = json.loads((tmp_path / "runs" / "fitted" / "figures.json").read_text("utf-8"))
    error = {name: figures[f"calibrate_rmse/{name}/center"] for name in ("0116", "1_joint", "bf", "lr")}
    assert error["0116"] < 0.014 and error["lr"] < 0.014 and error["1_joint"] < 0.007 and error["bf"] < 0.016
    assert figures["calibrate_rmse/left_out"] < 0.0135


@pytest.mark.slow
def test_the_commands_for_another_robot_run_on_the_example_fleet_and_cut_logs(
    motorprior, shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    raw, model = shared_data / "go2", shared_data / "robots" / "go2.xml"
    if not raw.is_dir() or not model.is_file():
        pytest.skip("no logs of a real Go2")
    for path in (model, *(ROOT / "examples" / "robots").glob("go2*.toml")):
        shutil.copy(path, tmp_path)
    (tmp_path / "go2").mkdir()
    for name in ("traj_0.csv.gz", "traj_3.csv.gz"):
        with gzip.open(raw / name, "rt") as whole, gzip.open(tmp_path / "go2" / name, "wt") as cut:
            cut.writelines(islice(whole, 800))
    monkeypatch.chdir(tmp_path)
    words = commands(GO2)
    assert [each[0] for each in words] == ["logs", "calibrate"]
    outcomes = [motorprior(*each) for each in words]
    assert [each.code for each in outcomes] == [0, 0], outcomes
    assert "log traj_3: it states kp 20, 40 N·m/rad and kd 1, 2 N·m·s/rad" in outcomes[1].err
    figures = json.loads((tmp_path / "runs" / "go2_fitted" / "figures.json").read_text("utf-8"))
    assert figures["calibrate_rmse/center"] < figures["calibrate_rmse/start"] < 0.02
    assert "calibrate_center/kp" not in figures
