"""Fit an explanation together with the constants of each motor, and measure what it leaves.

Every attempt starts from the fitted motor, and from motors around it and around the initial motor,
since a fit to contradictory inputs may be far from the truth. The attempt without an explanation
comes first, and the others start from it. Its error is what an explanation must reduce.
"""

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.estimates import SCORE
from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, PARAMETERS, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.explanations.explanation import Explanation
from motorprior.identification.explanations.screen import (
    Unexplained,
    predicted_share,
    sensitivities,
    unexplained,
)
from motorprior.identification.physics.estimate_uncertainty import (
    blocks_of,
    curvature_and_scores,
    joint_covariance,
)
from motorprior.identification.physics.motor_problem import (
    TORQUES,
    MotorProblem,
    fixed_constants,
    initial_center,
    rigid_motor,
    scaled_center,
)
from motorprior.identification.physics.window_runs import (
    LANES_PER_TASK,
    POSITION_SCALE,
    SegmentArrays,
    WindowRuns,
    grey_boxes,
)
from motorprior.identification.search import (
    FIXED,
    NARROW,
    WIDE,
    GaussianPrior,
    Search,
    huber,
    threads,
)
from motorprior.logs.motor_log import PHYSICAL_GAINS
from motorprior.signals import rms

_CANDIDATES = 32
_STD_NEAR = 0.3  # of candidates around the fitted motor
_STD_INITIAL = 0.7  # of candidates around the initial motor
_FIRST_STEPS = ((8, WIDE),)
_STEPS = ((9, WIDE), (3, NARROW))
_RESTARTS = 1
_MAX_PARAMETER = 3.0  # largest parameter of candidates, over its unit
_STD_RESTART = 0.5
_INPUTS = 32  # changed rows at a time
_STREAM = 83
# weaker than the prior of a fit, since its mean is a fit to contradictory inputs
_CONSTANT_PRECISION = 1e-6
_PARAMETER_PRECISION = 1e-6
_FILTER_PRECISION = 1e-4


class _ExplainedProblem(MotorProblem):
    """Free runs of motors; the last P unknowns are parameters of an explanation, over its units.

    ``is_changed`` states for each segment whether the explanation changes it. The simulation needs
    the first ``columns`` channels of the rows.
    """

    def __init__(
        self,
        model: GreyBox,
        runs: WindowRuns,
        explanation: Explanation | None,
        is_changed: list[bool],
        columns: int,
    ):
        super().__init__(model, runs)
        self.columns = columns
        self.explanation = explanation
        self.is_changed = is_changed

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, windows·channels·steps) scaled errors, as `MotorProblem.residuals`."""
        if self.explanation is None:
            return super().residuals(x, problems)

        # lanes with the same log and parameters have the same inputs
        size = len(self.explanation.units)
        inputs = np.column_stack([problems, x[:, -size:]])
        unique, index = np.unique(inputs, axis=0, return_inverse=True)
        index = index.ravel()
        order = np.argsort(index, kind="stable")
        tasks = []
        for first in range(0, len(unique), _INPUTS):
            begin, end = np.searchsorted(index[order], (first, first + _INPUTS))
            lanes_of_inputs = order[begin:end]
            for lane in range(0, len(lanes_of_inputs), LANES_PER_TASK):
                lanes = lanes_of_inputs[lane : lane + LANES_PER_TASK]
                tasks.append((x[lanes], unique[first : first + _INPUTS], index[lanes] - first))
        errors = np.concatenate(list(threads().map(self._errors, tasks)))
        by_lane = np.empty_like(errors)
        by_lane[order] = errors
        return by_lane.reshape(len(x), -1)

    def _errors(self, task: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """(L, windows, channels, steps) scaled errors of L lanes.

        The task has unknowns x (L, K + P), some ``inputs`` (U, 1 + P), which are the index of the
        motor and the parameters, and the index of the inputs of every lane (L,).
        """
        assert self.explanation is not None
        x, inputs, index = task
        size = len(self.explanation.units)
        problems = inputs[:, 0].astype(int)
        theta = (inputs[:, 1:] * self.explanation.units).T
        errors = []
        for segment, is_changed in zip(self.runs.segments, self.is_changed, strict=True):
            rows = segment.rows[:, :, problems]
            if is_changed:
                with np.errstate(over="ignore", invalid="ignore"):  # a step may be far too long
                    rows = self.explanation.change(rows, theta, self.runs.recipe.period)
            rows = np.ascontiguousarray(rows[:, : self.columns])
            changed = SegmentArrays(rows, segment.windows)
            motors = grey_boxes(self.model)(x[:, :-size], index, changed)
            errors.append(self.runs.run(motors, index, changed))
        return np.concatenate(errors, axis=1)[:, self.runs.counted]


@dataclass(frozen=True)
class Attempt:
    """A fit of M motors with one explanation."""

    problem: _ExplainedProblem
    prior: GaussianPrior
    fixed: np.ndarray  # (K,) mask of the constants that are not fitted
    units: np.ndarray  # (P,)
    unknowns: np.ndarray  # (M, K + P)
    errors: np.ndarray  # (M,) position error [rad]; inf for joints that are not fitted
    half_widths: np.ndarray | None = None  # (M, P) of the 90 % intervals

    @property
    def values(self) -> np.ndarray:
        """(M, P) parameters."""
        count = self.unknowns.shape[1] - len(self.units)
        return self.unknowns[:, count:] * self.units


class Attempts:
    """Fits of explanations to the same logs.

    ``model`` decodes constants from ``fitted`` (M, K) relative to a central motor; `unchanged`
    replaces ``fitted``. Refined attempts have ``restarts``.
    """

    def __init__(
        self, model: GreyBox, fitted: np.ndarray, runs: WindowRuns, restarts: int = _RESTARTS
    ):
        self.runs = runs
        self.fixed = fixed_constants(model.terms, runs)
        self._restarts = restarts
        self._columns = runs.segments[0].rows.shape[1]

        # the decoder reaches the fitted motors and the initial motors from halfway between them
        scaled = scaled_center(runs, model.terms)
        rigid = rigid_motor(scaled, model.terms, runs)[0]
        initial = np.stack([scaled, rigid, initial_center(model.terms, runs)])
        outputs = model.center + fitted
        center = np.where(self.fixed, model.center, 0.5 * (np.median(outputs, axis=0) + scaled))
        self.fitted = np.clip(outputs - center, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        self.initial = np.clip(initial - center, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        # without stated gains, all gains are 1 and can be changed
        self.model = replace(model, center=center, gain_unit=model.gain_unit or PHYSICAL_GAINS)

    def unchanged(self, joints: np.ndarray) -> Attempt:
        """The best fit of some ``joints`` to the logs as they are. Later attempts start from it."""
        attempt = self.refined(self.begun(None, joints), joints)
        self.fitted = attempt.unknowns
        return attempt

    def errors_on(self, runs: WindowRuns, motors: np.ndarray | None = None) -> np.ndarray:
        """(M,) position errors [rad] in these runs of ``motors`` (M, K), or of the fitted ones."""
        problem = self._problem(None, runs)
        unknowns = self.fitted if motors is None else motors
        return self._errors(problem, unknowns, np.arange(len(unknowns)))

    def unexplained(self, joint: int) -> Unexplained:
        """Residuals of a fitted motor that its constants cannot explain."""
        free = np.flatnonzero(~self.fixed)
        return unexplained(self._problem(None, self.runs), self.fitted[joint], joint, free)

    def predicted_share(
        self,
        explanation: Explanation,
        joint: int,
        is_changed: list[bool],
        runs: WindowRuns,
        motor: Unexplained,
    ) -> tuple[float, np.ndarray]:
        """Share of a joint's error that an explanation leaves by a score test, and parameters."""
        problem = self._problem(explanation, runs, is_changed)
        return predicted_share(problem, motor, joint, len(explanation.units), explanation.is_even)

    def candidate_share(
        self, explanation: Explanation, joint: int, is_changed: list[bool], runs: WindowRuns
    ) -> float:
        """Share of a joint's error that the best candidate with an explanation leaves.

        It is below 1 for a cause with a large effect, for which the score test is not valid.
        """
        search = Search(self._problem(explanation, runs, is_changed))
        candidates = self._candidates(explanation, runs)[[joint]]
        fitted = np.append(self.fitted[joint], np.zeros(len(explanation.units)))
        points = np.concatenate([fitted[None, None], candidates], axis=1)
        losses = search.losses(points, np.array([joint]))[0] / search.problem.weight
        sizes = np.sqrt((1.0 + losses) ** 2 - 1.0)  # of one residual with this Huber loss
        return float(sizes[1:].min() / max(sizes[0], 1e-12))

    def _problem(
        self,
        explanation: Explanation | None,
        runs: WindowRuns,
        is_changed: list[bool] | None = None,
    ) -> _ExplainedProblem:
        is_changed = is_changed or [True] * len(runs.segments)
        return _ExplainedProblem(self.model, runs, explanation, is_changed, self._columns)

    def begun(
        self,
        explanation: Explanation | None,
        joints: np.ndarray,
        is_changed: list[bool] | None = None,
        runs: WindowRuns | None = None,
        predicted: np.ndarray | None = None,
    ) -> Attempt:
        """A few steps of some ``joints`` (indices) with this explanation.

        The explanation changes the segments ``is_changed``, all by default. ``runs`` replaces the
        runs. ``predicted`` (M, P) parameters, over their units, are one of the candidates.
        """
        runs = runs or self.runs
        problem = self._problem(explanation, runs, is_changed)
        search = Search(problem)
        units = () if explanation is None else explanation.units
        size = len(units)

        fixed, fitted = self._fixed(explanation)
        x = np.concatenate([fitted, np.zeros((len(fitted), size))], axis=1)
        prior = self._prior(x, fixed, size)
        candidates = self._candidates(explanation, runs)[joints]
        candidates[:, 0] = x[joints]
        if predicted is not None:
            candidates[:, 1] = x[joints]
            candidates[:, 1, -size:] = predicted[joints]
        near_fitted, near_initial = np.split(candidates, 2, axis=1)
        start = search.best_of(near_fitted, prior, joints)
        fit = search.descend(start, prior, _FIRST_STEPS, joints)
        start = search.best_of(near_initial, prior, joints)
        fit = fit.better(search.descend(start, prior, _FIRST_STEPS, joints))
        if predicted is not None and explanation is not None and explanation.is_even:
            # its loss may be larger at first, until the constants follow
            fit = fit.better(search.descend(candidates[:, 1], prior, _FIRST_STEPS, joints))
        x[joints] = fit.x
        return Attempt(problem, prior, fixed, np.array(units), x, self._errors(problem, x, joints))

    def refined(self, attempt: Attempt, joints: np.ndarray) -> Attempt:
        """The best fit of some ``joints``, with intervals; others have an infinite error."""
        search = Search(attempt.problem)
        x = attempt.unknowns.copy()
        errors = np.full(len(x), np.inf)
        half_widths = np.full((len(x), len(attempt.units)), np.inf)
        if joints.size:
            x[joints] = self._refined(search, x[joints], attempt.prior, attempt.fixed, joints)
            errors = self._errors(attempt.problem, x, joints)
        if len(attempt.units):
            for joint in joints.tolist():
                half_widths[joint] = self._half_widths(x[joint], joint, attempt)
        return replace(attempt, unknowns=x, errors=errors, half_widths=half_widths)

    def with_signs(self, attempt: Attempt, joints: np.ndarray, signs: np.ndarray) -> Attempt:
        """The refined attempt of some ``joints``, with these signs (P,) of their parameters."""
        size = len(attempt.units)
        x = attempt.unknowns.copy()
        x[joints, -size:] = signs * np.abs(x[joints, -size:])
        half_widths = np.full((len(x), size), np.inf)
        for joint in joints.tolist():
            half_widths[joint] = self._half_widths(x[joint], joint, attempt)
        errors = self._errors(attempt.problem, x, joints)
        return replace(attempt, unknowns=x, errors=errors, half_widths=half_widths)

    def _fixed(self, explanation: Explanation | None) -> tuple[np.ndarray, np.ndarray]:
        """(K,) mask of constants that are not fitted, and (M, K) motors to start from."""
        if explanation is None:
            return self.fixed, self.fitted
        names = parameters_of(self.model.terms)
        is_replaced = np.isin(names, explanation.replaces)
        is_held = np.isin(names, explanation.held)
        fitted = np.where(is_replaced, -self.model.center, self.fitted)
        fitted = np.where(is_held, self.initial[0], fitted)
        return self.fixed | is_replaced | is_held, fitted

    def _refined(
        self,
        search: Search,
        x: np.ndarray,
        prior: GaussianPrior,
        fixed: np.ndarray,
        joints: np.ndarray,
    ) -> np.ndarray:
        """(m, K + P) best points of descents from x, and from points around the best one."""
        rng = np.random.default_rng(_STREAM)
        fit = search.descend(x, prior, _STEPS, joints)
        size = x.shape[1] - len(fixed)
        is_free = np.append(~fixed, np.ones(size, bool))
        for _ in range(self._restarts):
            shape = (len(joints), _CANDIDATES, x.shape[1])
            is_changed = is_free & (rng.random(shape) < 0.5)
            noise = _STD_RESTART * rng.standard_normal(shape)
            changed = fit.x[:, None] + noise
            # every second candidate has some constants of an initial motor
            initial = self.initial[rng.integers(len(self.initial), size=shape[:2])]
            changed[:, ::2, : len(fixed)] = (initial + noise[..., : len(fixed)])[:, ::2]
            start = search.best_of(np.where(is_changed, changed, fit.x[:, None]), prior, joints)
            fit = fit.better(search.descend(start, prior, _STEPS, joints))
        return fit.x

    def _errors(self, problem: _ExplainedProblem, x: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """(M,) position errors [rad] of ``joints`` at the unknowns x (M, K + P); others inf."""
        errors = np.full(len(x), np.inf)
        for joint in joints:
            residuals = problem.residuals(x[[joint]], np.array([joint]))
            shape = (len(problem.runs.counted), problem.runs.channels, -1)
            positions = residuals.reshape(shape)[:, 0].astype(np.float64)
            with np.errstate(over="ignore", invalid="ignore"):
                error = float(rms(positions.ravel()))
            errors[joint] = POSITION_SCALE * error if np.isfinite(error) else np.inf
        return errors

    def _prior(self, fitted: np.ndarray, fixed: np.ndarray, size: int) -> GaussianPrior:
        """Weak prior around the fitted motors; around the initial motor for the velocity filter."""
        count = self.fitted.shape[1]
        velocity_filter = PARAMETERS.index("velocity_filter")
        mean = fitted.copy()
        mean[:, velocity_filter] = self.initial[0, velocity_filter]
        precision = np.full(fitted.shape, _PARAMETER_PRECISION)
        precision[:, :count] = _CONSTANT_PRECISION
        precision[:, velocity_filter] = _FILTER_PRECISION

        is_fixed = np.append(fixed, np.zeros(size, bool))
        precision = np.where(is_fixed, FIXED, precision)
        return GaussianPrior(np.where(is_fixed, fitted, mean), precision)

    def _candidates(self, explanation: Explanation | None, runs: WindowRuns) -> np.ndarray:
        """(M, C, K + P) candidates with parameters of any size.

        Half of them are the fitted motors and motors near them, half the initial motors and motors
        around them.
        """
        rng = np.random.default_rng(_STREAM)
        fixed, fitted = self._fixed(explanation)
        motors, count = fitted.shape
        size = 0 if explanation is None else len(explanation.units)
        index = np.arange(_CANDIDATES)
        is_noisy = (index % 3 == 2)[:, None]
        noise = rng.standard_normal((motors, _CANDIDATES, count)) * is_noisy
        initial = self.initial[index % len(self.initial)]
        is_initial = (index >= _CANDIDATES // 2)[:, None]
        constants = np.where(
            is_initial, initial + _STD_INITIAL * noise, fitted[:, None] + _STD_NEAR * noise
        )

        # parameters fill a cube, and its diagonal: factors are often equal
        parameters = np.empty((motors, _CANDIDATES, size))
        for column in range(size):
            grid = np.linspace(-_MAX_PARAMETER, _MAX_PARAMETER, _CANDIDATES)
            parameters[..., column] = rng.permutation(grid)
        parameters[:, 1::4] = parameters[:, 1::4, :1]
        if explanation is not None and explanation.guess is not None:
            rows = np.concatenate([segment.rows for segment in runs.segments])
            guess = explanation.guess(rows) / explanation.units
            parameters[:, ::2] = guess[:, None] + 0.05 * parameters[:, ::2]
        if explanation is not None and explanation.scales_torques:
            is_torque = np.isin(parameters_of(self.model.terms), TORQUES)
            constants = constants + is_torque * parameters[..., :1] * explanation.units[0]

        constants = np.clip(constants, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        constants = np.where(fixed, fitted[:, None], constants)
        return np.concatenate([constants, parameters], axis=2)

    def _half_widths(self, x: np.ndarray, joint: int, attempt: Attempt) -> np.ndarray:
        """(P,) half widths of the 90 % intervals of a joint's parameters, at its unknowns x."""
        size = len(attempt.units)
        problem = attempt.problem
        free = np.flatnonzero(np.append(~attempt.fixed, np.ones(size, bool)))
        residuals, slopes = sensitivities(problem, x, joint, free, WIDE)
        curvature, scores = curvature_and_scores(
            problem, residuals, slopes, blocks_of(problem.runs)
        )
        loss = problem.weight * float(np.mean(huber(residuals)))
        covariance = joint_covariance(curvature, scores, loss)
        variance = np.diagonal(covariance)[len(free) - size :]
        return SCORE * np.sqrt(variance) * attempt.units
