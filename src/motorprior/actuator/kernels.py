"""Kinds of actuators and their compiled kernels, which compiled code calls by address.

`ActuatorArrays.kernels` holds the addresses. A new kind of motors therefore needs no recompilation:
loops that were compiled, or cached on disk, before it existed can run it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import typeof, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic

from motorprior.actuator.arrays import ActuatorArrays, KernelTable
from motorprior.compiled import njit


@njit(cache=True, nogil=True)
def read_joint(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """Copy the joint angles [rad]: the encoder is on the joint."""
    out[:] = joint_pos


@njit(cache=True, nogil=True)
def keep_implicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Change nothing: the damping is constant, so any engine can integrate it."""


def keep_stiffness(arrays: ActuatorArrays, max_stiffness: float) -> None:
    """Change nothing: the motors have no gear."""


@dataclass(frozen=True)
class ActuatorKind:
    """Name and compiled functions of an actuator model.

    The functions are compiled (``njit``), write into their last argument and do not raise. Vectors
    are (n,) float64.
    """

    name: str  # name in files and figures
    title: str  # name in reports
    # (arrays, position_target [rad], joint_pos [rad]) resets the memory to a static motor
    reset: Any
    # (arrays, physics_dt [s], position_target [rad], joint_pos [rad], joint_vel [rad/s], torque
    # [N·m]) writes the torque of the coming step, and ``arrays.damping`` if it changes
    step: Any
    # (arrays, joint_pos [rad], out [rad]) reads the encoders of the motors
    read_encoders: Any = read_joint
    # (arrays, joint_vel [rad/s], torque [N·m]): moves changing dampings into the torque if the
    # engine's are constant
    make_explicit: Any = keep_implicit
    # (arrays, max_stiffness [N·m/rad]) limits the stiffness of gears, for such an engine; not
    # compiled
    limit_stiffness: Callable[[ActuatorArrays, float], None] = keep_stiffness
    # whether ``step`` reads `ActuatorArrays.frames`, the command frames of MIT mode
    takes_frames: bool = False
    max_step: float = np.inf  # maximum physics step [s]; see `Robot.physics_step`
    bench_step: float = 0.002  # maximum step on the dynamometer [s]

    @cached_property
    def kernels(self) -> KernelTable:
        """Addresses of the compiled functions in this process.

        The functions are compiled, or loaded from the cache.
        """
        arrays = arrays_type()
        vector = types.Array(types.float64, 1, "C")
        two_vectors = (arrays, vector, vector)
        step_and_vectors = (arrays, types.float64, vector, vector, vector, vector)
        return KernelTable(
            reset=_address(self.reset, two_vectors),
            step=_address(self.step, step_and_vectors),
            read_encoders=_address(self.read_encoders, two_vectors),
            make_explicit=_address(self.make_explicit, two_vectors),
        )


@cache
def arrays_type() -> types.Type:
    """Numba's type of all `ActuatorArrays`."""
    table = np.zeros((1, 1))
    kernels = KernelTable(0, 0, 0, 0)
    return typeof(ActuatorArrays(kernels, table, table, np.zeros(1, np.int64), table[0]))


def _address(function: Any, arguments: tuple[types.Type, ...]) -> int:
    # numba's own calling convention; the dispatcher keeps the code alive
    compiled = function.get_compile_result(types.none(*arguments))
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)


def _require_types(arrays: Any, vectors: tuple[Any, ...]) -> None:
    """Reject at compile time arrays that the function at an address would misread."""
    for vector in vectors:
        is_contiguous = isinstance(vector, types.Array) and vector.layout == "C"
        if not is_contiguous or vector.ndim != 1 or vector.dtype != types.float64:
            raise TypingError("the motors' arrays must be contiguous float64")
    if arrays != arrays_type():
        raise TypingError("the motors' arrays must be contiguous float64")


def _emit_call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Call the function at the address in the first argument, by numba's calling convention."""
    argument_types = signature.args[1:]
    convention = context.call_conv
    function_type = convention.get_function_type(types.none, argument_types).as_pointer()
    callee = builder.inttoptr(arguments[0], function_type)
    convention.call_function(builder, callee, types.none, argument_types, arguments[1:])
    return context.get_dummy_value()


def _without_owners(context: Any, builder: Any, numba_type: Any, value: Any) -> Any:
    if isinstance(numba_type, types.Array):
        array = context.make_array(numba_type)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(numba_type, types.BaseTuple):
        item_types: Any = numba_type.types  # pyright: ignore[reportAttributeAccessIssue]
        items = []
        for index, item_type in enumerate(item_types):
            item = builder.extract_value(value, index)
            items.append(_without_owners(context, builder, item_type, item))
        return context.make_tuple(builder, numba_type, items)
    return value


def _pair(typingctx, address, arrays, first, second):
    _require_types(arrays, (first, second))
    return types.void(types.intp, arrays, first, second), _emit_call


def _step(typingctx, address, arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    vectors = (position_target, joint_pos, joint_vel, torque)
    _require_types(arrays, vectors)
    return types.void(types.intp, arrays, types.float64, *vectors), _emit_call


def _uncounted(typingctx, arrays):
    def codegen(context, builder, signature, arguments):
        value = _without_owners(context, builder, signature.args[0], arguments[0])
        return impl_ret_untracked(context, builder, signature.return_type, value)

    return arrays(arrays), codegen


_call_pair: Any = intrinsic(_pair)
_call_step: Any = intrinsic(_step)
# For compiled code: an array, or a (named) tuple of arrays, without reference counting. Counting is
# an atomic instruction whenever an array is taken from a tuple or sliced, 10 % of the time of an
# episode. The caller of a compiled episode must keep references to all arrays until it returns.
without_refcounts: Any = intrinsic(_uncounted)


@njit(cache=True, nogil=True)
def reset_actuator(
    arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray
) -> None:
    """Reset the memory to a static motor: command and joint have never moved."""
    arrays.clock[0] = 0
    for row in range(1, arrays.frames.shape[0]):  # `command_frame`: the first row is sent
        arrays.frames[row, :] = arrays.frames[0, :]
    _call_pair(arrays.kernels.reset, arrays, position_target, joint_pos)


@njit(cache=True, nogil=True, inline="always")
def step_actuator(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write the (n,) torque [N·m] and ``arrays.damping`` for the coming physics step [s]."""
    _call_step(
        arrays.kernels.step, arrays, physics_dt, position_target, joint_pos, joint_vel, torque
    )
    arrays.clock[0] += 1


@njit(cache=True, nogil=True, inline="always")
def make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Add a changing damping to the torque, for an engine whose damping is constant.

    With gear stiffness k and a bare link of inertia I, a step h is stable only if 2·k·h²/I +
    gear_damping·h/I < 4: see `ActuatorKind.limit_stiffness`.
    """
    _call_pair(arrays.kernels.make_explicit, arrays, joint_vel, torque)


@njit(cache=True, nogil=True, inline="always")
def measure_joint_pos(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """Write (n,) joint angles [rad] as measured by the encoders of the motors."""
    _call_pair(arrays.kernels.read_encoders, arrays, joint_pos, out)
