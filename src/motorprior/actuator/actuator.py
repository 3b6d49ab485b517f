"""Interface of motors: (position_target, joint_pos, joint_vel, memory) -> torque, memory.

Every actuator model is data for compiled functions of its own. `Actuator.arrays` gives both;
`kernels.step_actuator` runs them. Shared conventions: error = position_target - joint_pos [rad];
a positive torque [N·m] accelerates the joint in its positive direction; ``armature`` [kg·m²] and
``damping`` [N·m·s/rad] belong to the physics engine, which integrates them implicitly, so that

    (joint_inertia + armature)·ddq = torque - damping·dq + everything else.

An actuator may renew its damping every step (a gear that touches): engines read it from ``ActuatorArrays.damping``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from motorprior.exceptions import ConfigError

if TYPE_CHECKING:
    from motorprior.actuator.kernels import ActuatorKind


class KernelTable(NamedTuple):
    """Addresses of the compiled functions of one kind of motors, in this process; see `ActuatorKind`."""

    reset: int
    step: int
    measure: int
    make_explicit: int


class ActuatorArrays(NamedTuple):
    """What compiled code sees of n motors (in blocks of 16 lanes where a network is evaluated).

    Fields unused by a kind are empty. ``parameters`` and ``memory`` rows are named in that kind's module.
    """

    kernels: KernelTable
    parameters: np.ndarray  # (rows, n) float64
    memory: np.ndarray  # (rows, n) float64, state
    clock: np.ndarray  # (2,) int64: steps since reset; steps per renewal (learned) or substeps per step (physical)
    damping: np.ndarray  # (n,) float64 [N·m·s/rad] that the engine integrates implicitly in the coming step
    weights: np.ndarray  # flat float32: the layers' matrices, row-major
    inputs: np.ndarray  # (inputs,) int64: rows of the history that the network sees, counted from the newest
    biases: np.ndarray  # (blocks, neurons of all layers, 16) float32; z is folded into the first layer's
    history: np.ndarray  # (blocks, 4·ring, 16) float32: scaled error twice, then velocity twice; state
    scratch: np.ndarray  # (blocks, neurons of all layers, 16) float32


def empty_arrays(
    kind: ActuatorKind, parameters: np.ndarray, memory_rows: int, renewal: int, damping: np.ndarray | None = None
) -> ActuatorArrays:
    """Arrays of a kind that needs no network; ``damping`` (n,) is zero if not given."""
    nothing = np.zeros((0, 0, 16), np.float32)
    return ActuatorArrays(
        kernels=kind.kernels,
        parameters=np.ascontiguousarray(parameters, dtype=np.float64),
        memory=np.zeros((memory_rows, parameters.shape[1])),
        clock=np.array([0, renewal], dtype=np.int64),
        damping=np.zeros(parameters.shape[1]) if damping is None else np.array(damping, dtype=np.float64),
        weights=np.zeros(0, np.float32),
        inputs=np.zeros(0, np.int64),
        biases=nothing,
        history=nothing.copy(),
        scratch=nothing.copy(),
    )


class Actuator(Protocol):
    """A model of ``num_motors`` motors. It holds parameters, never state."""

    @property
    def kind(self) -> ActuatorKind:
        """The model's description of itself."""
        ...

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        ...

    @property
    def armature(self) -> np.ndarray:
        """(n,) reflected inertia [kg·m²] for the engine."""
        ...

    @property
    def damping(self) -> np.ndarray:
        """(n,) viscous damping [N·m·s/rad] at the start, for the engine to integrate implicitly."""
        ...

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """Fresh arrays for a simulation with step ``physics_dt`` [s].

        Raises:
            ConfigError: the model cannot run at that step.
        """
        ...


def require_step(physics_dt: float, longest: float = np.inf) -> None:
    """Raise `ConfigError` unless the physics step [s] is in (0, longest]."""
    if not 0.0 < physics_dt <= longest * (1 + 1e-9):
        raise ConfigError(
            f"physics step {physics_dt:g} s is not in (0, {longest:g}] s, the steps these motors can be simulated at",
            remedy=f"use a positive step of at most {longest:g} s",
        )


def require_motors(actuator: object, count: int) -> None:
    """Raise `ConfigError` unless this is an actuator of ``count`` motors: compiled code would leave its arrays."""
    given = getattr(actuator, "num_motors", None)
    if given != count:
        found = f"{type(actuator).__name__} is no set of motors" if given is None else f"{given} motors"
        raise ConfigError(
            f"motors: {found} for the {count} joints of the robot",
            remedy=f"draw {count} motors, for example with MotorPrior.sample", argument="motors",
        )  # fmt: skip


class Factors(NamedTuple):
    """What the constants of n motors are multiplied by, (n,) each [-]."""

    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    coulomb: np.ndarray  # dry friction, static included, that of the load not

    @classmethod
    def ones(cls, count: int) -> Factors:
        """Nothing changes."""
        return cls(*np.ones((len(cls._fields), count)))


@runtime_checkable
class HasConstants(Protocol):
    """An actuator whose constants can be multiplied."""

    def with_factors(self, factors: Factors) -> Actuator:
        """The same motors with their constants times these factors; raises as `with_factors`."""
        ...


def with_factors(actuator: Actuator, factors: Factors) -> Actuator:
    """The same motors with their constants times these factors.

    Raises:
        ConfigError: a factor is not 1 and the motors lack that constant.
    """
    if isinstance(actuator, HasConstants) and any(np.any(factor != 1.0) for factor in factors):
        return actuator.with_factors(factors)
    require_unchanged(actuator.kind, factors, *Factors._fields)
    return actuator


def require_unchanged(kind: ActuatorKind, factors: Factors, *missing: str) -> None:
    """Raise `ConfigError` if a factor on a constant that motors of this kind lack is not 1."""
    for name in missing:
        if np.any(getattr(factors, name) != 1.0):
            raise ConfigError(
                f"motors of the model {kind.name!r} ({kind.title}) have no {name} that could vary",
                remedy=f"leave the range of {name} at 1 to 1, or use motors that have it",
            )
