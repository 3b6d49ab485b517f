"""The command line `motorprior`: parse, run the command, and turn errors into exit codes."""

import os
import sys
from typing import NoReturn

from motorprior.cli.parse import parse
from motorprior.cli.terminal import TERMINAL
from motorprior.exceptions import MotorPriorError

_BROKEN_PIPE = 141  # exit code of a shell command that SIGPIPE ends
_INTERRUPTED = 130
# modules of Python that Windows lacks, without which no robot is reached
_POSIX = ("fcntl", "pty", "resource", "termios")


def main() -> None:
    """Run a command line; exit code 2 and one line for bad input, 130 if interrupted."""
    _use_one_blas_thread()
    try:
        _run(sys.argv[1:])
    except MotorPriorError as error:
        _fail(error.on_command_line())
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("motorprior"):
            raise
        if error.name in _POSIX:
            _fail("this command needs Linux or macOS -> on Windows, run it in WSL")
        _fail(
            f"{error.name} is not installed -> pip install {error.name}; "
            "the robot's own computer has only deploy, record and doctor (docs/hardware.md)"
        )
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(_BROKEN_PIPE) from None
    except OSError as error:  # a folder that disappears, a full disk
        place = f"{error.filename}: " if error.filename is not None else ""
        problem = f"{place}{error.strerror or error}"
        _fail(f"{problem} -> check the path, its permissions and the free space")
    except MemoryError as error:
        _fail(f"not enough memory ({error}) -> use smaller numbers, or a larger machine")
    except (KeyboardInterrupt, SystemError) as error:
        # compiled code turns an interruption into a SystemError
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        TERMINAL.note("interrupted: what was finished is kept, run the same command again")
        raise SystemExit(_INTERRUPTED) from None


def _run(words: list[str]) -> None:
    try:
        command, settings = parse(words)
        run = command.load_run()
        run(settings, TERMINAL)
    finally:
        sys.stdout.flush()  # a broken pipe is an error here, not at the end of the process


def _use_one_blas_thread() -> None:
    """Before numpy is imported: two BLAS threads make small products ten times slower."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _fail(message: str) -> NoReturn:
    print(f"error: {message}", file=sys.stderr, flush=True)
    raise SystemExit(2) from None
