"""Tables that need a column map: replay and calibrate take none, and say where it is given."""

import pickle
import zipfile
from pathlib import Path

import pytest

from motorprior.exceptions import LogError
from motorprior.pipeline.replay.replay import read_logs
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT


@pytest.mark.parametrize("given", ["", "a.csv", "a.pt"])
def test_raw_tables_are_to_be_imported_first(tmp_path: Path, given: str):
    (tmp_path / "a.csv").write_text("t_s,q_des_hip,q_hip\n0,0,0\n0.1,0,0\n", "utf-8")
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({}))
        archive.writestr("archive/version", "3")
    with pytest.raises(LogError, match=r"import the logs first with `motorprior logs import`.*\.parquet") as refused:
        read_logs(tmp_path / given, ROBOT)
    assert "give columns" not in str(refused.value) and "robot" not in str(refused.value)


def test_what_no_map_would_help_keeps_its_remedy(tmp_path: Path):
    (tmp_path / "a.parquet").write_bytes(b"no table")
    with pytest.raises(LogError, match=r"a\.parquet") as refused:
        read_logs(tmp_path, ROBOT)
    assert "logs import" not in str(refused.value)
