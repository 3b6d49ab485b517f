"""`logs import` takes every format by its look, and puts any of them on a grid."""

from pathlib import Path

import numpy as np
import pytest
from foreign_files import ANGLE, JOINTS, TIME, write_bam, write_csv, write_lerobot, write_pt, write_sage

from motorprior.exceptions import ConfigError
from motorprior.logs.parquet_io import read_parquet
from motorprior.pipeline.raw_logs import LogsImport, import_logs


def test_formats_that_name_their_joints_need_no_word_about_them(tmp_path: Path):
    paths = (write_bam(tmp_path), write_sage(tmp_path), write_lerobot(tmp_path))
    import_logs(LogsImport(paths, tmp_path / "out"))
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


def test_a_log_with_a_load_hangs_nowhere(tmp_path: Path):
    with pytest.raises(ConfigError, match="says its load itself") as refusal:
        import_logs(LogsImport((write_bam(tmp_path),), tmp_path / "out", hung=True))
    assert refusal.value.argument == "hung"
