"""Compiled kernels never outlive the source they were compiled from."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import motorprior
from motorprior.compiled import kernel_folder, source_digest

SOURCE = Path(motorprior.__file__).parent


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """No answer of another test is remembered, and none of these for others."""
    kernel_folder.cache_clear()
    yield
    kernel_folder.cache_clear()


def test_any_change_of_any_source_file_gives_another_folder(tmp_path):
    (tmp_path / "inner").mkdir()
    kernel, callee = tmp_path / "kernel.py", tmp_path / "inner" / "callee.py"
    kernel.write_text("a")
    callee.write_text("b")
    before = source_digest(tmp_path)
    assert source_digest(tmp_path) == before
    os.utime(callee, ns=(1, 1))
    assert source_digest(tmp_path) != before


def where_kernels_go(home: Path, chosen: str) -> list[str]:
    """Folders of a kernel of ours, of a function of the user's, and the setting afterwards."""
    code = """if True:
        import sys
        import numba
        from motorprior.rotations import roll_pitch_yaw as ours
        sys.path.insert(0, sys.argv[1])
        import theirs
        print(ours._cache.cache_path, theirs.f._cache.cache_path, repr(numba.config.CACHE_DIR), sep="\\n")
    """
    (home / "theirs.py").write_text("import numba\n\n\n@numba.njit(cache=True)\ndef f():\n    return 1\n")
    environment = os.environ | {"XDG_CACHE_HOME": str(home / "cache"), "NUMBA_CACHE_DIR": chosen}
    words = [sys.executable, "-c", code, str(home)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.splitlines()


def test_the_folder_a_user_chose_is_kept(tmp_path: Path):
    ours, theirs, setting = where_kernels_go(tmp_path, str(tmp_path / "chosen"))
    assert ours.startswith(str(tmp_path / "chosen")) and theirs.startswith(str(tmp_path / "chosen"))
    assert setting == repr(str(tmp_path / "chosen"))


def test_every_kernel_is_cached_there():
    imports = re.compile(r"^\s*from numba import .*\bnjit\b|numba\.n?jit\b", re.MULTILINE)
    assert [file.name for file in SOURCE.rglob("*.py") if imports.search(file.read_text("utf-8"))] == ["compiled.py"]
