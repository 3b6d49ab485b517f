"""A fleet's centre as unknowns, and what real logs say of it when they are replayed.

Unknowns are the constants of the central motor that push-ups, gaits or steps can tell, most of them by their logarithm.
The body of the simulated robot is not among them: on the logs of a real quadruped, friction of the feet and centre of
mass explained nothing that the motors had not, and made other logs worse (docs/calibrate.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.distribution import Distribution
from motorprior.bench.families import FAMILIES, TrueMotors
from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot
from motorprior.signals import rms
from motorprior.transfer.gauss_newton import Belief
from motorprior.transfer.real_replay import Replayer
from motorprior.transfer.stated_gains import at_stated_gains, stated_constants

FITTED = ("kp", "kd_over_kp", "coulomb", "load_friction", "armature", "delay")
"""Constants that are fitted, where the fleet has them and is unsure of them."""
PER_MOTOR = ("kp", "coulomb")
"""Constants that may differ from motor to motor in the fit of the spread."""
DEVIATION = 0.015
"""Of a joint from a replay [rad], before a fit has shown it."""
_LEAST_DEVIATION = 0.001
"""[rad]; encoders and clocks are no better."""
READINGS = 20
"""Independent readings that a joint of a log counts as, however long it is: its misfit repeats with the motion."""
_WEAK = 2.0
"""The belief is so much wider than the fleet's uncertainty of its centre, which may stem from similar logs."""
_STEPS = 3.0
"""Differences are taken over a third of the belief's deviation, wide enough for joints that stick."""


@dataclass(frozen=True)
class Unknown:
    """One constant of the central motor.

    Attributes:
        name: in the fleet's file.
        is_log: whether the unknown is the constant's logarithm.
        mean: believed of the unknown.
        deviation: of that belief.
        spread: of the unknown between motors, in the starting fleet.
        least: smallest value of the constant.
    """

    name: str
    is_log: bool
    mean: float
    deviation: float
    spread: float
    least: float = 0.0

    def value(self, x: float) -> float:
        """The constant."""
        return float(np.exp(x)) if self.is_log else max(float(x), self.least)


def unknowns_of(fleet: Fleet, stated: frozenset[str] = frozenset()) -> tuple[Unknown, ...]:
    """What of a fleet's centre is to be found.

    Args:
        fleet: where the fit begins.
        stated: constants that all logs state, which are no unknowns.

    Raises:
        ConfigError: the fleet is sure of everything else.
    """
    names = [name for name in FITTED if name not in stated]
    found = [unknown for name in names if (unknown := _unknown(name, fleet.parameters.get(name))) is not None]
    if not found:
        raise ConfigError(
            f"the fleet leaves none of {', '.join(names)} open", where=fleet.name, argument="fleet",
            remedy="give at least one of them a center_uncertainty above 0, or a uniform distribution "
            "(docs/calibrate.md)",
        )  # fmt: skip
    return tuple(found)


def _unknown(name: str, distribution: Distribution | None) -> Unknown | None:
    if distribution is None or distribution.kind == "constant":
        return None
    values, is_log = distribution.values, distribution.kind == "lognormal"
    if distribution.kind == "uniform":
        is_log = values["low"] > 0.0
        low, high = np.log([values["low"], values["high"]]) if is_log else (values["low"], values["high"])
        deviation = spread = float(high - low) / np.sqrt(12.0)
    else:
        deviation, spread = _WEAK * values["center_uncertainty"], values["spread"]
    mean = float(np.log(distribution.center)) if is_log else distribution.center
    return Unknown(name, is_log, mean, deviation, spread, values.get("minimum", 0.0)) if deviation > 0.0 else None


class FleetProblem:
    """Residuals of some logs as a function of the centre, and of single motors.

    Args:
        fleet: where the fit begins, and what stays.
        robot: that the logs are of.
        replayers: of the logs, by name.
        deviation: of a joint from its replay that weighs as one standard deviation [rad].

    Attributes:
        stated: constants that all logs state, which are no unknowns.
    """

    def __init__(self, fleet: Fleet, robot: Robot, replayers: Mapping[str, Replayer], deviation: float = DEVIATION):
        self.fleet, self.robot, self.replayers, self.deviation = fleet, robot, replayers, deviation
        self.stated = frozenset.intersection(*(stated_constants(each.prepared) for each in replayers.values()))
        self.unknowns = unknowns_of(fleet, self.stated)
        self.belief = belief_of(self.unknowns)
        self.differing = [i for i, each in enumerate(self.unknowns) if each.name in PER_MOTOR and each.spread > 0.0]
        self.joints = sorted({int(joint) for replayer in replayers.values() for joint in replayer.excited})

    def motors(self, x: np.ndarray, offsets: np.ndarray | None = None) -> TrueMotors:
        """One motor per joint of the robot, at the fleet's gains.

        Args:
            x: (unknowns,) the centre.
            offsets: of single motors from it, flat (moved joints · differing unknowns).
        """
        count = self.robot.num_joints
        values = {name: np.full(count, each.center) for name, each in self.fleet.parameters.items()}
        own = np.tile(x, (count, 1))
        if offsets is not None:
            own[np.ix_(self.joints, self.differing)] += offsets.reshape(len(self.joints), len(self.differing))
        for column, unknown in enumerate(self.unknowns):
            values[unknown.name] = np.array([unknown.value(each) for each in own[:, column]])
        return FAMILIES[self.fleet.family].motors(values)

    def actuator(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> Actuator:
        """The `motors` at the gains that a log states."""
        return at_stated_gains(self.motors(x, offsets), self.replayers[name].prepared).actuator()

    def errors(self, names: Sequence[str], x: np.ndarray, offsets: np.ndarray | None = None) -> list[np.ndarray]:
        """(rows, joints) simulated minus measured [rad] of every log; see `Replayer.error`."""
        return [
            self.replayers[name].error(self.replayers[name].joint_pos(self.actuator(name, x, offsets)))
            for name in names
        ]

    def residuals(self, names: Sequence[str], x: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
        """(N,) errors in units of their deviation; every joint of every log weighs the same."""
        weigh = np.sqrt(READINGS) / self.deviation
        return np.concatenate([weigh / np.sqrt(len(e)) * e.ravel() for e in self.errors(names, x, offsets)])

    def rmse(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> float:
        """Mean over the moved joints of a log of their RMSE [rad]."""
        (error,) = self.errors([name], x, offsets)
        return float(np.mean(rms(error, axis=0)))

    def unit(self, unknown: Unknown) -> str:
        """Of the constant."""
        return FAMILIES[self.fleet.family].units[unknown.name]

    def as_good_as(self, x: np.ndarray) -> FleetProblem:
        """The same, with the deviation that a centre leaves: the root of the mean over all joints and logs."""
        errors = self.errors(list(self.replayers), x)
        deviation = np.sqrt(np.mean(np.concatenate([np.mean(error**2, axis=0) for error in errors])))
        return FleetProblem(self.fleet, self.robot, self.replayers, max(float(deviation), _LEAST_DEVIATION))


def belief_of(unknowns: Sequence[Unknown]) -> Belief:
    """Of the centre."""
    deviation = np.array([each.deviation for each in unknowns])
    return Belief(np.array([each.mean for each in unknowns]), deviation, deviation / _STEPS)
