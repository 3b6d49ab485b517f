"""MuJoCo's library called by address: preparation of the process, and compiled `mj_step`."""

import ctypes
import os
import sys

import mujoco
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# links libmujoco, whose symbols resolve through it
_LIBRARY = ctypes.CDLL(mujoco._functions.__file__)


def prepare_mujoco() -> int:
    """Address of libmujoco's ``mj_step``; changes MuJoCo in the whole process.

    Warnings are only counted (``mjData.warning``). Profiling timers stop: the Python bindings set a
    clock whose readings are a tenth of the time of ``mj_step`` (docs/engines.md), and
    ``mujoco.set_mjcb_time`` cannot remove it. A fatal error ends the process with one line: called
    by address, MuJoCo cannot raise an exception, and ``mju_error`` must not return, as MuJoCo would
    continue with an invalid state.
    """
    # without a handler of its own MuJoCo writes MUJOCO_LOG.TXT; the counters show faults
    mujoco.set_mju_user_warning(lambda _: None)

    ctypes.c_void_p.in_dll(_LIBRARY, "mjcb_time").value = None

    error_handler = ctypes.cast(_end_process, ctypes.c_void_p).value
    ctypes.c_void_p.in_dll(_LIBRARY, "mju_user_error").value = error_handler

    return ctypes.cast(_LIBRARY.mj_step, ctypes.c_void_p).value or 0


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _end_process(message: bytes) -> None:
    problem = " ".join(message.decode(errors="replace").split())
    remedy = "run again: training resumes from its checkpoint"
    sys.stderr.write(f"\nerror: MuJoCo stopped: {problem} -> {remedy}\n")
    sys.stderr.flush()
    os._exit(2)


@intrinsic
def mj_step(typingctx, function, model, data):  # pyright: ignore  # compiled signature below
    """Advance one physics step; all three arguments are integer addresses."""
    signature = types.void(types.intp, types.intp, types.intp)

    def codegen(context, builder, signature, arguments):
        function_address, *data_addresses = arguments

        pointer = ir.IntType(8).as_pointer()
        function_type = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        call = builder.inttoptr(function_address, function_type.as_pointer())
        builder.call(call, [builder.inttoptr(address, pointer) for address in data_addresses])

        return context.get_dummy_value()

    return signature, codegen
