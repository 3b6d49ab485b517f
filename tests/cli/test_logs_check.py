"""`logs check` on the table of a user: column maps, and advice that can be followed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from motor_logs import TABLE_MAP, log_of, write_table

Command = Callable[..., Any]
JOINTS = ("FR_hip", "FR_knee", "FL_hip")


def written(folder: Path, size: float = 0.3) -> tuple[Path, Path]:
    """A table of joints that follow their commands, and its map."""
    time = 0.01 * np.arange(600)
    rates = np.pi * np.array([1.0, 1.6, 2.2])  # [rad/s]
    target = size * np.sin(np.outer(time, rates))
    angle = size * np.sin(np.outer(time - 0.05, rates))
    log = log_of(time, target, angle, joint_names=JOINTS)

    columns = folder / "map.toml"
    columns.write_text(TABLE_MAP + "".join(f"[joints.{joint}]\n" for joint in JOINTS), "utf-8")

    return write_table(log, folder / "mine.csv"), columns


@pytest.mark.parametrize("command", [("check",), ("import", "--out", "out")])
def test_a_table_without_a_map_is_rejected_with_a_remedy(
    refused: Command, tmp_path: Path, command: tuple
):
    table, _ = written(tmp_path)
    words = ("mine.csv", "'goal_FR_hip'", "--columns", "your-motors.md")

    refused("logs", *command, table, words=words)

    pq.write_table(pa.table({"t": [0.0, 1.0]}), tmp_path / "mine.parquet")

    refused("logs", *command, tmp_path / "mine.parquet", words=("--columns", "your-motors.md"))


@pytest.mark.parametrize(
    ("factors", "advice", "entry"),
    [
        (
            [1, 1, -1, 1, 1, 1, 1],
            "[joints.….position_target]",
            "[joints.FR_knee.position_target]\nsign = -1\n",
        ),
        ([1] + 6 * [180 / np.pi], 'angle = "deg"', '[units]\nangle = "deg"\n'),
        ([1e3] + 6 * [1], 'time = "s", "ms"', '[units]\ntime = "ms"\n'),
    ],
)
def test_the_advice_of_the_log_doctor_repairs_the_column_map(
    motorprior: Command, tmp_path: Path, factors: list[float], advice: str, entry: str
):
    table, columns = written(tmp_path, size=1.0)
    head, *_ = table.read_text().splitlines()
    rows = factors * np.loadtxt(table, delimiter=",", skiprows=1)
    np.savetxt(table, rows, delimiter=",", header=head, comments="")
    outcome = motorprior("logs", "check", table, "--columns", columns)

    assert outcome.code == 2
    assert advice in " ".join(outcome.out.replace("│", " ").split())

    columns.write_text(columns.read_text("utf-8") + entry, "utf-8")

    assert motorprior("logs", "check", table, "--columns", columns).code == 0
