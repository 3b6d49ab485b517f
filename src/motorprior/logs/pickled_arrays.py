"""Arrays of a pickle or a file of torch.save, read in a child process with limits.

A pickle of plain values can still take hours (keys whose hash is slow) or much memory (nested empty
lists). The child process may use a memory and a time in proportion to the size of the file.
"""

import gc
import io
import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from motorprior.artifacts import require_file, require_size
from motorprior.exceptions import LogError
from motorprior.logs.motor_log import unreadable
from motorprior.logs.named_arrays import named_arrays
from motorprior.logs.pickles import load_pickle, torch_content

# limits of the child process
BASE_MEMORY = 1_000_000_000  # [B]
MEMORY_PER_BYTE = 16  # a list of tables of numbers takes ten times its pickle
BASE_SECONDS = 3  # of the processor
BYTES_PER_SECOND = 5_000_000
# deadline over the limit of the processor's time: other programs may run
DEADLINE_FACTOR = 5
# return codes of a process that the system ended at a limit: SIGKILL and SIGXCPU
_ENDED_AT_LIMIT = (-9, -24)
_REMEDY = "convert the file to .npz or CSV where it was made"


def pickled_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a .pt file or of a pickle by name, see `named_arrays`.

    Raises:
        LogError: a missing or damaged file, a pickle with anything but plain values, or one that
            takes more time or memory than its size explains. Or the child process failed, with
            the last line that it wrote.
    """
    require_file(path, LogError)
    size = path.stat().st_size
    memory = BASE_MEMORY + MEMORY_PER_BYTE * size
    seconds = BASE_SECONDS + size // BYTES_PER_SECOND
    over_limits = LogError(
        f"reading it takes more than {seconds} s or {memory / 1e9:.1f} GB",
        where=path,
        remedy=_REMEDY,
    )

    # -P: a file pickle.py in the current folder is not imported
    command = [sys.executable, "-P", "-m", __name__, str(path), str(memory), str(seconds)]
    try:
        child = subprocess.run(
            command,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=DEADLINE_FACTOR * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise over_limits from error
    except OSError as error:
        problem = f"the process that reads it cannot start ({error})"
        raise LogError(problem, where=path, remedy=_REMEDY) from error
    if child.returncode in _ENDED_AT_LIMIT or b"MemoryError" in child.stderr:
        raise over_limits
    if child.returncode != 0:
        raise _failure(child, path)

    answer = io.BytesIO(child.stdout)
    header = json.loads(answer.readline())
    if "problem" in header:
        raise LogError(header["problem"], where=path, remedy=header["remedy"])
    return {name: np.lib.format.read_array(answer, allow_pickle=False) for name in header["names"]}


def _failure(child: subprocess.CompletedProcess[bytes], path: Path) -> LogError:
    """The error for a child process that failed below its limits."""
    lines = child.stderr.decode(errors="replace").splitlines()
    reason = lines[-1][:300] if lines else "no message"
    problem = f"the process that reads it failed with return code {child.returncode} ({reason})"
    return LogError(problem, where=path, remedy=_REMEDY)


def _environment() -> dict[str, str]:
    """Variables of the child process: it finds this package, and starts no threads."""
    package = str(Path(__file__).parents[2])
    folders = [package, os.environ.get("PYTHONPATH", "")]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, folders)),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }


def _limit(memory: int, seconds: int) -> None:
    """Limit this process; on Windows, the parent's deadline is the only limit."""
    try:
        import resource
    except ImportError:
        return
    for limit, value in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds)):
        with suppress(ValueError, OSError):  # a system without this limit, or with a lower one
            resource.setrlimit(limit, (value, value))


def _answer(path: Path, output: BinaryIO) -> None:
    """Write a line of JSON with the names of the arrays, and the arrays; or only the error."""
    try:
        arrays = named_arrays(_content(path))
        require_size(sum(array.nbytes for array in arrays.values()), path, LogError)
    except Exception as error:  # damaged files raise many types
        refusal = _as_log_error(error, path)
        _write_line({"problem": refusal.problem, "remedy": refusal.remedy}, output)
        return

    _write_line({"names": list(arrays)}, output)
    for array in arrays.values():
        np.lib.format.write_array(output, array, allow_pickle=False)


def _as_log_error(error: Exception, path: Path) -> LogError:
    if isinstance(error, LogError):
        return error
    if isinstance(error, MemoryError):
        return LogError("it takes more memory than its size explains", remedy=_REMEDY)
    return unreadable(path, error)


def _write_line(header: dict[str, Any], output: BinaryIO) -> None:
    output.write(json.dumps(header).encode() + b"\n")


def _content(path: Path) -> Any:
    if path.suffix == ".pt":
        return torch_content(path)
    return load_pickle(path.read_bytes())


if __name__ == "__main__":
    gc.disable()  # it would search millions of new lists again and again
    _limit(int(sys.argv[2]), int(sys.argv[3]))
    _answer(Path(sys.argv[1]), sys.stdout.buffer)
