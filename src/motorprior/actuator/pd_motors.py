"""The motors ``pd``: a PD with given constants, or randomised about them."""

from dataclasses import replace

import numpy as np

from motorprior.actuator.fleet import Fleet, load_robot_fleet, nominal_pd
from motorprior.actuator.ideal_pd import FRICTION_PD, IdealPd, described_pd
from motorprior.actuator.registry import EpisodeMotors, register
from motorprior.bounds import MAX_NUMBER, require_number
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot

MAX_DELAY = 1.0  # [s]: the delay line holds so many physics steps
MAX_SPREAD = 0.9  # [-]
SPREAD_OF_DELAY = 0.02  # range of the delay at spread 1 [s]; not relative, since it may be 0
_MAXIMA = {"delay": MAX_DELAY, "spread": MAX_SPREAD}


@register("pd")
def pd_motors(
    robot: Robot,
    kp: float | None = None,
    kd: float | None = None,
    torque_limit: float | None = None,
    armature: float = 0.0,
    delay: float = 0.0,
    coulomb: float = 0.0,
    spread: float = 0.0,
    fleet: str | None = None,
) -> EpisodeMotors:
    """An ideal PD with these constants in SI units.

    Without kp, kd or torque_limit, the PD has those of `nominal_gains`. With ``spread`` [-], every
    constant is sampled for every motor and episode, uniformly within ± this share; the delay within
    ± this share of 20 ms.

    Raises:
        ConfigError: a constant out of range, or friction without armature.
    """
    constants = {
        "kp": kp,
        "kd": kd,
        "torque_limit": torque_limit,
        "armature": armature,
        "delay": delay,
        "coulomb": coulomb,
    }
    constants = {name: value for name, value in constants.items() if value is not None}
    for name, value in {**constants, "spread": spread}.items():
        require_number(name, value, maximum=_MAXIMA.get(name, MAX_NUMBER))
    if coulomb and not armature:
        raise ConfigError(
            f"coulomb {coulomb:g} N·m without armature",
            remedy="give one: friction acts on the rotor",
        )

    columns = {name: np.full(robot.num_joints, float(value)) for name, value in constants.items()}
    pd = replace(nominal_gains(robot, fleet), **columns)
    if spread:
        return EpisodeMotors(lambda rng: _randomized(pd, spread, rng), "random_pd")

    condition = "ideal_pd"
    if coulomb:
        condition = FRICTION_PD.name
    elif armature or delay:
        condition = "tuned_pd"
    return EpisodeMotors(lambda rng: pd, condition)


def nominal_gains(robot: Robot, fleet: Fleet | str | None = None) -> IdealPd:
    """An ideal PD with the gains and torque limit of a fleet's central motor.

    The fleet is by default the robot's own; a robot without fleets has the gains of its
    description.
    """
    if fleet is None and not robot.fleets:
        return described_pd(robot)
    return nominal_pd(load_robot_fleet(robot, fleet), robot.num_joints)


def _randomized(pd: IdealPd, spread: float, rng: np.random.Generator) -> IdealPd:
    """Motors with uniformly sampled constants; the order of the samples is part of the seed."""

    def sampled(values: np.ndarray) -> np.ndarray:
        return values * rng.uniform(1.0 - spread, 1.0 + spread, len(values))

    columns = {
        name: sampled(getattr(pd, name)) for name in ("kp", "kd", "torque_limit", "armature")
    }
    delay_range = SPREAD_OF_DELAY * spread
    delay = rng.uniform(np.maximum(0.0, pd.delay - delay_range), pd.delay + delay_range)
    coulomb = sampled(pd.coulomb) if pd.coulomb.any() else pd.coulomb
    return replace(pd, **columns, delay=delay, coulomb=coulomb)
