"""A user's MJCF or URDF, compiled once where it can do no harm: in a process with bounds on time and memory.

A few bytes of such a file describe gigabytes, a million bodies, or a pipe that nobody writes to; MuJoCo obeys.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from motorprior.exceptions import ArtifactError

SECONDS, MEMORY = 15, 1_000_000_000
"""Most that it may take: time [s], and memory [bytes] beyond what MuJoCo itself takes, where the system counts it."""
_CANNOT = 3
_TRIAL = f"""
import sys
import mujoco
try:
    import resource
    taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + {MEMORY}, resource.RLIM_INFINITY))
except (ImportError, OSError, ValueError):
    pass  # no such bounds on this system
try:
    mujoco.MjData(mujoco.MjModel.from_xml_path(sys.argv[1]))
except Exception as error:
    print(str(error) or type(error).__name__)
    sys.exit({_CANNOT})
"""


def try_model(path: Path) -> None:
    """Refuse a model that MuJoCo cannot compile within `SECONDS` and `MEMORY`.

    Raises:
        ArtifactError: what MuJoCo says of it, or that it takes too much.
    """
    found = path.stat()
    _tried(path.absolute(), found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=64)
def _tried(path: Path, changed: int, size: int) -> None:
    """Of a file that has not changed since, it is known."""
    words = [sys.executable, "-c", _TRIAL, str(path)]
    small = os.environ | {"MALLOC_ARENA_MAX": "2"}  # or every thread reserves memory that it does not use
    try:
        done = subprocess.run(words, capture_output=True, env=small, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired as error:
        problem = f"MuJoCo did not read it within {SECONDS} s"
        raise ArtifactError(problem, where=path, remedy="make it smaller, with no pipe among its files") from error
    if done.returncode == 0:
        return
    said = " ".join(done.stdout.decode(errors="replace").split())[:300]
    if done.returncode != _CANNOT or "bad_alloc" in said or "allocat" in said or said == "MemoryError":
        problem = f"MuJoCo ended while it read it, or wanted more than {MEMORY // 10**9} GB ({said or done.returncode})"
        raise ArtifactError(problem, where=path, remedy="make it smaller")
    raise ArtifactError(f"MuJoCo cannot read it ({said})", where=path, remedy="correct the model")
