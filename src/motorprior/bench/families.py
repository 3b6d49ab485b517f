"""Families of true motors that a fleet can be of: their parameters with units and bounds, and what makes the motors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator import out_of_family, physical
from motorprior.actuator.kernels import ActuatorKind
from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.actuator.physical import MotorParameters
from motorprior.exceptions import ConfigError

TrueMotors = MotorParameters | OutOfFamilyMotors


@dataclass(frozen=True)
class Family:
    """Motors of the same equations."""

    name: str  # in a fleet's file and in bench.json
    motor: str  # what such a motor has, for readers
    kind: ActuatorKind  # of the actuator
    # the motors' constructor; its fields are the parameters, with kd_over_kp in place of kd
    make: Callable[..., TrueMotors]
    units: Mapping[str, str]  # of the parameters, in the order in which a sample draws them
    positive: frozenset[str]  # parameters above 0
    largest: Mapping[str, float]  # upper bounds, of parameters that have one of their own
    signed: frozenset[str]  # parameters that may be negative
    substep: float  # longest substep of the rotor [s]
    stiffness: tuple[str, ...]  # parameters [N·m/rad] of springs between the rotor and what holds it
    damping: tuple[str, ...]  # parameters [N·m·s/rad] that damp the rotor by its velocity before the substep
    optional: frozenset[str] = frozenset()  # parameters that may be left out, which then are 0: their term is off

    def motors(self, values: Mapping[str, np.ndarray]) -> TrueMotors:
        """The motors of these parameters, (n,) each."""
        known = {**values, "kd": values["kp"] * values["kd_over_kp"]}
        missing = np.zeros(len(known["kp"]))
        return self.make(**{name: known.get(name, missing) for name in (*self.units, "kd") if name != "kd_over_kp"})

    def require_stable(self, values: Mapping[str, np.ndarray], where: str | Path) -> None:
        """Raise `ConfigError` unless the rotor of every motor can be simulated on its gear.

        In substeps of h the speed of a rotor of armature J, on springs of stiffness k in all and with damping d, is
        renewed by the torques before the substep, its angle by the speed after it. In contact that is stable if and
        only if 2·d·h + k·h² < 4·J: Jury's criterion for z² - (2 - d·h/J - k·h²/J)·z + 1 - d·h/J. Where a gear hardens,
        c·s³ at twist s, k is that at the torque limit: k·s + c·s³ = torque_limit, and 3·c·s² is added to it. ``values``
        are (n,) each.
        """
        h, armature = self.substep, values["armature"]
        stiffness = self._sum(self.stiffness, values) + _hardened(values)
        damping = self._sum(self.damping, values)
        least = (2.0 * damping * h + stiffness * h * h) / 4.0
        if not (armature > least).all():
            worst = int(np.argmin(armature / least))
            raise ConfigError(
                f"armature = {armature[worst]:.3g} kg·m² cannot be simulated with {' + '.join(self.stiffness)} = "
                f"{stiffness[worst]:.3g} N·m/rad and {' + '.join(self.damping)} = {damping[worst]:.3g} N·m·s/rad in "
                f"steps of {1e3 * h:g} ms",
                where=where, remedy=f"give armature above {least[worst]:.3g} kg·m², or a softer, less damped gear",
            )  # fmt: skip

    def _sum(self, names: tuple[str, ...], values: Mapping[str, np.ndarray]) -> np.ndarray:
        return sum((values[name] for name in names if name in values), np.zeros(len(values["armature"])))


def _hardened(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n,) by how much a cubic gear is stiffer at the torque limit [N·m/rad], see `Family.require_stable`."""
    linear, cubic = values["gear_stiffness"], values.get("gear_hardening", np.zeros(1))
    if not np.any(cubic > 0.0):
        return np.zeros(len(linear))
    twist = values["torque_limit"] / linear
    for _ in range(50):  # Newton's method, from above the only root
        twist = twist - (linear * twist + cubic * twist**3 - values["torque_limit"]) / (linear + 3.0 * cubic * twist**2)
    return 3.0 * cubic * twist**2


# Motors of `actuator.physical`; the family of a fleet that names none
GEARED = Family(
    name="geared",
    motor="The physical motor has a rotor, a gear with backlash and stiffness, four kinds of friction, a torque-speed "
    "limit, a delay and a velocity filter; its encoder sits on the rotor.",
    kind=physical.PHYSICAL,
    make=MotorParameters,
    units={
        "kp": "N·m/rad", "kd_over_kp": "s", "delay": "s", "velocity_filter": "s", "torque_limit": "N·m",
        "stall_torque": "N·m", "no_load_speed": "rad/s", "armature": "kg·m²", "coulomb": "N·m",
        "stribeck_torque": "N·m", "stribeck_velocity": "rad/s", "viscous_damping": "N·m·s/rad", "load_friction": "1",
        "backlash": "rad", "gear_stiffness": "N·m/rad", "gear_damping": "N·m·s/rad", "encoder_zero": "rad",
    },
    positive=frozenset(
        {
            "kp", "kd_over_kp", "velocity_filter", "torque_limit", "stall_torque", "no_load_speed", "armature",
            "stribeck_velocity", "gear_stiffness",
        }
    ),
    largest={"delay": 1.0, "velocity_filter": 1.0, "load_friction": 1.0},  # a delay takes memory; above 1 a gear locks
    signed=frozenset({"encoder_zero"}),
    substep=physical.SUBSTEP,
    stiffness=("gear_stiffness",),
    damping=("gear_damping", "viscous_damping"),
)  # fmt: skip

_OUT_OF_FAMILY_UNITS = {
    "kp": "N·m/rad", "kd_over_kp": "s", "torque_limit": "N·m",
    "delay": "s", "servo_period": "s", "profile_speed": "rad/s", "profile_acceleration": "rad/s²", "dead_zone": "rad",
    "ki": "N·m/(rad·s)", "integral_limit": "N·m",
    "output_encoder": "1", "encoder_quantum": "rad", "encoder_zero": "rad", "velocity_filter": "s",
    "current_time": "s", "stall_torque": "N·m", "no_load_speed": "rad/s", "sag": "1",
    "heat_loss": "1", "heat_time": "s", "warmth": "1",
    "ripple": "1", "ripple_order": "1/rev", "ripple_phase": "rad",
    "cogging": "N·m", "cogging_order": "1/rev", "cogging_phase": "rad",
    "armature": "kg·m²", "viscous_damping": "N·m·s/rad", "coulomb": "N·m", "static_torque": "N·m",
    "stribeck_velocity": "rad/s", "bristle_stiffness": "N·m/rad", "bristle_damping": "N·m·s/rad", "load_friction": "1",
    "asymmetry": "1", "position_friction": "1", "position_order": "1/rev", "position_phase": "rad",
    "backlash": "rad", "gear_stiffness": "N·m/rad", "gear_hardening": "N·m/rad³", "gear_damping": "N·m·s/rad",
    "slider_stiffness": "N·m/rad", "slider_torque": "N·m", "output_damping": "N·m·s/rad",
    "log_position_noise": "rad", "log_position_quantum": "rad", "log_velocity_filter": "s",
    "log_velocity_noise": "rad/s", "log_torque_noise": "N·m",
}  # fmt: skip
_REQUIRED = frozenset({"kp", "torque_limit", "armature", "gear_stiffness"})
_SHARES: tuple[str, ...] = (
    "output_encoder", "sag", "heat_loss", "warmth", "ripple", "load_friction", "asymmetry", "position_friction",
)  # fmt: skip

# Motors of `actuator.out_of_family`, most of whose equations no learned decoder has
OUT_OF_FAMILY = Family(
    name="foreign",
    motor="The out-of-family motor has firmware of its own, a current loop, heat, ripple, friction with memory, and a "
    "gear that hardens and has play and hysteresis; most of its equations are in no learned model.",
    kind=out_of_family.OUT_OF_FAMILY,
    make=OutOfFamilyMotors,
    units=_OUT_OF_FAMILY_UNITS,
    positive=_REQUIRED,
    largest=dict.fromkeys((*_SHARES, "delay", "servo_period", "velocity_filter"), 1.0),
    signed=frozenset({"encoder_zero", "asymmetry", "ripple_phase", "cogging_phase", "position_phase"}),
    substep=out_of_family.SUBSTEP,
    stiffness=("gear_stiffness", "slider_stiffness", "bristle_stiffness"),
    damping=("gear_damping", "bristle_damping"),
    optional=frozenset(_OUT_OF_FAMILY_UNITS) - _REQUIRED - {"kd_over_kp"},
)

FAMILIES = {family.name: family for family in (GEARED, OUT_OF_FAMILY)}
# Of the parameters of all families
UNITS = {name: unit for family in FAMILIES.values() for name, unit in family.units.items()}


def geared(motors: TrueMotors) -> MotorParameters:
    """The same motors; raises `ConfigError` for motors of another family."""
    if isinstance(motors, MotorParameters):
        return motors
    raise ConfigError(
        f"the fleet's motors are {motors.actuator().kind.name}, not {GEARED.name}",
        remedy=f"use a fleet of {GEARED.name} motors, one that names no other family",
        argument="fleet",
    )
