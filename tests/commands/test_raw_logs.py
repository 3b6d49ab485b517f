"""`logs import` recognises every format and can put it on a grid."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from swinging_bars import INERTIA, swing, write_table
from third_party_files import ANGLE, JOINTS, ROWS, TIME, write_bam, write_csv, write_lerobot, write_pt, write_sage

from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.exceptions import LogError
from motorprior.identification import load_fit
from motorprior.identification.load_fit import FittedLoad
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import Lines
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def test_formats_that_name_their_joints_need_no_word_about_them(tmp_path: Path):
    paths = (write_bam(tmp_path), write_sage(tmp_path), write_lerobot(tmp_path))
    import_logs(LogsImport(paths, tmp_path / "out", period=None))
    names = [read_parquet(tmp_path / "out" / f"{name}.parquet").joint_names for name in ("swing", "motion", "dataset")]
    assert names == [("pendulum",), JOINTS, JOINTS]
    np.testing.assert_array_equal(read_parquet(tmp_path / "out" / "motion.parquet").joint_pos, ANGLE)


@pytest.mark.parametrize("write", [write_pt, write_csv])
def test_tables_and_tensors_need_a_map_and_no_robot(tmp_path: Path, write):
    import_logs(LogsImport((write(tmp_path),), tmp_path / "out", columns=str(tmp_path / "columns.toml")))
    assert read_parquet(tmp_path / "out" / "log.parquet").joint_names == JOINTS


def test_any_format_comes_on_a_grid(tmp_path: Path):
    import_logs(LogsImport((write_bam(tmp_path),), tmp_path / "out", period=0.005))
    log = read_parquet(tmp_path / "out" / "swing.parquet")
    np.testing.assert_allclose(np.diff(log.time), 0.005)
    np.testing.assert_allclose(log.joint_pos[:, 0], np.interp(log.time, TIME, ANGLE[:, 0]), atol=1e-12)


def test_given_registers_are_used_and_checked(tmp_path: Path):
    path = write_bam(tmp_path)
    given = {"profile_acceleration": 39.0, "dead_zone": 0.002}
    import_logs(LogsImport((path,), tmp_path / "out", firmware=given))
    assert read_parquet(tmp_path / "out" / "swing.parquet").firmware == given
    with pytest.raises(LogError, match=r"firmware\.profile_speed -1 is not 0 \(off\) or a number"):
        import_logs(LogsImport((path,), tmp_path / "out", firmware={"profile_speed": -1.0}))


@pytest.mark.parametrize("row", [0, 30, ROWS - 1])
def test_loads_of_a_suspended_robot_need_that_posture_in_every_row(tmp_path: Path, row: int):
    codes = np.full(ROWS, POSTURES.index("suspended"))
    codes[row] = POSTURES.index("standing")
    angle = np.tile(ANGLE[:, :1], (1, PUPPER_V2.num_joints))
    log = MotorLog(
        time=TIME, position_target=angle, joint_pos=angle, joint_names=PUPPER_V2.joint_names, robot=PUPPER_V2.name,
        motor=PUPPER_V2.motor, source="a test", posture=codes,
    )  # fmt: skip
    write_log(tmp_path / "log.parquet", log)
    with pytest.raises(LogError, match=f"row {row} .*standing") as error:
        import_logs(LogsImport((tmp_path / "log.parquet",), tmp_path / "out", suspended=True))
    assert error.value.argument == "suspended" and error.value.where == tmp_path / "log.parquet"


def test_an_unknown_load_is_fitted_to_all_tables_and_reported(tmp_path: Path, monkeypatch):
    """The fit itself: tests/identification/test_load_fit.py; here it finds what is given."""
    bars = swing(2.0)
    table, columns = write_table(bars, tmp_path)
    again = Path(shutil.copy(table, tmp_path / "again.csv"))
    given = [
        FittedLoad(inertia, 0.1, armature, gravity, 1e-4 * np.eye(2), 1e-3)
        for inertia, armature, gravity in zip(INERTIA, (0.1, 0.7), bars.gravity, strict=True)
    ]
    rows = []
    monkeypatch.setattr(load_fit, "fit_loads", lambda log, report: rows.append(log.num_rows) or given)
    said, out = io.StringIO(), tmp_path / "out"
    import_logs(LogsImport((table, again), out, columns=str(columns), fit_load=True), Lines(said))
    total = 0
    for name in ("swing", "again"):
        log = read_parquet(out / f"{name}.parquet")
        assert log.load_inertia is not None and log.joint_names == ("left", "right") and "loads fitted" in log.source
        np.testing.assert_array_equal(log.load_inertia[0], INERTIA)
        np.testing.assert_allclose(np.diff(log.time), 0.002)
        total += log.num_rows
    assert rows == [total], "both tables together"
    told = json.loads((out / "loads.json").read_text())
    assert told["logs"] == ["swing.parquet", "again.parquet"] and told["joints"]["left"]["inertia_kg_m2"] == INERTIA[0]
    lines = said.getvalue().splitlines()
    assert any("joint left: inertia 0.005 kg·m² (×/÷ 1.11, 1 σ); weight 0.4 ± 0.01" in line for line in lines)
    assert [line.startswith("joint right") for line in lines if "off by a factor of 2.0" in line] == [True]
