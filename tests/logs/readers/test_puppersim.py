"""The published Pupper recordings read the same from either container; damage is named."""

import gzip
import pickle

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.read_log import read_log_folder
from motorprior.logs.motor_log import channels
from motorprior.logs.operations import repeated_rows
from motorprior.logs.readers.puppersim import csv_columns, read_puppersim_log
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.pupper_v2.spec import JOINT_NAMES

ROWS, CSV_COLUMNS = 30, csv_columns(PUPPER_V2.num_joints)


@pytest.fixture
def table():
    """Rows of the CSV with six decimals, as published: (30, 29)."""
    rng = np.random.default_rng(0)
    values = np.round(rng.normal(size=(ROWS, len(CSV_COLUMNS))), 6)
    values[:, 0] = np.round(np.cumsum(rng.uniform(1e-3, 2e-3, ROWS)), 6)
    return values


def csv_lines(table):
    return [",".join(CSV_COLUMNS), *(",".join(f"{value:.6f}" for value in row) for row in table)]


def write_csv(path, lines):
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "wt") as file:
        file.write("\n".join(lines) + "\n")
    return path


def content_of(table):
    time, target, angle, imu = np.split(table, [1, 13, 25], axis=1)
    return {"t": time[:, 0], "IMU": imu, "MotorAngle": angle, "action": target}


VARIANTS = {
    "lists": lambda array: array.tolist(),
    "arrays in lists": lambda array: list(array),
    "one array": lambda array: array,
    "rows of one": lambda array: [np.array([value]) for value in array] if array.ndim == 1 else list(array),
}


@pytest.mark.parametrize("protocol", [0, 2, 5])
@pytest.mark.parametrize("variant", VARIANTS)
def test_pickle_and_csv_of_one_recording_are_one_log(tmp_path, table, protocol, variant):
    content = {key: VARIANTS[variant](value) for key, value in content_of(table).items()}
    (tmp_path / "env_real_bf_log.txt").write_bytes(pickle.dumps(content, protocol))
    pickled = read_puppersim_log(tmp_path / "env_real_bf_log.txt", PUPPER_V2)
    assert pickled.joint_names == JOINT_NAMES and pickled.joint_vel is None
    for name, columns in (("position_target", slice(1, 13)), ("joint_pos", slice(13, 25))):
        np.testing.assert_array_equal(getattr(pickled, name), table[:, columns])
    np.testing.assert_array_equal(pickled.base_orientation, table[:, 25:27])
    for name in ("env_real_bf_log.csv", "env_real_bf_log.csv.gz"):
        read = read_puppersim_log(write_csv(tmp_path / name, csv_lines(table)), PUPPER_V2)
        for channel, value in channels(read).items():
            np.testing.assert_array_equal(value, getattr(pickled, channel))


@pytest.mark.parametrize(
    ("row", "column", "cell", "problem"),
    [
        (4, 13, "nan", r"row 4, joint_pos/FR_abduction \(column q_0\) is nan"),
        (7, 14, "0.1.2", r"row 7, q_1 is '0\.1\.2', not a number"),
        (9, 0, "0.0", r"row 9, time runs backwards: 0\.0 s after"),
    ],
)
def test_a_bad_cell_is_named(tmp_path, table, row, column, cell, problem):
    lines = csv_lines(table)
    cells = lines[1 + row].split(",")
    lines[1 + row] = ",".join([*cells[:column], cell, *cells[column + 1 :]])
    with pytest.raises(LogError, match=rf"env_real_x_log\.csv: {problem}.* -> "):
        read_puppersim_log(write_csv(tmp_path / "env_real_x_log.csv", lines), PUPPER_V2)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda c: c.pop("IMU"), "not lists t, action, MotorAngle, IMU"),
        (lambda c: c["MotorAngle"][3].pop(), "not lists .* of equal rows"),
        (lambda c: c["MotorAngle"][6].__setitem__(1, float("nan")), r"row 6, joint_pos/FR_hip \(column q_1\) is nan"),
        (lambda c: [c[key].clear() for key in c], "not lists"),
    ],
)
def test_a_pickle_that_does_not_fit_is_refused(tmp_path, table, change, problem):
    content = {key: value.tolist() for key, value in content_of(table).items()}
    change(content)
    path = tmp_path / "env_real_x_log.txt"
    path.write_bytes(pickle.dumps(content))
    with pytest.raises(LogError, match=rf"x_log\.txt: .*{problem}"):
        read_puppersim_log(path, PUPPER_V2)


def test_a_folder_gives_the_real_logs_by_short_name(tmp_path, table):
    for name in ("env_log_real_0116.csv.gz", "env_real_bf_log.csv", "env_real_1_joint_log.csv"):
        write_csv(tmp_path / name, csv_lines(table))
    for name in ("env_log_sim_0116.txt", "README.txt"):
        (tmp_path / name).write_text("not read")
    assert sorted(read_log_folder(tmp_path, PUPPER_V2).logs) == ["0116", "1_joint", "bf"]


def test_the_published_logs_read(pupper_folder):
    logs = read_log_folder(pupper_folder, PUPPER_V2).logs
    durations = {"0116": 18.7, "1_joint": 3.7, "bf": 7.2, "lr": 6.7}
    assert {name: round(log.duration, 1) for name, log in logs.items()} == durations
    assert all(log.num_joints == 12 and np.abs(log.joint_pos).max() < 3.0 for log in logs.values())
    assert repeated_rows(logs["0116"])[1:].mean() == pytest.approx(0.55, abs=0.005)
