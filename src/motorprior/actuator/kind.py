"""What an actuator model says about itself, and the addresses by which compiled code calls it.

Compiled code calls a kind's functions through addresses that travel in `ActuatorArrays.law`, as it calls MuJoCo. A new
kind therefore changes no compiled code: kernels that were compiled, or cached on disk, before it existed run it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import typeof, types

from motorprior.actuator.actuator import ActuatorArrays, Law
from motorprior.compiled import njit

# Step [s] of the dynamometer for motors without a finer one of their own: that of a robot's simulation
BENCH_STEP = 0.002


@njit(cache=True, nogil=True)
def read_joint(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """(n,) angle [rad] of an encoder on the joint."""
    out[:] = joint_pos


@njit(cache=True, nogil=True)
def keep_implicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    """Leave torque and damping alone: the engine can integrate a damping that never changes."""


def keep_stiffness(arrays: ActuatorArrays, largest: float) -> None:
    """Leave motors without a gear of their own alone."""


@dataclass(frozen=True)
class ActuatorKind:
    """An actuator model's description of itself; its own file makes one.

    The functions are compiled (``njit``), write into their last argument and raise nothing. Vectors are (n,) float64.

    Attributes:
        name: in files and figures.
        title: for readers.
        reset: (arrays, position_target [rad], joint_pos [rad]) puts the memory at rest.
        step: (arrays, physics_dt [s], position_target [rad], joint_pos [rad], joint_vel [rad/s], torque [N·m]) writes
            the torque of the coming step, and ``arrays.damping`` where the model renews it.
        measure: (arrays, joint_pos [rad], out [rad]) reads the motors' own encoders.
        make_explicit: (arrays, joint_vel [rad/s], torque [N·m]) takes a damping that is renewed every step out of
            ``arrays`` and puts it into the torque, for an engine that cannot renew it.
        limit_stiffness: (arrays, largest [N·m/rad]) bounds the stiffness of gears, for such an engine; not compiled.
        longest_step: longest physics step [s], infinite if any will do; see `Robot.physics_step`.
        bench_step: longest step on the dynamometer [s].
    """

    name: str
    title: str
    reset: Any
    step: Any
    measure: Any = read_joint
    make_explicit: Any = keep_implicit
    limit_stiffness: Callable[[ActuatorArrays, float], None] = keep_stiffness
    longest_step: float = np.inf
    bench_step: float = BENCH_STEP

    @cached_property
    def law(self) -> Law:
        """Addresses of the compiled functions in this process; compiles them, or loads them from the cache."""
        arrays, vector = arrays_type(), types.Array(types.float64, 1, "C")
        pair, step = (arrays, vector, vector), (arrays, types.float64, *[vector] * 4)
        return Law(
            _address(self.reset, pair),
            _address(self.step, step),
            _address(self.measure, pair),
            _address(self.make_explicit, pair),
        )


@cache
def arrays_type() -> types.Type:
    """Numba's type of all `ActuatorArrays`."""
    single, small = np.zeros((1, 1, 1), np.float32), np.zeros(1, np.float32)
    table, count = np.zeros((1, 1)), np.zeros(1, np.int64)
    return typeof(ActuatorArrays(Law(0, 0, 0, 0), table, table, count, table[0], small, count, single, single, single))


def _address(function: Any, arguments: tuple[types.Type, ...]) -> int:
    """Of the code of a compiled function with numba's own calling convention; its dispatcher keeps it alive."""
    compiled = function.get_compile_result(types.none(*arguments))
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
