"""Interface of motor models: (position_target, joint_pos, joint_vel, memory) -> torque, memory.

An actuator is data for compiled functions. `Actuator.arrays` returns both, and
`kernels.step_actuator` runs them. Conventions: error = position_target - joint_pos [rad]; a
positive torque [N·m] accelerates the joint in its positive direction; the physics engine integrates
``armature`` [kg·m²] and ``damping`` [N·m·s/rad] implicitly,

    (joint_inertia + armature)·ddq = torque - damping·dq + all other torques.

An actuator may change its damping every step (gear contact): engines read it from
``ActuatorArrays.damping``.
"""

from typing import NamedTuple, Protocol, Self

import numpy as np

from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import ActuatorKind
from motorprior.exceptions import ConfigError


class ConstantFactors(NamedTuple):
    """Factors on constants of n motors, (n,) each [-]."""

    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    coulomb: np.ndarray  # Coulomb and static friction, without load friction


class Actuator(Protocol):
    """A model of ``num_motors`` motors: parameters without state."""

    @property
    def kind(self) -> ActuatorKind:
        """Name, title and compiled functions of the model."""
        ...

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        ...

    @property
    def armature(self) -> np.ndarray:
        """(n,) reflected inertia [kg·m²] for the engine; 0 if the model simulates the rotor."""
        ...

    @property
    def damping(self) -> np.ndarray:
        """(n,) initial viscous damping [N·m·s/rad], which the engine integrates implicitly."""
        ...

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s].

        Raises:
            ConfigError: the model cannot run at such steps.
        """
        ...

    def with_factors(self, factors: ConstantFactors) -> Self:
        """The same motors with scaled constants.

        Raises:
            ConfigError: a factor is not 1, and the motors lack its constant (`require_unchanged`).
        """
        ...


def with_factors(actuator: Actuator, factors: ConstantFactors) -> Actuator:
    """`Actuator.with_factors`; the same actuator if all factors are 1."""
    is_unchanged = all(np.all(factor == 1.0) for factor in factors)
    return actuator if is_unchanged else actuator.with_factors(factors)


def empty_arrays(
    kind: ActuatorKind,
    parameters: np.ndarray,
    memory_rows: int,
    clock_ratio: int,
    damping: np.ndarray | None = None,
) -> ActuatorArrays:
    """Arrays of a kind without a network; ``damping`` (n,) is zero if not given."""
    num_motors = parameters.shape[1]
    if damping is None:
        damping = np.zeros(num_motors)
    return ActuatorArrays(
        kernels=kind.kernels,
        parameters=np.ascontiguousarray(parameters, dtype=np.float64),
        memory=np.zeros((memory_rows, num_motors)),
        clock=np.array([0, clock_ratio], dtype=np.int64),
        damping=np.array(damping, dtype=np.float64),
    )


def require_step(physics_dt: float, max_step: float = np.inf) -> None:
    """Raise `ConfigError` unless the physics step [s] is in (0, max_step]."""
    if 0.0 < physics_dt <= max_step * (1 + 1e-9):
        return
    raise ConfigError(
        f"physics step {physics_dt:g} s is not in (0, {max_step:g}] s, the range of these motors",
        remedy=f"use a positive step of at most {max_step:g} s",
    )


def require_motors(actuator: object, count: int) -> None:
    """Raise `ConfigError` unless this is an actuator of ``count`` motors.

    Compiled code does not check bounds.
    """
    num_motors = getattr(actuator, "num_motors", None)
    if num_motors == count:
        return

    problem = f"{num_motors} motors"
    if num_motors is None:
        problem = f"{type(actuator).__name__} is not an actuator"
    raise ConfigError(
        f"motors: {problem} for the {count} joints of the robot",
        remedy=f"sample {count} motors, for example with MotorPrior.sample",
        argument="motors",
    )


def require_unchanged(kind: ActuatorKind, factors: ConstantFactors, *missing: str) -> None:
    """Raise `ConfigError` if a factor is not 1 on a constant that motors of this kind lack."""
    for name in missing:
        if np.any(getattr(factors, name) != 1.0):
            raise ConfigError(
                f"motors of the model {kind.name!r} ({kind.title}) have no {name} that could vary",
                remedy=f"leave the range of {name} at 1 to 1, or use motors that have it",
            )
