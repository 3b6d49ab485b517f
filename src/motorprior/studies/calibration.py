"""A fleet fitted to real logs: its centre with standard errors, and the spread between motors.

Centre: descents from several starts (`identification.search`), with the fleet as prior. The P
parameters are constants of the central motor, positive ones by their logarithm; the residuals are
the replay errors of logs. The simulated body is not fitted: on logs of a real quadruped, foot
friction and centre of mass did not improve the replay (docs/calibrate.md).

Single motors: offsets y from the centre have the prior N(0, s²), where s is the spread between
motors. About the centre the residuals are linear, r + J·y. A wide prior overfits, so s is a
multiple of the starting fleet's spread, selected by leave-one-log-out cross-validation of the
replay error. The fitted spread is √(mean of y² + var(y)), one step of expectation maximisation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.distribution import Distribution
from motorprior.actuator.families import FAMILIES
from motorprior.actuator.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.identification.search import WIDE, GaussianPrior, Search
from motorprior.progress import SILENT, Progress
from motorprior.robots.robot import Robot
from motorprior.signals import rms
from motorprior.studies.log_replay import Replayer, logged_constants, motors_with_logged_gains

FITTED = ("kp", "kd_over_kp", "coulomb", "load_friction", "armature", "delay")
PER_MOTOR = ("kp", "coulomb")  # constants that differ between motors
# a constant is identifiable if its posterior variance is below this share of the prior's
IDENTIFIABLE = 0.5
DEVIATION = 0.015  # [rad] residual deviation before the first fit
_MIN_DEVIATION = 0.001  # [rad] accuracy of encoders and clocks
READINGS = 20  # independent samples per joint and log, of any length: errors repeat with the motion
_PRIOR_SCALE = 2.0  # factor on the fleet's centre uncertainty, which may stem from similar logs
# unit of the parameters, in prior standard deviations: differences span a third of one
_UNIT = 1.0 / (3.0 * WIDE)
_SPREAD_MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
_MIN_SPREAD = 0.01  # relative


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
    def of(cls, name: str, unit: str, distribution: Distribution) -> "Parameter":
        """The parameter of a constant; its deviation is 0 if the fleet's centre is certain."""
        values = distribution.values
        is_log = distribution.form == "lognormal"
        center = distribution.center
        if distribution.form == "uniform":
            is_log = values["low"] > 0.0
            low, high = (
                np.log([values["low"], values["high"]])
                if is_log
                else (values["low"], values["high"])
            )
            deviation = spread = float(high - low) / np.sqrt(12.0)
        else:
            deviation = _PRIOR_SCALE * values.get("center_uncertainty", 0.0)
            spread = values.get("spread", 0.0)
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

    ``deviation`` is the standard deviation of the replay error of a joint [rad]. Raises ConfigError
    if the fleet has no uncertain constant.
    """

    def __init__(
        self,
        fleet: Fleet,
        robot: Robot,
        replayers: Mapping[str, Replayer],
        deviation: float = DEVIATION,
    ):
        self.fleet = fleet
        self.robot = robot
        self.replayers = replayers
        self.deviation = deviation
        # constants in all logs, which are not fitted
        self.logged = frozenset.intersection(
            *(logged_constants(each.log) for each in replayers.values())
        )
        names = [name for name in FITTED if name not in self.logged]
        units = FAMILIES[fleet.family].units
        found = [
            Parameter.of(name, units[name], fleet.parameters[name])
            for name in names
            if name in fleet.parameters
        ]
        self.parameters = tuple(parameter for parameter in found if parameter.deviation > 0.0)
        if not self.parameters:
            problem = f"none of the constants {', '.join(names)} is uncertain"
            remedy = "give one of them a center_uncertainty above 0, or a uniform distribution (docs/calibrate.md)"
            raise ConfigError(problem, where=fleet.name, remedy=remedy)
        self.mean = np.array([each.mean for each in self.parameters])  # of the prior of the centre
        self.prior_std = np.array([each.deviation for each in self.parameters])
        # indices of the parameters that differ between motors, and of the excited joints of all
        # logs
        self.varying = [
            i
            for i, each in enumerate(self.parameters)
            if each.name in PER_MOTOR and each.spread > 0.0
        ]
        self.joints = sorted(
            {int(joint) for replayer in replayers.values() for joint in replayer.excited}
        )

    def actuator(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> Actuator:
        """One motor per joint of the robot, with the logged gains of the log ``name``, if it has any.

        ``x`` is the (P,) centre. Offsets of single motors are flat (excited joints · varying
        parameters).
        """
        count = self.robot.num_joints
        values = {name: np.full(count, each.center) for name, each in self.fleet.parameters.items()}
        own = np.tile(x, (count, 1))
        if offsets is not None:
            own[np.ix_(self.joints, self.varying)] += offsets.reshape(
                len(self.joints), len(self.varying)
            )
        for column, parameter in enumerate(self.parameters):
            values[parameter.name] = np.array([parameter.value(each) for each in own[:, column]])
        return motors_with_logged_gains(
            FAMILIES[self.fleet.family].motors(values), self.replayers[name].log
        ).actuator()

    def error(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
        """(rows, joints) simulated minus measured [rad] of a log; see `Replayer.error`."""
        replayer = self.replayers[name]
        return replayer.error(replayer.joint_pos(self.actuator(name, x, offsets)))

    def residuals(
        self, names: Sequence[str], x: np.ndarray, offsets: np.ndarray | None = None
    ) -> np.ndarray:
        """(N,) errors in units of their deviation; every joint of every log has the same weight."""
        weight = np.sqrt(READINGS) / self.deviation
        errors = [self.error(name, x, offsets) for name in names]
        return np.concatenate([weight / np.sqrt(len(error)) * error.ravel() for error in errors])

    def rmse(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> float:
        """Mean RMSE over the excited joints of a log [rad]."""
        return float(np.mean(rms(self.error(name, x, offsets), axis=0)))

    def with_residual_deviation(self, x: np.ndarray) -> "FleetProblem":
        """The same problem with the RMS error at a centre as deviation, over all joints and logs."""
        errors = [self.error(name, x) for name in self.replayers]
        deviation = np.sqrt(
            np.mean(np.concatenate([np.mean(error**2, axis=0) for error in errors]))
        )
        return FleetProblem(
            self.fleet, self.robot, self.replayers, max(float(deviation), _MIN_DEVIATION)
        )


class _CentreProblem:
    """Residuals of some logs, see `search.Problem`; x is relative to the prior's mean, in _UNIT.

    mujoco.sysid is not used: it fits parameters of a model's own actuators within bounds, while
    these motors, with delay, rotor and backlash, run outside the engine, and the fleet is a
    Gaussian prior.
    """

    count = observations = 1

    def __init__(self, problem: FleetProblem, logs: Sequence[str]):
        self._problem = problem
        self._logs = logs
        self.scale = _UNIT * problem.prior_std
        self.weight = float(len(problem.residuals(logs, problem.mean)))

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, N) at x (L, P)."""
        return np.stack(
            [
                self._problem.residuals(self._logs, self._problem.mean + self.scale * row)
                for row in x
            ]
        )


def _optimum(
    problem: FleetProblem, logs: Sequence[str], start: np.ndarray, iterations: int
) -> tuple[np.ndarray, float, np.ndarray]:
    """(P,) centre, its cost, and its (P, P) covariance by Laplace's method."""
    centre = _CentreProblem(problem, logs)
    size = len(problem.mean)
    search = Search(centre)
    scale = centre.scale
    prior = GaussianPrior(np.zeros(size), np.full(size, _UNIT**2))
    found = search.descend(((start - problem.mean) / scale)[None], prior, ((iterations, WIDE),))
    covariance = (
        np.linalg.inv(search.curvatures(found.x, WIDE)[0] + np.diag(prior.precision))
        * scale
        * scale[:, None]
    )
    return problem.mean + scale * found.x[0], float(found.energy[0]), covariance


@dataclass(frozen=True)
class Calibration:
    """A fitted fleet."""

    center: np.ndarray  # (P,) best centre of all searches
    # (P,) its standard error: the larger of Laplace's and, for several logs, the jackknife's
    error: np.ndarray
    # (excited joints · varying parameters,) of single motors from it, see `FleetProblem.actuator`
    offsets: np.ndarray
    # constant -> standard deviation between motors; empty if the fleet has no spread
    spread: dict[str, float]
    # log name -> (P,) centre without this log, and offsets from it; empty for a single log
    left_out: dict[str, tuple[np.ndarray, np.ndarray]]


def calibrate(
    problem: FleetProblem, starts: int, iterations: int, seed: int, progress: Progress = SILENT
) -> Calibration:
    """Fit a fleet, by ``starts`` searches of at most this many iterations.

    The first starts at the fleet's centre, the others at samples of the prior.
    """
    names = list(problem.replayers)
    mean = problem.mean
    samples = problem.prior_std * np.random.default_rng(seed).standard_normal(
        (starts - 1, len(mean))
    )
    logs_left_out = names if len(names) > 1 else []
    searches = 1 + starts + len(logs_left_out) + 1
    with progress.start(f"calibrate on {len(names)} real logs", searches) as task:

        def fit(
            problem: FleetProblem, logs: Sequence[str], start: np.ndarray
        ) -> tuple[np.ndarray, float, np.ndarray]:
            task.advance()
            return _optimum(problem, logs, start, iterations)

        first, _, _ = fit(problem, names, mean)
        problem = problem.with_residual_deviation(first)
        found = [fit(problem, names, start) for start in (first, *(mean + samples))]
        center, _, covariance = min(found, key=lambda each: each[1])
        left_out = {
            name: fit(problem, [log for log in names if log != name], mean)[0]
            for name in logs_left_out
        }
        offsets, spread, offsets_left_out = single_motors(problem, center, left_out)
        task.advance()
    error = np.sqrt(np.diag(covariance))
    if left_out:
        # jackknife over n logs: variance (n-1)/n·Σ(x_i - mean)², x_i the fit without log i (Efron &
        # Stein 1981)
        without = np.array(list(left_out.values()))
        error = np.maximum(error, np.sqrt((len(without) - 1) * np.var(without, axis=0)))
    both = {name: (left_out[name], offsets_left_out[name]) for name in left_out}
    return Calibration(center, error, offsets, spread, both)


def calibrated_fleet(problem: FleetProblem, found: Calibration) -> Fleet:
    """The fleet with its fitted constants; all others stay."""
    parameters = dict(problem.fleet.parameters)
    for parameter, x, error in zip(problem.parameters, found.center, found.error, strict=True):
        spread = found.spread.get(parameter.name, parameter.spread)
        values = {
            "center": parameter.value(x),
            "spread": spread,
            "center_uncertainty": float(error),
        }
        if not parameter.is_log:
            values["minimum"] = parameter.minimum
        rounded = {key: float(f"{value:.4g}") for key, value in values.items()}
        parameters[parameter.name] = Distribution(
            "lognormal" if parameter.is_log else "normal", rounded
        )
    return replace(problem.fleet, name=f"{problem.fleet.name}_calibrated", parameters=parameters)


def single_motors(
    problem: FleetProblem, center: np.ndarray, left_out: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, float], dict[str, np.ndarray]]:
    """Fit offsets of single motors, linearly about the (P,) centre of all logs.

    ``left_out``: log name -> (P,) centre fitted without this log; empty for a single log. Returns
    offsets and spread, see `Calibration`; log name -> offsets without this log.
    """
    varying = [problem.parameters[i] for i in problem.varying]
    names = list(problem.replayers)
    spread = np.tile([each.spread for each in varying], len(problem.joints))
    if not varying:
        return spread, {}, dict.fromkeys(left_out, spread)
    others = {
        name: _linear(problem, [log for log in names if log != name], x, spread)
        for name, x in left_out.items()
    }

    def error(multiple: float) -> float:
        fitted = {name: _offsets(*each, multiple * spread) for name, each in others.items()}
        return sum(problem.rmse(name, left_out[name], offsets) for name, offsets in fitted.items())

    prior = (min(_SPREAD_MULTIPLES, key=error) if others else 1.0) * spread
    residuals, slope = _linear(problem, names, center, spread)
    offsets = _offsets(residuals, slope, prior)
    variance = np.diag(np.linalg.inv(slope.T @ slope + np.diag(prior**-2)))
    each_motor = (offsets**2 + variance).reshape(len(problem.joints), len(varying))
    between = np.maximum(np.sqrt(each_motor.mean(axis=0)), _MIN_SPREAD).tolist()
    found = {each.name: s for each, s in zip(varying, between, strict=True)}
    return offsets, found, {name: _offsets(*each, prior) for name, each in others.items()}


def _linear(
    problem: FleetProblem, logs: Sequence[str], center: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (N,) of logs at a centre, and their Jacobian (N, offsets)."""
    columns = [
        (problem.residuals(logs, center, away) - problem.residuals(logs, center, -away))
        / (2.0 * away.max())
        for away in np.diag(spread)
    ]
    return problem.residuals(logs, center, np.zeros_like(spread)), np.stack(columns, axis=1)


def _offsets(residuals: np.ndarray, slope: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(offsets,) minimum of the sum of squares of r + J·y, with the prior N(0, spread²) of y."""
    return -np.linalg.solve(slope.T @ slope + np.diag(spread**-2), slope.T @ residuals)
