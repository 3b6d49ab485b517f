"""`logs import`: gaps, gains, messages, and errors before it writes."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from third_party_files import JOINTS, write_csv, write_lerobot, write_parquet

from motorprior.exceptions import ConfigError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.formats.parquet_io import read_parquet, write_log
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.log_import import raw_logs
from motorprior.pipeline.log_import.import_files import summary
from motorprior.pipeline.log_import.raw_logs import LogsImport, import_logs, smooth_on_grid
from motorprior.pipeline.progress import Lines
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


def test_a_recording_is_not_overwritten_by_its_own_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, columns = write_parquet(tmp_path), str(tmp_path / "columns.toml")
    before = path.read_bytes()
    first = path.with_name("first.csv")
    write_csv(tmp_path).rename(first)
    (tmp_path / "deeper").mkdir()
    monkeypatch.chdir(tmp_path)
    for paths, out in (
        ((path,), tmp_path),
        ((Path("log.parquet"),), Path()),
        ((first, path), tmp_path / "deeper" / ".."),
    ):
        with pytest.raises(ConfigError, match="out: the import would overwrite the recording") as refusal:
            import_logs(LogsImport(paths, out, columns=columns))
        assert refusal.value.argument == "out" and refusal.value.remedy == "give another folder"
    assert path.read_bytes() == before and not (tmp_path / "first.parquet").exists()


def test_loads_of_a_held_base_need_its_robot(tmp_path: Path):
    path, columns = write_swing(tmp_path)
    with pytest.raises(ConfigError, match="no robot was given -> give robot") as refusal:
        import_logs(LogsImport((path,), tmp_path / "out", columns=columns, suspended=True))
    assert refusal.value.argument == "robot" and not (tmp_path / "out").exists()


@pytest.mark.parametrize("period", [None, 0.002])
def test_a_gap_begins_a_segment_and_is_told(tmp_path: Path, period: float | None):
    path, columns = write_swing(tmp_path)
    said = imported(LogsImport((path,), tmp_path / "out", columns=columns, period=period))
    log = read_parquet(tmp_path / "out" / "swing.parquet")
    assert [part.num_rows for part in log.segments()] == ([601, 350] if period is None else [3001, 1746])
    assert not np.any((log.time > 6.0 + 1e-9) & (log.time < 8.5 - 1e-9))
    assert not check_log(log).of("gaps")
    assert f"{path}: 1 gap longer than 5 median steps: 2.5 s before row 601, at 8.5 s; a segment begins" in said


def test_no_motion_is_invented_in_a_gap(tmp_path: Path):
    """A spline across the gap swings to several radians where the motion has 0.8."""
    path, columns = write_swing(tmp_path)
    text = Path(columns).read_text("utf-8").replace("a = {}", "a = {kp = 5, kd = 0.1}")
    Path(columns).write_text(text, "utf-8")
    raw = read_log(path, columns=columns)
    assert np.abs(smooth_on_grid(raw, 0.002).joint_pos).max() > 1.5, "without a segment"
    config = LogsImport((path,), tmp_path / "out", columns=columns, fit_load=True)
    found: list[MotorLog] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(raw_logs, "write_with_fitted_loads", lambda logs, *_: found.extend(logs.values()))
        imported(config)
    (log,) = found
    assert np.abs(log.joint_pos).max() < 0.85 and len(log.segment_slices()) == 2
    truth = 0.8 * np.sin(3.0 * (log.time - 0.05))
    assert np.sqrt(np.mean((log.joint_pos[:, 0] - truth) ** 2)) < 2e-3


def test_several_gains_need_an_order_and_are_told(tmp_path: Path):
    config = LogsImport(
        (write_csv(tmp_path),), tmp_path / "out", columns=str(tmp_path / "columns.toml"), kp=(20.0, 16.0)
    )
    with pytest.raises(ConfigError, match="the joints pan, lift are not in a robot's order") as refusal:
        import_logs(config)
    assert refusal.value.argument == "kp" and "[joints.pan] kp = " in str(refusal.value.remedy)
    assert "kp: " not in imported(replace(config, kp=(20.0,))), "one is of all"
    gains = tuple(float(number) for number in range(1, 13))
    assert PUPPER.num_joints == len(gains)
    write_log(tmp_path / "walk.parquet", _of_pupper())
    said = imported(LogsImport((tmp_path / "walk.parquet",), tmp_path / "out", kp=gains, robot=PUPPER.name))
    assert f"kp: {PUPPER.joint_names[0]} 1, {PUPPER.joint_names[1]} 2," in said
    stated = read_parquet(tmp_path / "out" / "walk.parquet").stated_kp
    assert stated is not None and tuple(stated[0]) == gains
    write_log(tmp_path / "walk.parquet", replace(_of_pupper(), joint_names=PUPPER.joint_names[::-1]))
    with pytest.raises(ConfigError, match="are not in a robot's order"):
        import_logs(LogsImport((tmp_path / "walk.parquet",), tmp_path / "out", kp=gains, robot=PUPPER.name))
    with pytest.raises(ConfigError, match="kp: 2 gains for 12 joints"):
        import_logs(LogsImport((tmp_path / "walk.parquet",), tmp_path / "out", kp=(1.0, 2.0)))


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
    said = imported(LogsImport((path,), tmp_path / "out", columns=str(tmp_path / "map.toml")))
    assert "does not contain its units" not in said
    log, degrees = read_parquet(tmp_path / "out" / "dataset.parquet"), read_log(path)
    assert log.joint_names == JOINTS and len(log.segment_slices()) == 2
    np.testing.assert_allclose(log.joint_pos[:, 0], degrees.joint_pos[:, 0])
    np.testing.assert_allclose(log.joint_pos[:, 1], 0.3 + 0.01 * np.rad2deg(degrees.joint_pos[:, 1]))


def test_what_was_imported_is_told_in_degrees(tmp_path: Path):
    config = LogsImport((write_csv(tmp_path),), tmp_path / "out", columns=str(tmp_path / "columns.toml"))
    line, _ = imported(config).splitlines()
    log = read_parquet(tmp_path / "out" / "log.parquet")
    low, high = np.rad2deg([log.joint_pos.min(), log.joint_pos.max()])
    assert line == f"{tmp_path / 'out' / 'log.parquet'}: {summary(log)}"
    assert "40 rows, 0.78 s, 50 Hz, 2 joints (pan, lift), commands from" in line
    assert line.endswith(f"angles from {low:.1f} to {high:.1f}°")
