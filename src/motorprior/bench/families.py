"""Families of physical motors: their parameters with units and bounds, and the constructors of the motors."""

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
    """Motors with the same equations."""

    name: str  # in a fleet file and in bench.json
    motor: str  # description for the report
    kind: ActuatorKind
    make: Callable[..., TrueMotors]  # constructor; its fields are the parameters, with kd instead of kd_over_kp
    units: Mapping[str, str]  # of the parameters, in the order of sampling
    positive: frozenset[str]  # parameters above 0
    max_values: Mapping[str, float]  # upper bounds, where not 1e9
    signed: frozenset[str]  # parameters that may be negative
    substep: float  # maximum substep of the rotor [s]
    stiffness: tuple[str, ...]  # parameters [N·m/rad] of the springs on the rotor
    damping: tuple[str, ...]  # parameters [N·m·s/rad] of the explicit dampers on the rotor
    optional: frozenset[str] = frozenset()  # parameters that default to 0, which disables their term

    def motors(self, values: Mapping[str, np.ndarray]) -> TrueMotors:
        """Motors with these parameters, (n,) each."""
        given = {**values, "kd": values["kp"] * values["kd_over_kp"]}
        disabled = np.zeros(len(given["kp"]))
        return self.make(**{name: given.get(name, disabled) for name in (*self.units, "kd") if name != "kd_over_kp"})

    def require_stable(self, values: Mapping[str, np.ndarray], where: str | Path) -> None:
        """Raise `ConfigError` unless the rotor of every motor is stable on its gear; ``values`` are (n,) each.

        Semi-implicit Euler with substep h, armature J, total stiffness k and explicit damping d is stable in contact if
        and only if 2·d·h + k·h² < 4·J (Jury's criterion for z² - (2 - d·h/J - k·h²/J)·z + 1 - d·h/J). A hardening gear
        (torque k·s + c·s³ at twist s) has the stiffness k + 3·c·s² at the torque limit.
        """
        h, armature = self.substep, values["armature"]
        zero = np.zeros(len(armature))
        stiffness = sum((values[name] for name in self.stiffness if name in values), zero) + _hardened(values)
        damping = sum((values[name] for name in self.damping if name in values), zero)
        min_armature = (2.0 * damping * h + stiffness * h * h) / 4.0
        if not (armature > min_armature).all():
            worst = int(np.argmin(armature / min_armature))
            raise ConfigError(
                f"armature = {armature[worst]:.3g} kg·m² cannot be simulated with {' + '.join(self.stiffness)} = "
                f"{stiffness[worst]:.3g} N·m/rad and {' + '.join(self.damping)} = {damping[worst]:.3g} N·m·s/rad in "
                f"steps of {1e3 * h:g} ms",
                where=where, remedy=f"raise armature above {min_armature[worst]:.3g} kg·m², or soften the gear",
            )  # fmt: skip


def _hardened(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n,) additional stiffness 3·c·s² of a hardening gear at the torque limit [N·m/rad]."""
    linear, cubic = values["gear_stiffness"], values.get("gear_hardening", np.zeros(1))
    if not np.any(cubic > 0.0):
        return np.zeros(len(linear))
    twist = values["torque_limit"] / linear
    for _ in range(50):  # Newton's method
        twist = twist - (linear * twist + cubic * twist**3 - values["torque_limit"]) / (linear + 3.0 * cubic * twist**2)
    return 3.0 * cubic * twist**2


# motors of `actuator.physical`; the default family of a fleet
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
    positive=frozenset((
        "kp", "kd_over_kp", "velocity_filter", "torque_limit", "stall_torque", "no_load_speed", "armature",
        "stribeck_velocity", "gear_stiffness",
    )),
    max_values={"delay": 1.0, "velocity_filter": 1.0, "load_friction": 1.0},  # load friction above 1 locks the gear
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

# motors of `actuator.out_of_family`
OUT_OF_FAMILY = Family(
    name="foreign",
    motor="The out-of-family motor has firmware of its own, a current loop, heat, ripple, friction with memory, and a "
    "gear that hardens and has play and hysteresis; most of its equations are in no learned model.",
    kind=out_of_family.OUT_OF_FAMILY,
    make=OutOfFamilyMotors,
    units=_OUT_OF_FAMILY_UNITS,
    positive=_REQUIRED,
    max_values=dict.fromkeys((*_SHARES, "delay", "servo_period", "velocity_filter"), 1.0),
    signed=frozenset({"encoder_zero", "asymmetry", "ripple_phase", "cogging_phase", "position_phase"}),
    substep=out_of_family.SUBSTEP,
    stiffness=("gear_stiffness", "slider_stiffness", "bristle_stiffness"),
    damping=("gear_damping", "bristle_damping"),
    optional=frozenset(_OUT_OF_FAMILY_UNITS) - _REQUIRED - {"kd_over_kp"},
)

FAMILIES = {family.name: family for family in (GEARED, OUT_OF_FAMILY)}
# of the parameters of all families
UNITS = {name: unit for family in FAMILIES.values() for name, unit in family.units.items()}


def require_geared(motors: TrueMotors) -> MotorParameters:
    """The motors, as GEARED ones; raises `ConfigError` for motors of another family."""
    if isinstance(motors, MotorParameters):
        return motors
    raise ConfigError(
        f"motors of the family {motors.actuator().kind.name}, not {GEARED.name}",
        remedy=f"give as fleet one of the {GEARED.name} family",
        argument="fleet",
    )
