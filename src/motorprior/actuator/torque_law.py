"""What compiled code and Python do with motors of any kind: reset, step, read the encoders.

Each calls the function of the motors' own kind by its address (`kind.ActuatorKind.law`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types
from numba.core.errors import TypingError
from numba.extending import intrinsic

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kind import arrays_type
from motorprior.compiled import njit


def _require_types(arrays: Any, vectors: tuple[Any, ...]) -> None:
    """Refuse at compile time what the function behind an address would misread."""
    contiguous = all(isinstance(each, types.Array) and each.layout == "C" and each.ndim == 1 for each in vectors)
    if arrays != arrays_type() or not contiguous or any(each.dtype != types.float64 for each in vectors):
        raise TypingError("the motors' arrays must be contiguous float64")


def _emit_call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Call the function at the first argument's address with the others, as numba calls functions."""
    kinds, convention = signature.args[1:], context.call_conv
    function = convention.get_function_type(types.none, kinds).as_pointer()
    callee = builder.inttoptr(arguments[0], function)
    convention.call_function(builder, callee, types.none, kinds, arguments[1:])
    return context.get_dummy_value()


if TYPE_CHECKING:

    def _call_pair(address: int, arrays: ActuatorArrays, first: np.ndarray, second: np.ndarray) -> None: ...

    def _call_step(address: int, arrays: ActuatorArrays, physics_dt: float, *vectors: np.ndarray) -> None: ...

else:

    @intrinsic
    def _call_pair(typingctx: Any, address: Any, arrays: Any, first: Any, second: Any) -> Any:
        """Of (arrays, vector, vector)."""
        _require_types(arrays, (first, second))

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _emit_call(context, builder, signature, arguments)

        return types.void(types.intp, arrays, first, second), codegen

    @intrinsic
    def _call_step(
        typingctx: Any, address: Any, arrays: Any, physics_dt: Any, target: Any, pos: Any, vel: Any, torque: Any
    ) -> Any:
        """Of (arrays, number, four vectors)."""
        _require_types(arrays, (target, pos, vel, torque))

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _emit_call(context, builder, signature, arguments)

        return types.void(types.intp, arrays, types.float64, target, pos, vel, torque), codegen


@njit(cache=True, nogil=True)
def reset_actuator(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Put the memory at rest, as if target and joint had always been where they are."""
    arrays.clock[0] = 0
    _call_pair(arrays.law.reset, arrays, position_target, joint_pos)


@njit(cache=True, nogil=True, inline="always")
def step_actuator(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write the (n,) torque [N·m] and ``arrays.damping`` for the physics step [s] that begins now."""
    _call_step(arrays.law.step, arrays, physics_dt, position_target, joint_pos, joint_vel, torque)
    arrays.clock[0] += 1


@njit(cache=True, nogil=True, inline="always")
def make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """For an engine that cannot renew its damping: put that of the coming step into the torque.

    Only a kind that renews it does; what an engine damps all the time stays with the engine. With the gear's stiffness
    k and a bare link of inertia I, a step h is stable only while 2·k·h²/I + gear_damping·h/I < 4: see
    `ActuatorKind.limit_stiffness`.
    """
    _call_pair(arrays.law.make_explicit, arrays, joint_vel, torque)


@njit(cache=True, nogil=True, inline="always")
def measure_joint_pos(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """(n,) joint angle [rad] as the motors' own encoders report it."""
    _call_pair(arrays.law.measure, arrays, joint_pos, out)
