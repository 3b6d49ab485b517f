"""mj_step by address, callable from compiled code that does not hold the interpreter lock.

The address is an argument, so compiled kernels stay cacheable across processes.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import ctypes
import os
import sys
import threading

import mujoco
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

EXIT_CODE = 2
_ENDING = threading.Lock()  # held by the first thread with a fatal error until the process ends


def library() -> ctypes.CDLL:
    """Libmujoco in this process."""
    return ctypes.CDLL(mujoco._functions.__file__)  # links libmujoco, whose symbols resolve through it


def stop_timers() -> None:
    """Stop MuJoCo's profiling timers (``mjData.timer``) in the whole process.

    The Python bindings give MuJoCo a clock, which every ``mj_step`` reads some twenty times: a tenth of its time
    (docs/engines.md). ``mujoco.set_mjcb_time`` cannot remove it.
    """
    ctypes.c_void_p.in_dll(library(), "mjcb_time").value = None


def end_on_fatal_error() -> None:
    """Let a fatal error of MuJoCo end the process with one line.

    Called through its Python bindings MuJoCo raises an exception. Called by address it cannot; ``mju_error`` must not
    return, as MuJoCo would continue with an invalid state.
    """
    pointer = ctypes.c_void_p.in_dll(library(), "mju_user_error")
    pointer.value = ctypes.cast(_end_process, ctypes.c_void_p).value


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _end_process(message: bytes) -> None:
    _ENDING.acquire()  # a second thread waits here until the first has ended the process
    problem = " ".join(message.decode(errors="replace").split())
    sys.stderr.write(f"\nerror: MuJoCo stopped: {problem} -> run again: a training goes on from its checkpoint\n")
    sys.stderr.flush()
    os._exit(EXIT_CODE)


def mj_step_address() -> int:
    """Address of libmujoco's ``mj_step`` in this process."""
    address = ctypes.cast(library().mj_step, ctypes.c_void_p).value
    assert address is not None
    return address


@intrinsic
def mj_step(typingctx, function, model, data):  # pyright: ignore  # compiled signature below
    """Advance one physics step; all three arguments are integer addresses."""
    signature = types.void(types.intp, types.intp, types.intp)

    def codegen(context, builder, signature, arguments):
        address, *pointers = arguments
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        call = builder.inttoptr(address, kind.as_pointer())
        builder.call(call, [builder.inttoptr(value, pointer) for value in pointers])
        return context.get_dummy_value()

    return signature, codegen
