"""Grey boxes: geared motors whose constants are decoded from a latent z (`geared_motor`).

The model simulates the rotor, so the engine gets no armature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, Factors, empty_arrays, require_step
from motorprior.actuator.copula import Copula
from motorprior.actuator.geared_motor import (
    DAMPING,
    SOFTENED,
    STIFFNESS,
    GearedMotor,
    measure,
    memory_rows,
    motor_table,
    reset,
    step_lanes,
)
from motorprior.actuator.geared_motor_step import with_logged_gains
from motorprior.actuator.kernels import ActuatorKind
from motorprior.actuator.optional_terms import HALF_WARM, OperatingConditions
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError


@dataclass(frozen=True)
class GreyBox:
    """The decoder from a latent z to the constants of a geared motor."""

    motor: GearedMotor
    period: float  # sample period of the fitted logs, the largest physics step [s]
    copula: Copula | None = None  # maps z ~ N(0, I) to the decoder's latents; None: z itself
    gain_unit: str = ""  # unit of logged gains (`MotorLog`) that kp and kd_over_kp are multiples of; "": absolute gains

    @property
    def num_latents(self) -> int:
        """Z."""
        return len(self.motor.slope)

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for motors with latents z (n, Z)."""
        return z if self.copula is None else self.copula.decoder_latents(z)

    def constants(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) physical constants by name of cold motors at nominal conditions.

        With a ``gain_unit``, kp and kd_over_kp are multiples of logged gains (`with_logged_gains`).
        """
        return self.motor.decode(self.decoder_latents(z))

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        return self.constants(z)["armature"]

    def warmth(self, z: np.ndarray, seconds: float) -> np.ndarray | float:
        """(n,) warmth of motors ``seconds`` [s] after a cold start; 0 without the term heat."""
        if "heat" not in self.motor.terms:
            return 0.0
        return 1.0 - np.exp(-seconds / self.constants(z)["heat_time"])

    def motors(
        self, z: np.ndarray, conditions: OperatingConditions = HALF_WARM, gains: np.ndarray | None = None
    ) -> GreyBoxActuator:
        """Motors with latents z (n, Z)."""
        return GreyBoxActuator(self, z, conditions, gains)


@dataclass(frozen=True, repr=False)
class GreyBoxActuator(Actuator):
    """n motors of one grey box."""

    model: GreyBox  # shared by all motors
    z: np.ndarray  # (n, Z)
    conditions: OperatingConditions = HALF_WARM
    gains: np.ndarray | None = None  # (2, n) kp and kd in the model's ``gain_unit``; if that is "", factors on gains
    factors: Factors | None = None  # multiply the constants

    def __repr__(self) -> str:
        return f"{self.num_motors} grey-box motors, see constants()"

    @property
    def kind(self) -> ActuatorKind:
        """GREY_BOX."""
        return GREY_BOX

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.z)

    def with_factors(self, factors: Factors) -> GreyBoxActuator:
        """See `actuator.with_factors`. The integral gain, kp·integral_rate, scales with kp."""
        self._require_gains()
        before = self.factors
        return replace(self, factors=factors if before is None else Factors(*np.multiply(before, factors)))

    def _require_gains(self) -> None:
        if self.model.gain_unit and self.gains is None:
            raise ConfigError(
                f"these motors were learned with logged gains [{self.model.gain_unit}]",
                remedy="give their gains", argument="gains",
            )  # fmt: skip

    def constants(self) -> dict[str, np.ndarray]:
        """(n,) constants by name, at these conditions, with gains and factors."""
        self._require_gains()
        values = self.model.motor.decode(self.model.decoder_latents(self.z), self.conditions)
        if self.gains is not None:
            values = with_logged_gains(values, *self.gains)
        if self.factors is None:
            return values
        kp, kd, torque_limit, coulomb = self.factors
        others = {"torque_limit": torque_limit, "coulomb": coulomb, "stribeck_torque": coulomb}
        return with_logged_gains(values, kp, kd) | {name: values[name] * factor for name, factor in others.items()}

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`; raises `ConfigError` if gains are missing, too."""
        require_step(physics_dt, self.model.period)
        table = motor_table(self.constants(), physics_dt, self.model.motor.terms)
        return empty_arrays(GREY_BOX, table, memory_rows(physics_dt), 1)


@njit(cache=True, nogil=True)
def _make_explicit(arrays: ActuatorArrays, joint_vel: np.ndarray, torque: np.ndarray) -> None:
    # the engine does not damp, so the rotors get no momentum from its damping in the next step
    for motor in range(torque.shape[0]):
        torque[motor] -= arrays.damping[motor] * joint_vel[motor]
    arrays.damping[:] = 0.0
    arrays.memory[DAMPING, :] = 0.0


def _limit_stiffness(arrays: ActuatorArrays, max_stiffness: float) -> None:
    stiffness, softened = arrays.parameters[STIFFNESS], arrays.parameters[SOFTENED]
    softened[:] = 1.0 - (1.0 - softened) * np.minimum(1.0, max_stiffness / stiffness)
    np.minimum(stiffness, max_stiffness, out=stiffness)


GREY_BOX = ActuatorKind(
    "grey_box", "grey box", reset=reset, step=step_lanes, measure=measure, make_explicit=_make_explicit,
    limit_stiffness=_limit_stiffness,
)  # fmt: skip
