"""Compiled kernels are cached in a folder that depends on the source of the package."""

import os
import re
import subprocess
import sys
from pathlib import Path

import motorprior
from motorprior.compiled import source_digest

SOURCE = Path(motorprior.__file__).parent


def test_a_changed_source_file_gives_another_digest(tmp_path: Path):
    file = tmp_path / "inner" / "callee.py"
    file.parent.mkdir()
    file.write_text("b")
    digest = source_digest(tmp_path)

    assert source_digest(tmp_path) == digest

    os.utime(file, ns=(1, 1))

    assert source_digest(tmp_path) != digest


def test_the_cache_folder_that_a_user_set_is_kept(tmp_path: Path):
    """The folder holds for kernels of the package and for functions of the user."""
    code = """if True:
        import sys
        import numba
        from motorprior.rotations import roll_pitch_yaw as ours
        sys.path.insert(0, sys.argv[1])
        import theirs
        print(ours._cache.cache_path)
        print(theirs.f._cache.cache_path)
        print(repr(numba.config.CACHE_DIR))
    """
    (tmp_path / "theirs.py").write_text(
        "import numba\n\n\n@numba.njit(cache=True)\ndef f():\n    return 1\n"
    )
    cache_folder = str(tmp_path / "chosen")
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "NUMBA_CACHE_DIR": cache_folder,
    }
    words = [sys.executable, "-c", code, str(tmp_path)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    ours, theirs, setting = done.stdout.splitlines()

    assert ours.startswith(cache_folder)
    assert theirs.startswith(cache_folder)
    assert setting == repr(cache_folder)


def test_the_cache_is_created_at_the_first_call_of_a_kernel_not_at_its_import(tmp_path: Path):
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


def test_only_the_module_compiled_uses_numba_njit():
    imports = re.compile(r"^\s*from numba import .*\bnjit\b|numba\.n?jit\b", re.MULTILINE)
    texts = {file.name: file.read_text("utf-8") for file in SOURCE.rglob("*.py")}

    assert [name for name, text in texts.items() if imports.search(text)] == ["compiled.py"]
