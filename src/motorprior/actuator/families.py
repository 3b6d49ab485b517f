"""Families of physical motors: their parameters with units and bounds, and their constructors."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import get_type_hints

import numpy as np

from motorprior.actuator import out_of_family, physical
from motorprior.actuator.kernels import ActuatorKind
from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.actuator.physical import PhysicalMotors, TrueMotors
from motorprior.exceptions import ConfigError

MAX_VALUE = 1e9  # upper bound of parameters without another bound
_SECONDS = ("delay", "servo_period", "velocity_filter")  # parameters of at most 1 s
_SIGNED = ("encoder_zero", "asymmetry", "ripple_phase", "cogging_phase", "position_phase")


@dataclass(frozen=True)
class Family:
    """Motors with the same equations.

    The parameters are the fields of ``make``, with kd_over_kp [s] instead of kd.
    """

    name: str  # name in a fleet file and in bench.json
    motor: str  # description for the report
    kind: ActuatorKind
    make: type[PhysicalMotors | OutOfFamilyMotors]
    positive: frozenset[str]  # parameters above 0
    stiffness: tuple[str, ...]  # parameters [N·m/rad] of the springs on the rotor
    damping: tuple[str, ...]  # parameters [N·m·s/rad] of the explicit dampers on the rotor
    # whether parameters that may be 0 default to it, which disables their term
    has_optional: bool = False

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the parameters, in the order of sampling."""
        hints = get_type_hints(self.make, include_extras=True)
        units = {}
        for field in fields(self.make):
            if field.name == "kd":
                units["kd_over_kp"] = "s"
            else:
                units[field.name] = hints[field.name].__metadata__[0]
        return units

    @property
    def optional(self) -> frozenset[str]:
        """Parameters that default to 0."""
        if not self.has_optional:
            return frozenset()
        return frozenset(self.units) - self.positive - {"kd_over_kp"}

    def bounds(self, name: str) -> tuple[float, float]:
        """Bounds of a parameter in SI units; samples are clipped to them."""
        # load friction above 1 locks the gear
        is_share = self.units[name] == "1"
        high = 1.0 if is_share or name in _SECONDS else MAX_VALUE
        low = -high if name in _SIGNED else 0.0
        return low, high

    def motors(self, values: Mapping[str, np.ndarray]) -> TrueMotors:
        """Motors with these parameters, (n,) each."""
        parameters = {**values, "kd": values["kp"] * values["kd_over_kp"]}
        disabled = np.zeros(len(values["kp"]))
        names = [field.name for field in fields(self.make)]
        return self.make(**{name: parameters.get(name, disabled) for name in names})

    def require_stable(self, values: Mapping[str, np.ndarray], where: str | Path) -> None:
        """Raise `ConfigError` unless the rotor of every motor is stable on its gear.

        ``values`` are (n,) each, ``where`` names their origin in the error.

        Semi-implicit Euler with substep h, armature J, total stiffness k and explicit damping d is
        stable in contact if and only if 2·d·h + k·h² < 4·J (Jury's criterion for z² - (2 - d·h/J -
        k·h²/J)·z + 1 - d·h/J). A hardening gear (torque k·s + c·s³ at twist s) has the stiffness k
        + 3·c·s² at the torque limit.
        """
        h = self.kind.bench_step
        armature = values["armature"]
        stiffness = _total(values, self.stiffness) + _hardening_stiffness(values)
        damping = _total(values, self.damping)
        min_armature = (2.0 * damping * h + stiffness * h * h) / 4.0
        if (armature > min_armature).all():
            return

        worst = int(np.argmin(armature / min_armature))
        raise ConfigError(
            f"armature = {armature[worst]:.3g} kg·m² cannot be simulated with "
            f"{' + '.join(self.stiffness)} = {stiffness[worst]:.3g} N·m/rad and "
            f"{' + '.join(self.damping)} = {damping[worst]:.3g} N·m·s/rad "
            f"in steps of {1e3 * h:g} ms",
            where=where,
            remedy=f"raise armature above {min_armature[worst]:.3g} kg·m², or soften the gear",
        )


def _total(values: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """(n,) sum of the parameters with these names that the motors have."""
    zero = np.zeros(len(values["armature"]))
    return sum((values[name] for name in names if name in values), zero)


def _hardening_stiffness(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """(n,) additional stiffness 3·c·s² of a hardening gear at the torque limit [N·m/rad]."""
    linear = values["gear_stiffness"]
    cubic = values.get("gear_hardening", np.zeros(1))
    if not np.any(cubic > 0.0):
        return np.zeros(len(linear))

    twist = values["torque_limit"] / linear
    for _ in range(50):  # Newton's method
        excess_torque = linear * twist + cubic * twist**3 - values["torque_limit"]
        twist = twist - excess_torque / (linear + 3.0 * cubic * twist**2)
    return 3.0 * cubic * twist**2


# motors of `actuator.physical`; the default family of a fleet
GEARED = Family(
    name="geared",
    motor="The physical motor has a rotor, a gear with backlash and stiffness, four kinds of "
    "friction, a torque-speed limit, a delay and a velocity filter; its encoder sits on the rotor.",
    kind=physical.PHYSICAL,
    make=PhysicalMotors,
    positive=frozenset({
        "kp", "kd_over_kp", "velocity_filter", "torque_limit", "stall_torque", "no_load_speed",
        "armature", "stribeck_velocity", "gear_stiffness",
    }),
    stiffness=("gear_stiffness",),
    damping=("gear_damping", "viscous_damping"),
)  # fmt: skip
# motors of `actuator.out_of_family`
OUT_OF_FAMILY_MOTORS = Family(
    name="out_of_family",
    motor="The out-of-family motor has firmware of its own, a current loop, heat, ripple, "
    "friction with memory, and a gear that hardens and has play and hysteresis. The learned models "
    "lack most of these equations.",
    kind=out_of_family.OUT_OF_FAMILY_KIND,
    make=OutOfFamilyMotors,
    positive=frozenset({"kp", "torque_limit", "armature", "gear_stiffness"}),
    stiffness=("gear_stiffness", "slider_stiffness", "bristle_stiffness"),
    damping=("gear_damping", "bristle_damping"),
    has_optional=True,
)
FAMILIES = {family.name: family for family in (GEARED, OUT_OF_FAMILY_MOTORS)}


def require_geared(motors: TrueMotors) -> PhysicalMotors:
    """The motors, as GEARED ones; raises `ConfigError` for motors of another family."""
    if isinstance(motors, PhysicalMotors):
        return motors
    raise ConfigError(
        f"motors of the family {motors.actuator().kind.name}, not {GEARED.name}",
        remedy=f"give a fleet of the family {GEARED.name}",
        argument="fleet",
    )
