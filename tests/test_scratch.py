"""A folder for other programs' files ends with its use; what a killed process left is removed by the next."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from motorprior.artifacts import this_host
from motorprior.scratch import _sweep, scratch_folder


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_nothing_is_left(temporary: Path):
    with scratch_folder() as folder:
        (folder / "robot.urdf").write_text("x")
        assert folder.parent == temporary
    assert not list(temporary.iterdir())


def test_what_a_killed_process_left_is_removed_and_what_others_use_stays(temporary: Path):
    code = "from motorprior.scratch import scratch_folder\nwith scratch_folder() as f:\n  print(f, flush=True); input()"
    environment = os.environ | {"TMPDIR": str(temporary)}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        left = Path(process.stdout.readline().strip())
        (left / "x").write_text("x")
        _sweep.cache_clear()
        with scratch_folder():
            assert left.is_dir(), "it lives"
        os.kill(process.pid, signal.SIGKILL)
    abroad = temporary / f"motorprior-{'0' * 16}-{process.pid}-a"
    mine = temporary / "motorprior-notes"
    abroad.mkdir()
    mine.mkdir()
    assert left.is_dir() and this_host() in left.name
    _sweep.cache_clear()
    with scratch_folder():
        assert not left.exists() and abroad.is_dir() and mine.is_dir()
