"""`logs import`: gaps, gains, messages, and errors before it writes."""

import io
from pathlib import Path

import numpy as np
import pytest
from third_party_files import JOINTS, write_csv, write_lerobot, write_parquet

from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.exceptions import ConfigError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import begin_at_gaps, smooth_on_grid
from motorprior.logs.read_log import read_log
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import Lines
from motorprior.robots.load import load_robot

PUPPER = load_robot("pupper_v2")
SWING = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joints.a = {}
"""


def imported(config: LogsImport) -> str:
    """The messages."""
    said = io.StringIO()
    import_logs(config, Lines(said))
    return said.getvalue()


def write_swing(folder: Path, gap: bool = True) -> tuple[Path, str]:
    """12 s of a joint that swings by 0.8 rad, at 100 Hz, without the rows from 6 to 8.5 s; and a map of it."""
    rng, time = np.random.default_rng(1), 0.01 * np.arange(1200)
    time = time[(time <= 6.0) | (time >= 8.5)] if gap else time
    goal, angle = (0.8 * np.sin(3.0 * (time - late)) for late in (0.0, 0.05))
    table = np.column_stack([time, goal, angle + 1e-3 * rng.standard_normal(len(time))])
    path = folder / "swing.csv"
    np.savetxt(path, table, delimiter=",", header="t,goal_a,pos_a", comments="")
    (folder / "map.toml").write_text(SWING, "utf-8")
    return path, str(folder / "map.toml")


def test_a_recording_is_not_overwritten_by_its_own_import(tmp_path: Path):
    path, columns = write_parquet(tmp_path), str(tmp_path / "columns.toml")
    before = path.read_bytes()
    (tmp_path / "deeper").mkdir()
    for out in (tmp_path, tmp_path / "deeper" / ".."):
        with pytest.raises(ConfigError, match="would overwrite the recording") as error:
            import_logs(LogsImport((path,), out, columns=columns))
        assert error.value.argument == "out"
    assert path.read_bytes() == before


def test_loads_need_the_robot(tmp_path: Path):
    path, columns = write_swing(tmp_path)
    with pytest.raises(ConfigError, match="no model for the loads -> give robot") as refusal:
        import_logs(LogsImport((path,), tmp_path / "out", columns=columns, suspended=True))
    assert refusal.value.argument == "robot"


@pytest.mark.parametrize("period", [None, 0.002])
def test_a_gap_begins_a_segment(tmp_path: Path, period: float | None):
    path, columns = write_swing(tmp_path)
    said = imported(LogsImport((path,), tmp_path / "out", columns=columns, period=period))
    log = read_parquet(tmp_path / "out" / "swing.parquet")
    assert [part.num_rows for part in log.segments()] == ([601, 350] if period is None else [3001, 1746])
    assert not np.any((log.time > 6.0 + 1e-9) & (log.time < 8.5 - 1e-9))
    assert not check_log(log).of("gaps")
    assert f"{path}: gaps longer than 5 median steps: 1; 2.5 s before row 601, at 8.5 s; a segment begins" in said


def test_no_motion_is_invented_in_a_gap(tmp_path: Path):
    path, columns = write_swing(tmp_path)
    raw = read_log(path, columns=columns)
    assert np.abs(smooth_on_grid(raw, 0.002).joint_pos).max() > 1.5, "a spline across the gap"
    log = smooth_on_grid(begin_at_gaps(raw, 0.002)[0], 0.002)
    assert np.abs(log.joint_pos).max() < 0.85 and len(log.segment_slices()) == 2
    truth = 0.8 * np.sin(3.0 * (log.time - 0.05))
    assert np.sqrt(np.mean((log.joint_pos[:, 0] - truth) ** 2)) < 2e-3


def test_several_gains_need_the_joints_in_a_robots_order(tmp_path: Path):
    config = LogsImport(
        (write_csv(tmp_path),), tmp_path / "out", columns=str(tmp_path / "columns.toml"), kp=(20.0, 16.0)
    )
    with pytest.raises(ConfigError, match="the joints pan, lift are not in a robot's order") as error:
        import_logs(config)
    assert error.value.argument == "kp"
    gains = tuple(float(number) for number in range(1, 1 + PUPPER.num_joints))
    path = tmp_path / "walk.parquet"
    write_log(path, _of_pupper())
    messages = imported(LogsImport((path,), tmp_path / "out", kp=gains, robot=PUPPER.name))
    assert f"kp: {PUPPER.joint_names[0]} 1, {PUPPER.joint_names[1]} 2," in messages
    logged = read_parquet(tmp_path / "out" / "walk.parquet").stated_kp
    assert logged is not None and tuple(logged[0]) == gains
    with pytest.raises(ConfigError, match="kp: 2 gains for 12 joints"):
        import_logs(LogsImport((path,), tmp_path / "out", kp=(1.0, 2.0)))


def _of_pupper() -> MotorLog:
    time = 0.01 * np.arange(50)
    angle = np.tile(np.sin(time)[:, None], (1, PUPPER.num_joints))
    return MotorLog(
        time=time, position_target=angle, joint_pos=angle, joint_names=PUPPER.joint_names, robot=PUPPER.name,
        motor=PUPPER.motor, source="a test",
    )  # fmt: skip


def test_a_map_says_the_units_of_a_dataset(tmp_path: Path):
    path = write_lerobot(tmp_path)
    (tmp_path / "map.toml").write_text(
        'motor = "servo"\ntime = "timestamp"\nsegment = "episode_index"\nposition_target = "action[{joint}]"\n'
        'joint_pos = "observation.state[{joint}]"\nunits = {angle = "deg"}\n'
        '[joints.0]\nname = "pan"\n[joints.1]\nname = "lift"\nscale = 0.01\nzero = 0.3\n',
        "utf-8",
    )
    said = imported(LogsImport((path,), tmp_path / "out", columns=str(tmp_path / "map.toml"), period=None))
    assert "does not contain its units" not in said
    log, degrees = read_parquet(tmp_path / "out" / "dataset.parquet"), read_log(path)
    assert log.joint_names == JOINTS and len(log.segment_slices()) == 2
    np.testing.assert_allclose(log.joint_pos[:, 0], degrees.joint_pos[:, 0])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.3 + 0.01 * np.rad2deg(degrees.joint_pos[:, 1]))


def test_the_summary_is_in_degrees(tmp_path: Path):
    columns = str(tmp_path / "columns.toml")
    config = LogsImport((write_csv(tmp_path),), tmp_path / "out", columns=columns, period=None)
    line, _ = imported(config).splitlines()
    log = read_parquet(tmp_path / "out" / "log.parquet")
    low, high = np.rad2deg([log.joint_pos.min(), log.joint_pos.max()])
    assert "40 rows, 0.78 s, 50 Hz, 2 joints (pan, lift), commands from" in line
    assert line.endswith(f"angles from {low:.1f} to {high:.1f}°")
