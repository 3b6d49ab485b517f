"""`logs import`: formats, grids, gaps, gains, loads, messages, and errors before it writes."""

import io
import shutil
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from motor_logs import TABLE_MAP, joints_of, log_of, of_check, write_table
from swinging_bars import INERTIA, bars_table, swing
from third_party_files import (
    ANGLE,
    JOINTS,
    ROWS,
    TIME,
    write_csv,
    write_lerobot,
    write_parquet,
    write_pt,
)

from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification import load_fit
from motorprior.identification.load_fit import FittedLoad
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.read_log import read_log
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import Lines
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as PUPPER


def imported(config: LogsImport) -> str:
    """Import logs and return the messages."""
    output = io.StringIO()
    import_logs(config, Lines(output))
    return output.getvalue()


def write_swing(folder: Path) -> tuple[Path, str]:
    """A table of a joint that swings by 0.8 rad for 12 s, with a gap of 2.5 s, and its map."""
    rng = np.random.default_rng(1)
    time = 0.01 * np.arange(1200)
    time = time[(time <= 6.0) | (time >= 8.5)]
    goal = 0.8 * np.sin(3.0 * time)
    angle = 0.8 * np.sin(3.0 * (time - 0.05))
    log = log_of(time, goal, angle + 1e-3 * rng.standard_normal(len(time)))
    (folder / "map.toml").write_text(f"{TABLE_MAP}[joints.a]\n", "utf-8")

    return write_table(log, folder / "swing.csv"), str(folder / "map.toml")


def of_pupper(posture: np.ndarray | None = None) -> MotorLog:
    angles = np.tile(ANGLE[:, :1], (1, PUPPER.num_joints))
    return log_of(TIME, angles, posture=posture, **joints_of(PUPPER))


@pytest.mark.parametrize("write", [write_pt, write_csv])
def test_tables_and_tensors_are_imported_by_a_map_without_a_robot(tmp_path: Path, write):
    columns = str(tmp_path / "columns.toml")
    output = imported(
        LogsImport((write(tmp_path),), tmp_path / "out", columns=columns, period=None)
    )
    log = read_parquet(tmp_path / "out" / "log.parquet")

    assert log.joint_names == JOINTS

    degrees = np.rad2deg(log.joint_pos[:, 0])
    (line,) = [line for line in output.splitlines() if line.startswith("pan")]

    assert line.split()[:3] == ["pan", f"{degrees.min():.1f}", f"{degrees.max():.1f}"]


@pytest.mark.parametrize("row", [0, ROWS - 1])
def test_loads_of_a_suspended_robot_need_the_posture_suspended_in_every_row(
    tmp_path: Path, row: int
):
    codes = np.full(ROWS, POSTURES.index("suspended"))
    codes[row] = POSTURES.index("standing")
    write_log(tmp_path / "log.parquet", of_pupper(posture=codes))

    with pytest.raises(LogError, match=f"row {row} .*standing") as error:
        import_logs(LogsImport((tmp_path / "log.parquet",), tmp_path / "out", suspended=True))
    assert error.value.argument == "suspended"
    assert error.value.where == tmp_path / "log.parquet"


def test_an_unknown_load_is_fitted_to_all_tables_and_reported(tmp_path: Path, monkeypatch):
    bars = swing(2.0)
    table, columns = bars_table(bars, tmp_path)
    again = Path(shutil.copy(table, tmp_path / "again.csv"))
    loads = []

    for inertia, armature, gravity in zip(INERTIA, (0.1, 0.7), bars.gravity, strict=True):
        loads.append(FittedLoad(inertia, 0.1, armature, gravity, 1e-4 * np.eye(2), 1e-3))

    fit_loads = Mock(return_value=loads)  # the fit has tests of its own
    monkeypatch.setattr(load_fit, "fit_loads", fit_loads)

    config = LogsImport((table, again), tmp_path / "out", columns=str(columns), fit_load=True)
    lines = imported(config).splitlines()

    logs = [read_parquet(tmp_path / "out" / f"{name}.parquet") for name in ("swing", "again")]

    for log in logs:
        assert log.load_inertia is not None
        assert log.joint_names == ("left", "right")
        np.testing.assert_array_equal(log.load_inertia[0], INERTIA)

    fit_loads.assert_called_once()
    num_rows = fit_loads.call_args.args[0].num_rows

    assert num_rows == sum(log.num_rows for log in logs), "both tables together"

    left, right = (line for line in lines if line.startswith("joint "))

    assert "left" in left
    assert "0.005 kg·m² (1 σ ×/÷ 1.11, of the armature 1.11)" in left
    assert "0.4 ± 0.01" in left
    assert "right" in right
    assert "of the armature 2.01" in right


def test_an_import_does_not_overwrite_its_recording(tmp_path: Path):
    path = write_parquet(tmp_path)
    columns = str(tmp_path / "columns.toml")
    original = path.read_bytes()
    (tmp_path / "deeper").mkdir()

    with pytest.raises(ConfigError, match="overwrite"):
        import_logs(LogsImport((path,), tmp_path / "deeper" / "..", columns=columns))
    assert path.read_bytes() == original


@pytest.mark.parametrize("period", [None, 0.002])
def test_a_gap_begins_a_segment(tmp_path: Path, period: float | None):
    path, columns = write_swing(tmp_path)
    output = imported(LogsImport((path,), tmp_path / "out", columns=columns, period=period))
    log = read_parquet(tmp_path / "out" / "swing.parquet")
    # 6 s and 3.5 s: rows at 100 Hz as recorded, or every 2 ms
    num_rows = [601, 350] if period is None else [3001, 1746]

    assert [segment.num_rows for segment in log.segments()] == num_rows
    assert not np.any((log.time > 6.0 + 1e-9) & (log.time < 8.5 - 1e-9))
    assert not of_check(check_log(log), "gaps")
    assert f"{path}: " in output
    assert "2.5 s before row 601, at 8.5 s" in output


def test_gains_are_reported_with_their_joints(tmp_path: Path):
    path = write_csv(tmp_path)
    out = tmp_path / "out"
    columns = str(tmp_path / "columns.toml")

    assert "pan 20, lift 16" in imported(LogsImport((path,), out, columns=columns, kp=(20.0, 16.0)))


def test_gains_are_given_for_all_joints_of_a_robot(tmp_path: Path):
    out = tmp_path / "out"
    gains = tuple(float(number) for number in range(1, 1 + PUPPER.num_joints))
    path = tmp_path / "walk.parquet"
    write_log(path, of_pupper())

    import_logs(LogsImport((path,), out, kp=gains, robot=PUPPER.name))
    logged = read_parquet(out / "walk.parquet").logged_kp
    assert logged is not None
    assert tuple(logged[0]) == gains
    with pytest.raises(ConfigError, match=r"\b2\b.*\b12\b"):
        import_logs(LogsImport((path,), out, kp=(1.0, 2.0)))


def test_a_map_overrides_the_units_of_a_dataset(tmp_path: Path):
    path = write_lerobot(tmp_path)
    (tmp_path / "map.toml").write_text(
        'motor = "servo"\ntime = "timestamp"\nsegment = "episode_index"\n'
        'position_target = "action[{joint}]"\njoint_pos = "observation.state[{joint}]"\n'
        'units = {angle = "deg"}\n'
        '[joints.0]\nname = "pan"\n[joints.1]\nname = "lift"\nscale = 0.01\nzero = 0.3\n',
        "utf-8",
    )
    output = imported(
        LogsImport((path,), tmp_path / "out", columns=str(tmp_path / "map.toml"), period=None)
    )

    assert "does not contain its units" not in output

    log = read_parquet(tmp_path / "out" / "dataset.parquet")
    degrees = read_log(path)

    assert log.joint_names == JOINTS
    assert len(log.segment_slices()) == 2
    np.testing.assert_allclose(log.joint_pos[:, 0], degrees.joint_pos[:, 0])

    lift = 0.3 + 0.01 * np.rad2deg(degrees.joint_pos[:, 1])

    np.testing.assert_allclose(log.joint_pos[:, 1], lift)
