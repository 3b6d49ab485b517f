"""Handler of MuJoCo's fatal errors in compiled code: the results are saved, then the process ends.

Called through its Python bindings MuJoCo raises an exception. Called by address it cannot; ``mju_error`` must not
return, and by default ends the process at once. The handler first calls the registered functions that save results,
and prints the error in one line.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from motorprior.simulation.mj_call import library

EXIT_CODE = 2
_RESCUES: list[Callable[[], str]] = []
_DYING = threading.Lock()
"""Lock held by the first thread with a fatal error until the process ends."""
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


@contextmanager
def saved_on_fatal_error(rescue: Callable[[], str]) -> Iterator[None]:
    """Within this context, call ``rescue`` before a fatal error of MuJoCo ends the process.

    Args:
        rescue: saves the results so far, in the thread of the error; returns a message for the user.
    """
    _RESCUES.append(rescue)
    try:
        yield
    finally:
        _RESCUES.remove(rescue)


def install_handler() -> None:
    """Install the handler of MuJoCo's fatal errors, for the whole process."""
    pointer = ctypes.c_void_p.in_dll(library(), "mju_user_error")
    pointer.value = ctypes.cast(_end_process, ctypes.c_void_p).value


@_HANDLER
def _end_process(message: bytes) -> None:
    """Save, report and end the process; it must not return, as MuJoCo would continue with an invalid state."""
    _DYING.acquire()  # a second thread waits here until the first has ended the process
    kept = "nothing was being kept"
    try:
        if _RESCUES:
            kept = "; ".join(rescue() for rescue in _RESCUES) + "; run the same command again to continue"
    except BaseException as error:
        kept = f"what there was could not be kept ({type(error).__name__}: {error})"
    finally:
        said = " ".join(message.decode(errors="replace").split())
        sys.stderr.write(f"\nerror: MuJoCo stopped: {said} -> {kept}\n")
        sys.stderr.flush()
        os._exit(EXIT_CODE)
