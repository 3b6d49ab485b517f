"""What happens when MuJoCo meets a fatal error inside compiled code: the results are saved, then the process ends.

Called through its Python bindings MuJoCo raises; called by address it has no one to raise to, ``mju_error`` must
not return, and by default it would end the process there and then. The handler here first lets whoever has
results to lose save them, and says in one line what happened.
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
"""Taken by the first thread that dies, and never given back."""
_HANDLER = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


@contextmanager
def saved_on_fatal_error(rescue: Callable[[], str]) -> Iterator[None]:
    """While inside: call ``rescue`` before a fatal error of MuJoCo ends the process.

    Args:
        rescue: saves what there is, from whichever thread the error is in; returns what the user should know.
    """
    _RESCUES.append(rescue)
    try:
        yield
    finally:
        _RESCUES.remove(rescue)


def install_handler() -> None:
    """Make this the handler of MuJoCo's fatal errors, in the whole process."""
    pointer = ctypes.c_void_p.in_dll(library(), "mju_user_error")
    pointer.value = ctypes.cast(_end_process, ctypes.c_void_p).value


@_HANDLER
def _end_process(message: bytes) -> None:
    """It must not return: MuJoCo would go on with a broken state."""
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
