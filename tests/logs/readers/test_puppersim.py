"""The published Pupper recordings read the same from either container; damage is named."""

import gzip
import pickle

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.log_folder import read_log_folder
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
    "tuples": lambda array: tuple(map(tuple, array.tolist())) if array.ndim == 2 else tuple(array.tolist()),
    "arrays in lists": lambda array: list(array),
    "numpy scalars": lambda array: [list(row) for row in array] if array.ndim == 2 else list(array),
    "one array": lambda array: array,
    "rows of one": lambda array: [np.array([value]) for value in array] if array.ndim == 1 else list(array),
}


@pytest.mark.parametrize("protocol", [0, 2, 5])
@pytest.mark.parametrize("variant", VARIANTS)
def test_pickle_and_csv_of_one_recording_are_one_log(tmp_path, table, protocol, variant):
    content = {key: VARIANTS[variant](value) for key, value in content_of(table).items()}
    (tmp_path / "env_real_bf_log.txt").write_bytes(pickle.dumps(content, protocol))
    pickled = read_puppersim_log(tmp_path / "env_real_bf_log.txt", PUPPER_V2)
    for name in ("env_real_bf_log.csv", "env_real_bf_log.csv.gz"):
        read = read_puppersim_log(write_csv(tmp_path / name, csv_lines(table)), PUPPER_V2)
        for channel, value in channels(read).items():
            np.testing.assert_array_equal(value, getattr(pickled, channel))


def test_columns_go_where_they_belong(tmp_path, table):
    log = read_puppersim_log(write_csv(tmp_path / "env_real_bf_log.csv", csv_lines(table)), PUPPER_V2)
    assert log.joint_names == JOINT_NAMES
    np.testing.assert_array_equal(log.time, table[:, 0])
    np.testing.assert_array_equal(log.position_target, table[:, 1:13])
    np.testing.assert_array_equal(log.joint_pos, table[:, 13:25])
    np.testing.assert_array_equal(log.base_orientation, table[:, 25:27])
    assert log.joint_vel is None


@pytest.mark.parametrize(
    ("row", "column", "cell", "problem"),
    [
        (4, 13, "nan", r"row 4, joint_pos/FR_abduction \(column q_0\) is nan"),
        (7, 14, "0.1.2", r"row 7, q_1 is '0\.1\.2', not a number"),
        (7, 3, "1,2", "row 7 has 30 cells, expected 29"),
        (9, 0, "0.0", r"row 9, time runs backwards: 0\.0 s after"),
    ],
)
def test_a_bad_cell_is_named(tmp_path, table, row, column, cell, problem):
    lines = csv_lines(table)
    cells = lines[1 + row].split(",")
    lines[1 + row] = ",".join([*cells[:column], cell, *cells[column + 1 :]])
    with pytest.raises(LogError, match=rf"env_real_x_log\.csv: {problem}.* -> "):
        read_puppersim_log(write_csv(tmp_path / "env_real_x_log.csv", lines), PUPPER_V2)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_truncated_gzip_file_is_refused(tmp_path, table, share):
    path = write_csv(tmp_path / "env_real_x_log.csv.gz", csv_lines(table))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(LogError, match=r"x_log\.csv\.gz: .* -> "):
        read_puppersim_log(path, PUPPER_V2)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda c: c.pop("IMU"), "expected a dict of"),
        (lambda c: c["t"].pop(), "not an array|shape|must have|lists"),
        (lambda c: c["MotorAngle"][3].pop(), "MotorAngle is not a list of equally long rows"),
        (lambda c: c["MotorAngle"][6].__setitem__(1, float("nan")), r"row 6, joint_pos/FR_hip \(column q_1\) is nan"),
        (lambda c: [c[key].clear() for key in c], "t is not a list"),
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
    content = {key: value.tolist() for key, value in content_of(table).items()}
    (tmp_path / "env_real_lr_log.txt").write_bytes(pickle.dumps(content))
    (tmp_path / "env_log_sim_0116.txt").write_text("not read")
    (tmp_path / "README.txt").write_text("not read")
    assert sorted(read_log_folder(tmp_path, PUPPER_V2).logs) == ["0116", "1_joint", "bf", "lr"]


def test_the_published_logs_read(pupper_folder):
    logs = read_log_folder(pupper_folder, PUPPER_V2).logs
    durations = {"0116": 18.7, "1_joint": 3.7, "bf": 7.2, "lr": 6.7}
    assert {name: round(log.duration, 1) for name, log in logs.items()} == durations
    assert all(log.num_joints == 12 and np.abs(log.joint_pos).max() < 3.0 for log in logs.values())


def test_more_than_half_of_the_0116_rows_repeat(pupper_folder):
    log = read_puppersim_log(pupper_folder / "env_log_real_0116.csv.gz", PUPPER_V2)
    assert repeated_rows(log)[1:].mean() == pytest.approx(0.55, abs=0.005)
