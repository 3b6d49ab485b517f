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
# constants that differ between motors
PER_MOTOR = ("kp", "coulomb")
# a constant is identifiable if its posterior variance is below this share of the prior's
IDENTIFIABLE = 0.5
DEVIATION = 0.015  # standard deviation of the replay error before the first fit [rad]
_MIN_DEVIATION = 0.001  # accuracy of encoders and clocks [rad]
# independent samples per joint and log, of any length: errors repeat with the motion
READINGS = 20
# factor on the uncertainty of the fleet's centre, which may stem from similar logs
_PRIOR_SCALE = 2.0
# unit of the parameters, in prior standard deviations: differences span a third of one
_UNIT = 1.0 / (3.0 * WIDE)
# tested spreads between motors, as multiples of the starting fleet's
_SPREAD_MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
_MIN_SPREAD = 0.01  # minimum fitted spread, relative


@dataclass(frozen=True)
class Parameter:
    """One fitted constant of the central motor."""

    name: str  # in the fleet's file
    unit: str  # unit of the constant
    is_log: bool  # whether the parameter is the constant's logarithm
    mean: float  # prior mean of the parameter
    deviation: float  # prior standard deviation of the parameter
    spread: float  # standard deviation between motors in the starting fleet
    minimum: float  # minimum of the constant

    @classmethod
    def of(cls, name: str, unit: str, distribution: Distribution) -> "Parameter":
        """The parameter of a constant; its deviation is 0 if the fleet's centre is certain."""
        values = distribution.values
        if distribution.form == "uniform":
            limits = np.array([values["low"], values["high"]])
            is_log = values["low"] > 0.0
            if is_log:
                limits = np.log(limits)
            spread = float(limits[1] - limits[0]) / np.sqrt(12.0)
            deviation = spread
        else:
            is_log = distribution.form == "lognormal"
            spread = values.get("spread", 0.0)
            deviation = _PRIOR_SCALE * values.get("center_uncertainty", 0.0)

        center = distribution.center
        return cls(
            name=name,
            unit=unit,
            is_log=is_log,
            mean=float(np.log(center)) if is_log else center,
            deviation=deviation,
            spread=spread,
            minimum=values.get("minimum", 0.0),
        )

    def value(self, x: float) -> float:
        """Value of the constant for the parameter ``x``."""
        return float(np.exp(x)) if self.is_log else max(float(x), self.minimum)

    def is_identifiable(self, error: float) -> bool:
        """Whether the logs halve the variance of the constant.

        ``error`` is its standard error after the fit.
        """
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
        logged = [logged_constants(replayer.log) for replayer in replayers.values()]
        self.logged = frozenset.intersection(*logged)
        self.parameters = self._uncertain_parameters()

        # prior of the centre
        self.mean = np.array([parameter.mean for parameter in self.parameters])
        self.prior_std = np.array([parameter.deviation for parameter in self.parameters])

        # indices of the parameters that differ between motors
        self.varying = [
            index
            for index, parameter in enumerate(self.parameters)
            if parameter.name in PER_MOTOR and parameter.spread > 0.0
        ]
        # indices of the joints that are excited in any log
        excited: set[int] = set()
        for replayer in replayers.values():
            excited.update(replayer.excited.tolist())
        self.joints = sorted(excited)

    def _uncertain_parameters(self) -> tuple[Parameter, ...]:
        units = FAMILIES[self.fleet.family].units
        names = [name for name in FITTED if name not in self.logged]
        parameters = [
            Parameter.of(name, units[name], self.fleet.parameters[name])
            for name in names
            if name in self.fleet.parameters
        ]
        uncertain = tuple(parameter for parameter in parameters if parameter.deviation > 0.0)
        if not uncertain:
            problem = f"none of the constants {', '.join(names)} is uncertain"
            remedy = "give one of them a center_uncertainty above 0"
            remedy += ", or a uniform distribution (docs/calibrate.md)"
            raise ConfigError(problem, where=self.fleet.name, remedy=remedy)
        return uncertain

    def actuator(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> Actuator:
        """One motor per joint of the robot, with the gains of the log ``name`` if they are logged.

        ``x`` is the (P,) centre. Offsets of single motors are flat (excited joints · varying
        parameters).
        """
        count = self.robot.num_joints
        x_of_motors = np.tile(x, (count, 1))
        if offsets is not None:
            shape = (len(self.joints), len(self.varying))
            x_of_motors[np.ix_(self.joints, self.varying)] += offsets.reshape(shape)

        values = {
            constant: np.full(count, distribution.center)
            for constant, distribution in self.fleet.parameters.items()
        }
        for parameter, column in zip(self.parameters, x_of_motors.T, strict=True):
            values[parameter.name] = np.array([parameter.value(x) for x in column])

        motors = FAMILIES[self.fleet.family].motors(values)
        return motors_with_logged_gains(motors, self.replayers[name].log).actuator()

    def error(self, name: str, x: np.ndarray, offsets: np.ndarray | None = None) -> np.ndarray:
        """(rows, joints) replay error of a log [rad]; see `Replayer.error`."""
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
        """The same problem, with the RMS error of all joints and logs at a centre as deviation."""
        errors = [self.error(name, x) for name in self.replayers]
        variances = np.concatenate([np.mean(error**2, axis=0) for error in errors])
        deviation = max(float(np.sqrt(np.mean(variances))), _MIN_DEVIATION)
        return FleetProblem(self.fleet, self.robot, self.replayers, deviation)


class _CentreProblem:
    """Residuals of some logs, see `search.Problem`; x is relative to the prior's mean, in _UNIT.

    mujoco.sysid is not used: it fits parameters of a model's own actuators within bounds, while
    these motors, with delay, rotor and backlash, run outside the engine, and the fleet is a
    Gaussian prior.
    """

    count = 1
    observations = 1

    def __init__(self, problem: FleetProblem, logs: Sequence[str]):
        self._problem = problem
        self._logs = logs
        self.scale = _UNIT * problem.prior_std
        self.weight = float(len(problem.residuals(logs, problem.mean)))

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, N) residuals at x (L, P)."""
        centers = self._problem.mean + self.scale * x
        return np.stack([self._problem.residuals(self._logs, center) for center in centers])


def _optimum(
    problem: FleetProblem, logs: Sequence[str], start: np.ndarray, iterations: int
) -> tuple[np.ndarray, float, np.ndarray]:
    """(P,) centre, its cost, and its (P, P) covariance by Laplace's method."""
    centre_problem = _CentreProblem(problem, logs)
    scale = centre_problem.scale
    search = Search(centre_problem)
    size = len(problem.mean)
    prior = GaussianPrior(np.zeros(size), np.full(size, _UNIT**2))

    scaled_start = (start - problem.mean) / scale
    minimum = search.descend(scaled_start[None], prior, ((iterations, WIDE),))

    curvature = search.curvatures(minimum.x, WIDE)[0] + np.diag(prior.precision)
    covariance = np.linalg.inv(curvature) * scale * scale[:, None]
    return problem.mean + scale * minimum.x[0], float(minimum.energy[0]), covariance


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
    noise = np.random.default_rng(seed).standard_normal((starts - 1, len(mean)))
    samples = problem.prior_std * noise
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
        optima = [fit(problem, names, start) for start in (first, *(mean + samples))]
        center, _, covariance = min(optima, key=lambda optimum: optimum[1])

        left_out: dict[str, np.ndarray] = {}
        for name in logs_left_out:
            remaining = [log for log in names if log != name]
            left_out[name], _, _ = fit(problem, remaining, mean)

        offsets, spread, offsets_left_out = single_motors(problem, center, left_out)
        task.advance()

    error = np.sqrt(np.diag(covariance))
    if left_out:
        # jackknife over n logs: variance (n-1)/n·Σ(x_i - mean)², x_i the fit without log i (Efron &
        # Stein 1981)
        centers = np.array(list(left_out.values()))
        jackknife_error = np.sqrt((len(centers) - 1) * np.var(centers, axis=0))
        error = np.maximum(error, jackknife_error)
    fits_left_out = {name: (left_out[name], offsets_left_out[name]) for name in left_out}
    return Calibration(center, error, offsets, spread, fits_left_out)


def calibrated_fleet(problem: FleetProblem, calibration: Calibration) -> Fleet:
    """The fleet with its fitted constants; the other constants stay."""
    distributions = dict(problem.fleet.parameters)
    for parameter, x, error in zip(
        problem.parameters, calibration.center, calibration.error, strict=True
    ):
        values = {
            "center": parameter.value(x),
            "spread": calibration.spread.get(parameter.name, parameter.spread),
            "center_uncertainty": float(error),
        }
        if not parameter.is_log:
            values["minimum"] = parameter.minimum
        rounded = {key: float(f"{value:.4g}") for key, value in values.items()}
        family = "lognormal" if parameter.is_log else "normal"
        distributions[parameter.name] = Distribution(family, rounded)
    return replace(problem.fleet, name=f"{problem.fleet.name}_calibrated", parameters=distributions)


def single_motors(
    problem: FleetProblem, center: np.ndarray, left_out: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, float], dict[str, np.ndarray]]:
    """Fit offsets of single motors, linearly about the (P,) centre of all logs.

    ``left_out``: log name -> (P,) centre fitted without this log; empty for a single log. Returns
    offsets and spread, see `Calibration`; log name -> offsets without this log.
    """
    varying = [problem.parameters[index] for index in problem.varying]
    names = list(problem.replayers)
    spread = np.tile([parameter.spread for parameter in varying], len(problem.joints))
    if not varying:
        return spread, {}, dict.fromkeys(left_out, spread)

    # residuals and Jacobian without each of the logs
    linear_left_out: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, x in left_out.items():
        remaining = [log for log in names if log != name]
        linear_left_out[name] = _linear(problem, remaining, x, spread)

    def cross_validation_error(multiple: float) -> float:
        errors = []
        for name, (residuals, slope) in linear_left_out.items():
            offsets = _offsets(residuals, slope, multiple * spread)
            errors.append(problem.rmse(name, left_out[name], offsets))
        return sum(errors)

    multiple = 1.0
    if linear_left_out:
        multiple = min(_SPREAD_MULTIPLES, key=cross_validation_error)
    prior = multiple * spread

    residuals, slope = _linear(problem, names, center, spread)
    offsets = _offsets(residuals, slope, prior)

    # one step of expectation maximisation
    variance = np.diag(np.linalg.inv(slope.T @ slope + np.diag(prior**-2)))
    squares = (offsets**2 + variance).reshape(len(problem.joints), len(varying))
    fitted_spread = np.maximum(np.sqrt(squares.mean(axis=0)), _MIN_SPREAD).tolist()

    spread_by_name = {
        parameter.name: value for parameter, value in zip(varying, fitted_spread, strict=True)
    }
    offsets_left_out = {name: _offsets(*linear, prior) for name, linear in linear_left_out.items()}
    return offsets, spread_by_name, offsets_left_out


def _linear(
    problem: FleetProblem, logs: Sequence[str], center: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (N,) of logs at a centre, and their Jacobian (N, offsets)."""
    columns = []
    for step in np.diag(spread):
        difference = problem.residuals(logs, center, step) - problem.residuals(logs, center, -step)
        columns.append(difference / (2.0 * step.max()))
    residuals = problem.residuals(logs, center, np.zeros_like(spread))
    return residuals, np.stack(columns, axis=1)


def _offsets(residuals: np.ndarray, slope: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(offsets,) minimum of the sum of squares of r + J·y, with the prior N(0, spread²) of y."""
    return -np.linalg.solve(slope.T @ slope + np.diag(spread**-2), slope.T @ residuals)
