"""What a bench, a validation and a twin ask of true motors, whatever their equations are."""

from __future__ import annotations

from dataclasses import Field
from typing import Any, ClassVar, Protocol

import numpy as np

from motorprior.actuator.actuator import Actuator


class TrueMotors(Protocol):
    """The constants of n motors that models are compared with; every field has shape (n,)."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def kp(self) -> np.ndarray:
        """Gain of the law [N·m/rad]."""
        ...

    @property
    def kd(self) -> np.ndarray:
        """Gain of the law [N·m·s/rad]."""
        ...

    @property
    def torque_limit(self) -> np.ndarray:
        """Of the law [N·m]."""
        ...

    @property
    def armature(self) -> np.ndarray:
        """Rotor inertia reflected to the output [kg·m²]."""
        ...

    @property
    def gear_stiffness(self) -> np.ndarray:
        """Of the gear in contact [N·m/rad]."""
        ...

    @property
    def gear_damping(self) -> np.ndarray:
        """Of the gear in contact [N·m·s/rad]."""
        ...

    def __len__(self) -> int:
        """Number of motors."""
        ...

    def take(self, index: np.ndarray) -> TrueMotors:
        """The motors at ``index``."""
        ...

    def actuator(self) -> Actuator:
        """The motors, ready to be simulated."""
        ...

    def after(self, seconds: float) -> TrueMotors:
        """The same motors after so many seconds [s] of work; themselves, where work changes nothing."""
        ...

    def logged(
        self, rng: np.random.Generator, period: float, joint_pos: np.ndarray, joint_vel: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the instruments beside these motors record of (steps, n) angles, velocities and torques.

        Args:
            rng: of the instruments' noise.
            period: sample period [s].
            joint_pos: [rad].
            joint_vel: [rad/s].
            torque: on the joint [N·m].
        """
        ...
