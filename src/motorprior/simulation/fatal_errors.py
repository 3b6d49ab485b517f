"""Handler of MuJoCo's fatal errors in compiled code: it saves the results, then ends the process.

Called through its Python bindings MuJoCo raises an exception. Called by address it cannot; ``mju_error`` must not
return, and by default ends the process at once.
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
_SAVERS: list[Callable[[], str]] = []
_ENDING = threading.Lock()  # held by the first thread with a fatal error until the process ends
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


@contextmanager
def saved_on_fatal_error(save: Callable[[], str]) -> Iterator[None]:
    """Within this context, call ``save`` before a fatal error of MuJoCo ends the process.

    Args:
        save: saves the results so far, in the thread of the error; returns a message for the user.
    """
    _SAVERS.append(save)
    try:
        yield
    finally:
        _SAVERS.remove(save)


def install_handler() -> None:
    """Install the handler of MuJoCo's fatal errors, for the whole process."""
    pointer = ctypes.c_void_p.in_dll(library(), "mju_user_error")
    pointer.value = ctypes.cast(_end_process, ctypes.c_void_p).value


@_HANDLER
def _end_process(message: bytes) -> None:
    """Save, report and end the process; it must not return, as MuJoCo would continue with an invalid state."""
    _ENDING.acquire()  # a second thread waits here until the first has ended the process
    saved = "there were no results to save"
    try:
        if _SAVERS:
            saved = "; ".join(save() for save in _SAVERS) + "; run the same command again to continue"
    except BaseException as error:
        saved = f"the results could not be saved ({type(error).__name__}: {error})"
    finally:
        problem = " ".join(message.decode(errors="replace").split())
        sys.stderr.write(f"\nerror: MuJoCo stopped: {problem} -> {saved}\n")
        sys.stderr.flush()
        os._exit(EXIT_CODE)
