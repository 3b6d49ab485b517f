"""Fit of a PD, the same for all motors of a log, by the search of the motors' own fit.

Unknowns are the logarithms of the constants relative to TYPICAL, of kd that of kd/kp, and the delay
in units of 10 ms. Where a log has gains, those of the PD scale with them. Random candidates are
sampled around TYPICAL, with and without a torque limit, since a log may not separate a large
armature from a long delay. The search runs on a part of a long log.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.ideal_pd import GainScaledPd, IdealPd
from motorprior.identification.physics.window_runs import (
    POSITION_SCALE,
    MotorsOnLoads,
    SegmentArrays,
    whole_runs,
)
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import NARROW, WIDE, Fit, GaussianPrior, Search
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import Progress
from motorprior.signals import rms

GAINS = ("kp", "kd", "torque_limit")  # fitted for an ideal PD
WITH_ROTOR = (*GAINS, "armature", "delay")  # free constants of the tuned PD
WITH_FRICTION = (*WITH_ROTOR, "coulomb")
# [N·m/rad], [N·m·s/rad], [N·m], [kg·m²], [s], [N·m], and standard deviations of the unknowns of
# candidates
TYPICAL = {
    "kp": 10.0,
    "kd": 0.6,
    "torque_limit": 4.0,
    "armature": 0.004,
    "delay": 0.01,
    "coulomb": 0.05,
}
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
    """Constants by name, and root mean square error on the log [rad]."""

    constants: Mapping[str, float]
    error: float


class _PdProblem:
    """One PD for all motors; see `search.Problem`."""

    count = 1
    weight = 1.0

    def __init__(self, log: MotorLog, free: tuple[str, ...], fixed: Mapping[str, float]):
        recipe = replace(PRESETS["pace"], period=log.period, warm_up=round(_WARM_UP / log.period))
        self._runs = whole_runs(log, recipe)
        self._gains = _median_gains(log)
        self._free, self._fixed, self.observations = free, fixed, len(self._runs) * log.num_joints

    def constants(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """(L,) constants by name of unknowns x (L, K)."""
        values = {name: np.full(len(x), value) for name, value in self._fixed.items()}
        for name, column in zip(self._free, np.clip(x, -20.0, 20.0).T, strict=True):
            values[name] = (
                TYPICAL["delay"] * np.abs(column)
                if name == "delay"
                else TYPICAL[name] * np.exp(column)
            )
        if "kd" in self._free:
            values["kd"] = values["kd"] * values["kp"] / TYPICAL["kp"]
        return values

    def encoded(self, constants: Mapping[str, float]) -> np.ndarray:
        """(K,) unknowns of constants by name."""
        values = {
            name: np.log(constants[name] / TYPICAL[name]) for name in self._free if name != "delay"
        }
        if "kd" in self._free:
            values["kd"] -= np.log(constants["kp"] / TYPICAL["kp"])
        return np.array(
            [values.get(name, constants["delay"] / TYPICAL["delay"]) for name in self._free]
        )

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, rows·motors) errors of angles over SCALE."""
        return np.concatenate(
            [self._errors(x[first : first + _LANES]) for first in range(0, len(x), _LANES)]
        )

    def _errors(self, x: np.ndarray) -> np.ndarray:
        motors = self._runs[0].num_motors
        found = []
        every = np.tile(np.arange(motors), len(x))
        lanes = np.repeat(x, motors, axis=0)
        for runs in self._runs:
            errors = POSITION_SCALE / SCALE * runs.residuals(self._motors, lanes, every)[:, :, 0]
            found.append(errors.reshape(len(x), motors, -1))
        return np.concatenate(found, axis=2).reshape(len(x), -1)

    def _motors(self, x: np.ndarray, motor: np.ndarray, segment: SegmentArrays) -> IdealPd:
        pd = IdealPd(**self.constants(x))
        return (
            pd if self._gains is None else GainScaledPd(pd, self._gains).at(segment.gains[:, motor])
        )

    def rmse(self, x: np.ndarray) -> float:
        """Root mean square error [rad] of unknowns x (1, K)."""
        return SCALE * float(rms(self._errors(x).astype(np.float64)))


def fit_pd(
    log: MotorLog,
    free: tuple[str, ...],
    start: Mapping[str, float] | None = None,
    report: Callable[[], None] = lambda: None,
) -> PdFit:
    """One PD for all motors of a log with known loads.

    The ``free`` constants are fitted; without the armature, delay or friction it has none.
    ``start`` is one more candidate; ``report`` is called RESTARTS times.
    """
    fixed = {name: 0.0 for name in WITH_FRICTION if name not in free}
    search = Search(few := _PdProblem(_part(log), free, fixed))
    rng = np.random.default_rng(_STREAM)
    std = np.array([CANDIDATE_STD[name] for name in free])
    limit = np.array(free) == "torque_limit"
    unlimited = np.log(NO_LIMIT / TYPICAL["torque_limit"])
    prior = GaussianPrior(np.where(limit, unlimited, 0.0), np.full(len(free), _WEAK))

    def draw(restart: int, best: Fit) -> np.ndarray:
        shape = (1, _CANDIDATES, len(free))
        found = std * rng.standard_normal(shape)
        found[..., limit] = np.where(
            rng.random((1, _CANDIDATES, 1)) < 0.5, unlimited, found[..., limit]
        )
        if restart % 2:
            found = np.where(rng.random(shape) < 0.5, found, best.x[:, None])
        return found

    first = few.encoded(TYPICAL | {"torque_limit": NO_LIMIT} | dict(start or {}))
    found = search.until_found_again(
        search.at(first[None], prior), prior, draw, RESTARTS, _STEPS, report
    )
    whole = _PdProblem(log, free, fixed)
    x = Search(whole).descend(found.x, prior, _STEPS).x
    constants = {name: float(values[0]) for name, values in whole.constants(x).items()}
    return PdFit(constants, whole.rmse(x))


def _median_gains(log: MotorLog) -> np.ndarray | None:
    gains = [part.gains for part in log.segments() if part.gains is not None]
    return np.median(gains, axis=(0, 2)) if gains else None


def _part(log: MotorLog) -> MotorLog:
    """Windows spread over a log, each as a segment; the whole log if it is short."""
    if log.num_rows <= _MAX_ROWS:
        return log
    segments = log.segment_slices()
    index = np.linspace(0, len(segments) - 1, min(len(segments), _MAX_SEGMENTS), dtype=int)
    windows = [
        window
        for one in (segments[each] for each in index)
        for window in np.array_split(np.arange(one.start, one.stop), _MAX_SEGMENTS // len(index))
    ]
    windows = [window[: _MAX_ROWS // len(windows)] for window in windows]
    number = np.repeat(np.arange(len(windows)), [len(window) for window in windows])
    return replace(log.rows(np.concatenate(windows)), segment=number)


def fitted_tuned_pd(
    log: MotorLog, progress: Progress, num_motors: int | None = None
) -> MotorsOnLoads:
    """One PD for all motors of a log, which scales with the gains of a log that has any; ``num_motors`` copies."""
    with progress.start("tune one PD", RESTARTS) as task:
        found = fit_pd(log, WITH_ROTOR, report=task.advance)
    pd = IdealPd.uniform(num_motors or log.num_joints, **found.constants)
    gains = _median_gains(log)
    return pd if gains is None else GainScaledPd(pd, gains)
