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
"""Most that it may take beyond what MuJoCo itself takes, where the system counts it: time of a core [s], and memory
[bytes]."""
WAIT = 60
"""Longest wait for it, on a machine that does other things, too [s]."""
_CANNOT = 3
_TRIAL = f"""
import sys
import mujoco
try:
    import resource
    pages = int(open("/proc/self/statm").read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + {MEMORY}, resource.RLIM_INFINITY))
    used = resource.getrusage(resource.RUSAGE_SELF)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + {SECONDS}, resource.RLIM_INFINITY))
except (ImportError, OSError, ValueError):
    pass  # no such bounds on this system
try:
    mujoco.MjData(mujoco.MjModel.from_xml_path(sys.argv[1]))
except Exception as error:
    sys.stdout.buffer.write((str(error) or type(error).__name__).encode(errors="replace"))
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
    words = [sys.executable, "-P", "-c", _TRIAL, str(path)]  # -P: nothing is imported from the current folder
    small = os.environ | {"MALLOC_ARENA_MAX": "2"}  # or every thread reserves memory that it does not use
    try:
        done = subprocess.run(words, capture_output=True, env=small, timeout=WAIT, check=False)
    except subprocess.TimeoutExpired as error:
        problem = f"MuJoCo did not read it within {WAIT} s"
        raise ArtifactError(problem, where=path, remedy="make it smaller, with no pipe among its files") from error
    said, noise = (text.decode(errors="replace").strip() for text in (done.stdout, done.stderr))
    if done.returncode == _CANNOT and not _is_of_memory(said):
        raise cannot_read(path, said)
    if done.returncode:
        why = said or (noise.splitlines() or [f"it ended with {done.returncode}"])[-1]
        problem = (
            f"MuJoCo ended, or wanted more than {SECONDS} s or {MEMORY // 10**9} GB for it ({' '.join(why.split())})"
        )
        raise ArtifactError(problem, where=path, remedy="make it smaller")


def cannot_read(path: Path | None, said: str) -> ArtifactError:
    """What MuJoCo said of a model."""
    words = " ".join(said.split())[:300]
    return ArtifactError(f"MuJoCo cannot read it ({words})", where=path, remedy="correct the model")


def _is_of_memory(said: str) -> bool:
    return "bad_alloc" in said or "allocat" in said or said == "MemoryError"
