"""``motorprior calibrate`` fits a fleet to a folder of logs."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from recorded_robot import record_log

from motorprior.actuator.fleet import load_fleet
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.log_replay import with_posture

SMALL = ("--starts", "1", "--iterations", "1", "--samples", "3")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two logs, in two postures, of motors sampled from the shipped fleet."""
    folder = tmp_path_factory.mktemp("logs")
    motors = load_fleet("pupper_v2").sample(ROBOT.num_joints, 1).actuator()
    write_log(folder / "in_the_air.parquet", with_posture(record_log(motors), "suspended"))
    write_log(folder / "on_the_floor.parquet", record_log(motors, suspended=False))

    return folder


def test_a_folder_of_logs_is_calibrated_to_the_same_fleet_twice(
    motorprior, logs: Path, tmp_path: Path
):
    out = tmp_path / "fitted"
    outcome = motorprior("calibrate", logs, "--out", out, *SMALL)

    assert outcome.code == 0, outcome.err
    assert re.search("in_the_air.*suspended", outcome.err)
    assert re.search("on_the_floor.*standing", outcome.err)

    figures = json.loads((out / "figures.json").read_text("utf-8"))
    for model in ("start", "center", "left_out", "per_motor", "per_motor_left_out"):
        errors = [
            figures[f"calibrate_rmse/{log}/{model}"] for log in ("in_the_air", "on_the_floor")
        ]
        assert figures[f"calibrate_rmse/{model}"] == pytest.approx(np.mean(errors))

    fleet = load_fleet(out / "fleet.toml")

    assert fleet.robot == ROBOT.name
    assert fleet.parameters["kp"].center == pytest.approx(figures["calibrate_center/kp"], rel=1e-3)

    text = (out / "fleet.toml").read_text("utf-8")

    assert "in_the_air" in text
    assert "on_the_floor" in text
    assert "pupper_v2" in text

    repeated = motorprior("calibrate", logs, "--out", tmp_path / "again", *SMALL)

    assert repeated.out == outcome.out
    for name in ("fleet.toml", "figures.json", "calibration.png"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name
