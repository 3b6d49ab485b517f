"""Compiled kernels never outlive the source they were compiled from."""

import os
import re
import subprocess
import sys
from pathlib import Path

import motorprior
from motorprior.compiled import source_digest

SOURCE = Path(motorprior.__file__).parent


def test_any_change_of_any_source_file_gives_another_folder(tmp_path: Path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "callee.py").write_text("b")
    before = source_digest(tmp_path)
    assert source_digest(tmp_path) == before
    os.utime(tmp_path / "inner" / "callee.py", ns=(1, 1))
    assert source_digest(tmp_path) != before


def test_the_folder_a_user_chose_is_kept(tmp_path: Path):
    """Folders of a kernel of ours and of a function of the user's, and numba's setting afterwards."""
    code = """if True:
        import sys
        import numba
        from motorprior.rotations import roll_pitch_yaw as ours
        sys.path.insert(0, sys.argv[1])
        import theirs
        print(ours._cache.cache_path, theirs.f._cache.cache_path, repr(numba.config.CACHE_DIR), sep="\\n")
    """
    (tmp_path / "theirs.py").write_text(
        "import numba\n\n\n@numba.njit(cache=True)\ndef f():\n    return 1\n"
    )
    chosen = str(tmp_path / "chosen")
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "NUMBA_CACHE_DIR": chosen,
    }
    words = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    ours, theirs, setting = done.stdout.splitlines()
    assert ours.startswith(chosen) and theirs.startswith(chosen) and setting == repr(chosen)


def test_importing_a_kernel_touches_no_folder(tmp_path: Path):
    """Whether the cache exists after the import of a kernel, and after its first call."""
    code = """if True:
        from pathlib import Path
        import sys
        import numpy as np
        from motorprior.rotations import roll_pitch_yaw
        print(Path(sys.argv[1]).exists())
        roll_pitch_yaw(np.array([1.0, 0.0, 0.0, 0.0]))
        print(Path(sys.argv[1]).exists())
    """
    folder = tmp_path / "cache"
    environment = os.environ | {"XDG_CACHE_HOME": str(folder)}
    environment.pop("NUMBA_CACHE_DIR", None)
    words = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


def test_every_kernel_is_cached_there():
    imports = re.compile(r"^\s*from numba import .*\bnjit\b|numba\.n?jit\b", re.MULTILINE)
    assert [
        file.name for file in SOURCE.rglob("*.py") if imports.search(file.read_text("utf-8"))
    ] == ["compiled.py"]
