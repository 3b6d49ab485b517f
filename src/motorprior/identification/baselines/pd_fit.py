"""Fit of a PD, the same for all motors of a log, by the search of the motors' own fit.

The unknowns are the logarithms of the constants relative to TYPICAL, with two exceptions: kd/kp
replaces kd, and the delay is in units of 10 ms. If a log has gains, the gains of the PD scale with
them. A log may not separate a large armature from a long delay, so random candidates are sampled
around TYPICAL, with and without a torque limit. The search runs on a part of a long log.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.identification.checkpoint import PartCheckpoint, unsaved_part
from motorprior.identification.physics.window_runs import (
    POSITION_SCALE,
    SegmentArrays,
    TorqueMotors,
    whole_runs,
)
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import NARROW, WIDE, Fit, GaussianPrior, Search
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import Progress
from motorprior.signals import rms

IDEAL_PD = ("kp", "kd", "torque_limit")  # free constants of an ideal PD
WITH_ROTOR = (*IDEAL_PD, "armature", "delay")  # free constants of the tuned PD
WITH_FRICTION = (*WITH_ROTOR, "coulomb")
TYPICAL = {
    "kp": 10.0,  # [N·m/rad]
    "kd": 0.6,  # [N·m·s/rad]
    "torque_limit": 4.0,  # [N·m]
    "armature": 0.004,  # [kg·m²]
    "delay": 0.01,  # [s]
    "coulomb": 0.05,  # [N·m]
}
# standard deviations of the unknowns of candidates
CANDIDATE_STD = {
    "kp": 1.5,
    "kd": 0.8,
    "torque_limit": 1.2,
    "armature": 1.5,
    "delay": 1.5,
    "coulomb": 1.2,
}
NO_LIMIT = 1000.0  # [N·m]
# [rad] quadratic-to-linear transition of the loss; large, since tables have RMS errors
SCALE = 0.05
RESTARTS = 16  # maximum number of restarts
_CANDIDATES = 128
_STEPS = ((10, WIDE), (6, NARROW))
_WEAK = 1e-6  # precision of the prior that keeps unidentifiable constants in place
_WARM_UP = 0.1  # [s] of a segment, until the delayed commands are known
# size of the log that the search uses
_MAX_SEGMENTS = 16
_MAX_ROWS = 8000
_LANES = 16  # PDs simulated at a time
_STREAM = 71


@dataclass(frozen=True)
class PdFit:
    """Fitted PD."""

    constants: Mapping[str, float]  # by name
    error: float  # root mean square error on the log [rad]


class _PdProblem:
    """One PD for all motors; see `search.Problem`.

    Constants that are not ``free`` have the values ``fixed``.
    """

    count = 1
    weight = 1.0

    def __init__(self, log: MotorLog, free: tuple[str, ...], fixed: Mapping[str, float]):
        warm_up = round(_WARM_UP / log.period)
        recipe = replace(PRESETS["pace"], period=log.period, warm_up=warm_up)
        self._runs = whole_runs(log, recipe)
        self._gains = _median_gains(log)
        self._free = free
        self._fixed = fixed
        self.observations = len(self._runs) * log.num_joints

    def constants(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """(L,) constants by name of unknowns x (L, K)."""
        values = {name: np.full(len(x), value) for name, value in self._fixed.items()}
        for name, column in zip(self._free, np.clip(x, -20.0, 20.0).T, strict=True):
            if name == "delay":
                values[name] = TYPICAL["delay"] * np.abs(column)
            else:
                values[name] = TYPICAL[name] * np.exp(column)
        # its unknown is the logarithm of kd/kp
        if "kd" in self._free:
            values["kd"] = values["kd"] * values["kp"] / TYPICAL["kp"]
        return values

    def encoded(self, constants: Mapping[str, float]) -> np.ndarray:
        """(K,) unknowns of constants by name."""
        unknowns = []
        for name in self._free:
            if name == "delay":
                unknowns.append(constants["delay"] / TYPICAL["delay"])
                continue
            unknown = np.log(constants[name] / TYPICAL[name])
            if name == "kd":
                unknown -= np.log(constants["kp"] / TYPICAL["kp"])
            unknowns.append(unknown)
        return np.array(unknowns)

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, rows·motors) errors of angles over SCALE, with unknowns x (L, K)."""
        chunks = []
        for first in range(0, len(x), _LANES):
            chunks.append(self._errors(x[first : first + _LANES]))
        return np.concatenate(chunks)

    def _errors(self, x: np.ndarray) -> np.ndarray:
        """(L, rows·motors) errors of angles over SCALE."""
        num_motors = self._runs[0].num_motors
        # every PD replays every motor
        motor = np.tile(np.arange(num_motors), len(x))
        lanes = np.repeat(x, num_motors, axis=0)
        errors = []
        for runs in self._runs:
            positions = runs.residuals(self._motors, lanes, motor)[:, :, 0]
            scaled = POSITION_SCALE / SCALE * positions
            errors.append(scaled.reshape(len(x), num_motors, -1))
        return np.concatenate(errors, axis=2).reshape(len(x), -1)

    def _motors(self, x: np.ndarray, motor: np.ndarray, segment: SegmentArrays) -> IdealPd:
        """PDs of unknowns x (L, K), at the gains of motors (L,) in the segment."""
        pd = IdealPd(**self.constants(x))
        if self._gains is None:
            return pd
        return GainScaledPd(pd, self._gains).at(segment.gains[:, motor])

    def rmse(self, x: np.ndarray) -> float:
        """Root mean square error [rad] of unknowns x (1, K)."""
        return SCALE * float(rms(self._errors(x).astype(np.float64)))


def fit_pd(
    log: MotorLog,
    free: tuple[str, ...],
    start: Mapping[str, float] | None = None,
    report: Callable[[], None] = lambda: None,
    checkpoint: PartCheckpoint = unsaved_part,
) -> PdFit:
    """Fit one PD to all motors of a log with known loads.

    Args:
        log: with loads, and gains or none.
        free: constants that are fitted; without armature, delay or friction the PD has none.
        start: constants of one more candidate.
        report: called RESTARTS times.
        checkpoint: saves every descent.
    """
    fixed = {name: 0.0 for name in WITH_FRICTION if name not in free}
    problem = _PdProblem(_part(log), free, fixed)
    search = Search(problem, checkpoint=checkpoint)
    rng = np.random.default_rng(_STREAM)
    std = np.array([CANDIDATE_STD[name] for name in free])
    is_limit = np.array(free) == "torque_limit"
    unlimited = np.log(NO_LIMIT / TYPICAL["torque_limit"])
    prior = GaussianPrior(np.where(is_limit, unlimited, 0.0), np.full(len(free), _WEAK))

    def draw(restart: int, best: Fit) -> np.ndarray:
        shape = (1, _CANDIDATES, len(free))
        candidates = std * rng.standard_normal(shape)
        has_no_limit = rng.random((1, _CANDIDATES, 1)) < 0.5
        limits = candidates[..., is_limit]
        candidates[..., is_limit] = np.where(has_no_limit, unlimited, limits)
        if restart % 2:
            candidates = np.where(rng.random(shape) < 0.5, candidates, best.x[:, None])
        return candidates

    constants = TYPICAL | {"torque_limit": NO_LIMIT} | dict(start or {})
    first = search.at(problem.encoded(constants)[None], prior)
    fit = search.until_found_again(first, prior, draw, RESTARTS, _STEPS, report)

    # the last descent is on the whole log
    whole = _PdProblem(log, free, fixed)
    x = Search(whole, checkpoint=checkpoint).descend(fit.x, prior, _STEPS).x
    fitted = {name: float(values[0]) for name, values in whole.constants(x).items()}
    return PdFit(fitted, whole.rmse(x))


def _median_gains(log: MotorLog) -> np.ndarray | None:
    """(2,) medians of `MotorLog.gains` over the motors of a log; None if it has no gains."""
    return None if log.gains is None else np.median(log.gains, axis=1)


def _part(log: MotorLog) -> MotorLog:
    """Windows spread over a log, each as a segment; the whole log if it is short."""
    if log.num_rows <= _MAX_ROWS:
        return log

    segments = log.segment_slices()
    num_segments = min(len(segments), _MAX_SEGMENTS)
    indices = np.linspace(0, len(segments) - 1, num_segments, dtype=int)
    windows = []
    for index in indices:
        rows = np.arange(segments[index].start, segments[index].stop)
        windows += np.array_split(rows, _MAX_SEGMENTS // num_segments)

    max_rows = _MAX_ROWS // len(windows)
    windows = [window[:max_rows] for window in windows]
    number = np.repeat(np.arange(len(windows)), [len(window) for window in windows])
    return replace(log.rows(np.concatenate(windows)), segment=number)


def fitted_tuned_pd(
    log: MotorLog,
    progress: Progress,
    num_motors: int | None = None,
    checkpoint: PartCheckpoint = unsaved_part,
) -> TorqueMotors:
    """The tuned PD: one PD for all motors of a log, which scales with logged gains.

    It has ``num_motors`` copies, or one per joint of the log.
    """
    with progress.start("tune one PD", RESTARTS) as task:
        fit = fit_pd(log, WITH_ROTOR, report=task.advance, checkpoint=checkpoint)
    pd = IdealPd.uniform(num_motors or log.num_joints, **fit.constants)
    gains = _median_gains(log)
    return pd if gains is None else GainScaledPd(pd, gains)
