"""Interface of motor models: (position_target, joint_pos, joint_vel, memory) -> torque, memory.

An actuator is data for compiled functions. `Actuator.arrays` returns both, and
`kernels.step_actuator` runs them. Conventions: error = position_target - joint_pos [rad]; a
positive torque [N·m] accelerates the joint in its positive direction; the physics engine integrates
``armature`` [kg·m²] and ``damping`` [N·m·s/rad] implicitly,

    (joint_inertia + armature)·ddq = torque - damping·dq + all other torques.

An actuator may change its damping every step (gear contact): engines read it from
``ActuatorArrays.damping``.
"""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from motorprior.exceptions import ConfigError

if TYPE_CHECKING:
    from motorprior.actuator.kernels import ActuatorKind


_NO_BLOCKS = np.zeros((0, 0, 16), np.float32)


class KernelTable(NamedTuple):
    """Addresses of an actuator kind's compiled functions in this process; see `ActuatorKind`."""

    reset: int
    step: int
    measure: int
    make_explicit: int


class ActuatorArrays(NamedTuple):
    """Arrays of n motors for compiled code. Networks are evaluated in blocks of 16 motors.

    The module of a kind names the rows of ``parameters`` and ``memory``. The fields from
    ``weights`` on are those of networks.
    """

    kernels: KernelTable
    parameters: np.ndarray  # (rows, n) float64
    memory: np.ndarray  # (rows, n) float64, state
    # (2,) int64: steps since reset; steps per network update, or substeps per step
    clock: np.ndarray
    # (n,) float64 [N·m·s/rad] that the engine integrates implicitly in the coming step
    damping: np.ndarray
    weights: np.ndarray = np.zeros(0, np.float32)  # flat: matrices of the layers, row-major
    # (inputs,) rows of the history that are inputs, counted from the newest
    inputs: np.ndarray = np.zeros(0, np.int64)
    # (blocks, neurons of all layers, 16); the first layer's include z
    biases: np.ndarray = _NO_BLOCKS
    # (blocks, 4·ring, 16): scaled error twice, then velocity twice; state
    history: np.ndarray = _NO_BLOCKS
    scratch: np.ndarray = _NO_BLOCKS  # (blocks, inputs and neurons of all layers, 16)


def empty_arrays(
    kind: "ActuatorKind",
    parameters: np.ndarray,
    memory_rows: int,
    clock_ratio: int,
    damping: np.ndarray | None = None,
) -> ActuatorArrays:
    """Arrays of a kind without a network; ``damping`` (n,) is zero if not given."""
    return ActuatorArrays(
        kernels=kind.kernels,
        parameters=np.ascontiguousarray(parameters, dtype=np.float64),
        memory=np.zeros((memory_rows, parameters.shape[1])),
        clock=np.array([0, clock_ratio], dtype=np.int64),
        damping=np.zeros(parameters.shape[1])
        if damping is None
        else np.array(damping, dtype=np.float64),
    )


class Actuator(Protocol):
    """A model of ``num_motors`` motors: parameters without state.

    Armature and damping default to zero, for models that simulate the rotor themselves.
    """

    @property
    def kind(self) -> "ActuatorKind":
        """Name, title and compiled functions of the model."""
        ...

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        ...

    @property
    def armature(self) -> np.ndarray:
        """(n,) reflected inertia [kg·m²] for the engine."""
        return np.zeros(self.num_motors)

    @property
    def damping(self) -> np.ndarray:
        """(n,) initial viscous damping [N·m·s/rad], which the engine integrates implicitly."""
        return np.zeros(self.num_motors)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; ConfigError if the model cannot run at such steps."""
        ...


def require_step(physics_dt: float, max_step: float = np.inf) -> None:
    """Raise `ConfigError` unless the physics step [s] is in (0, max_step]."""
    if not 0.0 < physics_dt <= max_step * (1 + 1e-9):
        raise ConfigError(
            f"physics step {physics_dt:g} s is not in (0, {max_step:g}] s, the range of these motors",
            remedy=f"use a positive step of at most {max_step:g} s",
        )


def require_motors(actuator: object, count: int) -> None:
    """Raise `ConfigError` unless this is an actuator of ``count`` motors: compiled code does not check bounds."""
    given = getattr(actuator, "num_motors", None)
    if given != count:
        found = (
            f"{type(actuator).__name__} is not an actuator" if given is None else f"{given} motors"
        )
        raise ConfigError(
            f"motors: {found} for the {count} joints of the robot",
            remedy=f"sample {count} motors, for example with MotorPrior.sample",
            argument="motors",
        )


class Factors(NamedTuple):
    """Factors on constants of n motors, (n,) each [-]."""

    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    coulomb: np.ndarray  # Coulomb and static friction, without load friction


def with_factors(actuator: Actuator, factors: Factors) -> Actuator:
    """The same motors with scaled constants; ConfigError if a factor is not 1 and the motors lack that constant."""
    if hasattr(actuator, "with_factors") and any(np.any(factor != 1.0) for factor in factors):
        return actuator.with_factors(factors)  # pyright: ignore[reportAttributeAccessIssue]
    require_unchanged(actuator.kind, factors, *Factors._fields)
    return actuator


def require_unchanged(kind: "ActuatorKind", factors: Factors, *missing: str) -> None:
    """Raise `ConfigError` if a factor is not 1 on a constant that motors of this kind lack."""
    for name in missing:
        if np.any(getattr(factors, name) != 1.0):
            raise ConfigError(
                f"motors of the model {kind.name!r} ({kind.title}) have no {name} that could vary",
                remedy=f"leave the range of {name} at 1 to 1, or use motors that have it",
            )
