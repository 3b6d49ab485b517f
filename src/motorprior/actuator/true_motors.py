"""Physical motors, the ground truth of virtual benches and robots: what all their families share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, Factors
from motorprior.actuator.kernels import ActuatorKind
from motorprior.compiled import njit


class TrueMotors(Protocol):
    """n physical motors: a dataclass of parameters (n,), annotated with their units, "1" for ratios."""

    factor_names: ClassVar[Mapping[str, str]]  # parameter -> field of `Factors` that scales it
    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    armature: np.ndarray
    gear_stiffness: np.ndarray
    gear_damping: np.ndarray
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def kind(self) -> ActuatorKind:
        """Name, title and compiled functions of the family."""
        ...

    def __len__(self) -> int:
        """Number of motors."""
        return len(self.kp)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        ...

    def take(self, index: np.ndarray) -> Self:
        """The motors at ``index``."""
        return replace(self, **{each.name: getattr(self, each.name)[index] for each in fields(self)})

    def scaled(self, factors: Mapping[str, Any]) -> Self:
        """The motors with parameters multiplied by factors [-]."""
        return replace(self, **{name: getattr(self, name) * factor for name, factor in factors.items()})

    def actuator(self) -> PhysicalActuator:
        """The same motors as an `Actuator`."""
        return PhysicalActuator(self)

    def after(self, seconds: float) -> Self:
        """The motors after ``seconds`` [s] of operation: unchanged."""
        return self

    def logged(
        self, rng: np.random.Generator, period: float, joint_pos: np.ndarray, joint_vel: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Recorded (steps, n) angles [rad], velocities [rad/s] and torques [N·m]: the true ones, without noise."""
        return joint_pos, joint_vel, torque


@dataclass(frozen=True)
class PhysicalActuator(Actuator):
    """n physical motors. The model simulates the rotor, so the engine gets no armature."""

    motors: TrueMotors

    @property
    def kind(self) -> ActuatorKind:
        """The kind of the family."""
        return self.motors.kind

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.motors)

    @property
    def damping(self) -> np.ndarray:
        """(n,) damping of the output shaft [N·m·s/rad], 0 for some; that of the rotor is part of the model."""
        return getattr(self.motors, "output_damping", np.zeros(self.num_motors))

    def with_factors(self, factors: Factors) -> PhysicalActuator:
        """See `actuator.with_factors`."""
        scales = {name: getattr(factors, factor) for name, factor in self.motors.factor_names.items()}
        return PhysicalActuator(self.motors.scaled(scales))

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        return self.motors.arrays(physics_dt)


@njit(cache=True, nogil=True, inline="always")
def stribeck_share(speed: float, stribeck_velocity: float) -> float:
    """Share exp(-(speed/stribeck_velocity)²) of the static friction torque."""
    ratio = speed / stribeck_velocity
    return math.exp(-ratio * ratio)


@njit(cache=True, nogil=True, inline="always")
def voltage_limited(torque: float, limit: float, back: float) -> float:
    """The torque within the voltage limit: ``limit`` at zero speed, less ``back`` of the back-EMF [N·m]."""
    return min(max(0.0, limit - back), max(min(0.0, -limit - back), torque))
