"""The published Pupper recordings are the same logs from either container; damage is named."""

import gzip
import pickle
from pathlib import Path

import numpy as np
import pytest
from third_party_files import csv_columns

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import channels
from motorprior.logs.operations import repeated_rows
from motorprior.logs.read_log import read_log, read_log_folder
from motorprior.robots.pupper_v2.robot import PUPPER_V2

ROWS = 30
CSV_COLUMNS = csv_columns(PUPPER_V2.num_joints)
RNG = np.random.default_rng(0)
TABLE = np.round(RNG.normal(size=(ROWS, len(CSV_COLUMNS))), 6)  # six decimals, as published
TABLE[:, 0] = np.round(np.cumsum(RNG.uniform(1e-3, 2e-3, ROWS)), 6)


def csv_line(row: np.ndarray) -> str:
    return ",".join(f"{value:.6f}" for value in row)


LINES = [",".join(CSV_COLUMNS), *map(csv_line, TABLE)]


def write_csv(path: Path, lines: list[str] = LINES) -> Path:
    text = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    return path


def content() -> dict[str, list]:
    time, target, angle, imu = np.split(TABLE, [1, 13, 25], axis=1)
    return {
        "t": time[:, 0].tolist(),
        "IMU": imu.tolist(),
        "MotorAngle": angle.tolist(),
        "action": target.tolist(),
    }


@pytest.mark.parametrize(("container", "protocol"), [(list, 0), (np.array, 2)])
def test_pickle_and_csv_of_one_recording_are_one_log(tmp_path: Path, container, protocol: int):
    made = {key: container(value) for key, value in content().items()}
    (tmp_path / "env_real_bf_log.txt").write_bytes(pickle.dumps(made, protocol))
    pickled = read_log(tmp_path / "env_real_bf_log.txt", PUPPER_V2)

    np.testing.assert_array_equal(pickled.position_target, TABLE[:, 1:13])
    np.testing.assert_array_equal(pickled.joint_pos, TABLE[:, 13:25])
    np.testing.assert_array_equal(pickled.base_orientation, TABLE[:, 25:27])

    table = read_log(write_csv(tmp_path / "env_real_bf_log.csv.gz"), PUPPER_V2)

    for channel, value in channels(table).items():
        np.testing.assert_array_equal(value, getattr(pickled, channel))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda content: content.pop("IMU"), "IMU"),
        (
            lambda content: content["MotorAngle"][6].__setitem__(1, float("nan")),
            r"row 6, joint_pos/FR_hip .*nan",
        ),
    ],
)
def test_a_pickle_that_does_not_fit_is_refused(tmp_path: Path, change, problem: str):
    change(made := content())
    path = tmp_path / "env_real_x_log.txt"
    path.write_bytes(pickle.dumps(made))

    with pytest.raises(LogError, match=rf"x_log\.txt: .*{problem}"):
        read_log(path, PUPPER_V2)


def test_a_folder_contains_the_real_logs_by_short_name(tmp_path: Path):
    for name in ("env_log_real_0116.csv.gz", "env_real_bf_log.csv", "env_real_1_joint_log.csv"):
        write_csv(tmp_path / name)
    for name in ("env_log_sim_0116.txt", "README.txt"):
        (tmp_path / name).write_text("not read")

    assert sorted(read_log_folder(tmp_path, PUPPER_V2).logs) == ["0116", "1_joint", "bf"]


def test_the_published_logs_have_their_durations_and_repeated_rows(shared_data: Path):
    logs = read_log_folder(shared_data / "pupper_v2", PUPPER_V2).logs
    durations = {"0116": 18.7, "1_joint": 3.7, "bf": 7.2, "lr": 6.7}

    assert {name: round(log.duration, 1) for name, log in logs.items()} == durations
    assert repeated_rows(logs["0116"])[1:].mean() == pytest.approx(0.55, abs=0.005)
