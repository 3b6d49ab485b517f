"""Least-squares problem of a fleet calibration: P parameters of the fleet's centre, replay errors of logs as residuals.

Parameters are constants of the central motor, positive ones by their logarithm. The simulated body is not fitted: on
logs of a real quadruped, foot friction and centre of mass did not improve the replay (docs/calibrate.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.families import FAMILIES
from motorprior.bench.fleet import Distribution, Fleet
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot
from motorprior.signals import rms
from motorprior.studies.log_replay import Replayer, logged_constants, motors_with_logged_gains

FITTED = ("kp", "kd_over_kp", "coulomb", "load_friction", "armature", "delay")
PER_MOTOR = ("kp", "coulomb")  # constants that differ between motors
IDENTIFIABLE = 0.5  # a constant is identifiable if its posterior variance is below this share of the prior's
DEVIATION = 0.015  # [rad] residual deviation before the first fit
_MIN_DEVIATION = 0.001  # [rad] accuracy of encoders and clocks
READINGS = 20  # independent samples per joint and log, of any length: errors repeat with the motion
_PRIOR_SCALE = 2.0  # factor on the fleet's centre uncertainty, which may stem from similar logs


@dataclass(frozen=True)
class Parameter:
    """One fitted constant of the central motor."""

    name: str  # in the fleet's file
    unit: str  # of the constant
    is_log: bool  # whether the parameter is the constant's logarithm
    mean: float  # prior mean of the parameter
    deviation: float  # prior standard deviation of the parameter
    spread: float  # standard deviation between motors in the starting fleet
    minimum: float  # of the constant

    @classmethod
    def of(cls, name: str, unit: str, distribution: Distribution) -> Parameter:
        """The parameter of a constant; its deviation is 0 if the fleet's centre is certain."""
        values, is_log, center = distribution.values, distribution.kind == "lognormal", distribution.center
        if distribution.kind == "uniform":
            is_log = values["low"] > 0.0
            low, high = np.log([values["low"], values["high"]]) if is_log else (values["low"], values["high"])
            deviation = spread = float(high - low) / np.sqrt(12.0)
        else:
            deviation, spread = _PRIOR_SCALE * values.get("center_uncertainty", 0.0), values.get("spread", 0.0)
        mean = float(np.log(center)) if is_log else center
        return cls(name, unit, is_log, mean, deviation, spread, values.get("minimum", 0.0))

    def value(self, x: float) -> float:
        """The constant."""
        return float(np.exp(x)) if self.is_log else max(float(x), self.minimum)

    def is_identifiable(self, error: float) -> bool:
        """Whether the logs halve the variance of the constant; ``error`` is its standard error after the fit."""
        return error**2 < IDENTIFIABLE * self.deviation**2


class FleetProblem:
    """Residuals of logs as a function of the centre, and of offsets of single motors.

    ``deviation`` is the standard deviation of the replay error of a joint [rad]. Raises ConfigError if the fleet has no
    uncertain constant.
    """

    def __init__(self, fleet: Fleet, robot: Robot, replayers: Mapping[str, Replayer], deviation: float = DEVIATION):
        self.fleet, self.robot, self.replayers, self.deviation = fleet, robot, replayers, deviation
        # constants in all logs, which are not fitted
        self.logged = frozenset.intersection(*(logged_constants(each.log) for each in replayers.values()))
        names, units = [name for name in FITTED if name not in self.logged], FAMILIES[fleet.family].units
        found = [Parameter.of(name, units[name], fleet.parameters[name]) for name in names if name in fleet.parameters]
        self.parameters = tuple(parameter for parameter in found if parameter.deviation > 0.0)
        if not self.parameters:
            raise ConfigError(
                f"none of the constants {', '.join(names)} is uncertain", where=fleet.name,
                remedy="give at least one of them a center_uncertainty above 0, or a uniform distribution "
                "(docs/calibrate.md)",
            )  # fmt: skip
        self.mean = np.array([each.mean for each in self.parameters])  # of the prior of the centre
        self.prior_std = np.array([each.deviation for each in self.parameters])
        # indices of the parameters that differ between motors, and of the excited joints of all logs
        self.varying = [i for i, each in enumerate(self.parameters) if each.name in PER_MOTOR and each.spread > 0.0]
        self.joints = sorted({int(joint) for replayer in replayers.values() for joint in replayer.excited})

    def actuator(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> Actuator:
        """One motor per joint of the robot, with the logged gains of the log ``name``, if it has any.

        ``x`` is the (P,) centre. Offsets of single motors are flat (excited joints · varying parameters).
        """
        count = self.robot.num_joints
        values = {name: np.full(count, each.center) for name, each in self.fleet.parameters.items()}
        own = np.tile(x, (count, 1))
        if offsets is not None:
            own[np.ix_(self.joints, self.varying)] += offsets.reshape(len(self.joints), len(self.varying))
        for column, parameter in enumerate(self.parameters):
            values[parameter.name] = np.array([parameter.value(each) for each in own[:, column]])
        return motors_with_logged_gains(FAMILIES[self.fleet.family].motors(values), self.replayers[name].log).actuator()

    def error(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
        """(rows, joints) simulated minus measured [rad] of a log; see `Replayer.error`."""
        replayer = self.replayers[name]
        return replayer.error(replayer.joint_pos(self.actuator(name, x, offsets)))

    def residuals(self, names: Sequence[str], x: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
        """(N,) errors in units of their deviation; every joint of every log has the same weight."""
        weight, errors = np.sqrt(READINGS) / self.deviation, [self.error(name, x, offsets) for name in names]
        return np.concatenate([weight / np.sqrt(len(error)) * error.ravel() for error in errors])

    def rmse(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> float:
        """Mean RMSE over the excited joints of a log [rad]."""
        return float(np.mean(rms(self.error(name, x, offsets), axis=0)))

    def with_residual_deviation(self, x: np.ndarray) -> FleetProblem:
        """The same problem with the RMS error at a centre as deviation, over all joints and logs."""
        errors = [self.error(name, x) for name in self.replayers]
        deviation = np.sqrt(np.mean(np.concatenate([np.mean(error**2, axis=0) for error in errors])))
        return FleetProblem(self.fleet, self.robot, self.replayers, max(float(deviation), _MIN_DEVIATION))
