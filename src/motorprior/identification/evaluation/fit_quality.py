"""How well a prior's motors replay the logs they were fitted to, beside a PD that was fitted as carefully as it can be.

Segments are replayed from where they begin with their commands and loads, nothing corrected on the way: the error is
that of a simulation. Where the motors leave more than MISSING of the PD's error, besides what no log can tell
(MEASURED), they lack physics, or have other constants than the true motors: then constants are not to be read as
physics, and draws are widened. Where the log states gains, the PD follows them as the motors do, in proportion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.latent import LatentActuator
from motorprior.exceptions import listed
from motorprior.identification.baselines.pd_fit import tuned_pd
from motorprior.identification.baselines.replay_error import AtGains, scaled_gains
from motorprior.identification.evaluation.reference import SPEEDS, replayed_segments, replays, told
from motorprior.identification.training_data.windows import seconds_of_work
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rms

MISSING = 0.35
"""Error over the tuned PD's from which on a fit counts as lacking physics [-]."""
MEASURED = 0.002
"""Error that counts as explained [rad]: encoders of servos tell an angle to 1.5 mrad, and a motion may be so easy that
a PD comes as near as that, too."""

_NAMED = 10
"""Most motors that a line names."""


@dataclass(frozen=True)
class FitQuality:
    """Root mean square errors of replayed angles [rad].

    ``of_the_log`` tells whether the motors were fitted to this log, or are those of a prior that was fitted to others.

    Attributes:
        motors: (M,) of every motor.
        baseline: (M,) of the tuned PD, the same for all motors.
        speeds: of each pool of `reference.SPEEDS`, by its name; nan where no joint was so fast.
        segments: of every segment that was replayed (`reference.replayed_segments`), by its place in the log.
        num_segments: of the log.
        joint_names: M names.
    """

    motors: np.ndarray
    baseline: np.ndarray
    speeds: dict[str, float]
    segments: dict[int, float]
    num_segments: int
    joint_names: tuple[str, ...]
    of_the_log: bool = True

    @property
    def unexplained_of_each(self) -> np.ndarray:
        """(M,) √(max(e² - MEASURED², 0)) / e_PD of every motor, with its errors e and the tuned PD's [-]."""
        errors = np.where(np.isfinite(self.motors), self.motors, 1.0)  # a motor that breaks down explains nothing
        left = np.sqrt(np.maximum(errors**2 - MEASURED**2, 0.0))
        return left / np.maximum(self.baseline, 1e-9)

    @property
    def unexplained(self) -> float:
        """Median of `unexplained_of_each`."""
        return float(np.median(self.unexplained_of_each))

    @property
    def misses_physics(self) -> bool:
        """Whether that is above MISSING."""
        return self.unexplained > MISSING

    @property
    def widening(self) -> float:
        """Factor on the spread of draws around the central motor: 1 up to MISSING, 2 where nothing is explained."""
        return 1.0 + max(0.0, min(1.0, self.unexplained) - MISSING) / (1.0 - MISSING)

    def lines(self) -> tuple[str, ...]:
        """What a user should know, a line each."""
        worst, segment = int(self.motors.argmax()), list(self.segments)[int(np.argmax(list(self.segments.values())))]
        some = f" (of {len(self.segments)} of {self.num_segments} segments that were replayed)"
        some = "" if len(self.segments) == self.num_segments else some
        speeds = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in self.speeds.items() if np.isfinite(value))
        said = (
            f"replayed logs: {1e3 * np.median(self.motors):.1f} mrad (median over motors), one PD tuned "
            f"to all of them {1e3 * np.median(self.baseline):.1f} mrad",
            f"worst: {self.joint_names[worst]} with {1e3 * self.motors[worst]:.1f} mrad, segment {segment} with "
            f"{1e3 * self.segments[segment]:.1f} mrad{some}; by speed of the joint [mrad]: {speeds}",
        )
        if not self.misses_physics:
            return (*said, *self._odd_motors())
        return (
            *said,
            f"warning: {100 * self.unexplained:.0f} % of the PD's error is left (above {100 * MISSING:.0f} %): "
            f"{self._cause()}. Do not read the constants as physics",
        )

    def _cause(self) -> str:
        """Why the motors may replay the log badly."""
        if self.of_the_log:
            return (
                "these motors have physics that the model lacks, or the fit ended beside their constants, as on short "
                "logs of few motors (try another seed, or more log)"
            )
        if self.unexplained > 1.0:
            return "the log is of other motors than the prior's: learn a prior of such motors"
        return "these motors are unlike the prior's, or have physics that the model lacks"

    def _odd_motors(self) -> tuple[str, ...]:
        """A line about single motors of which more than MISSING is left; none where there is none."""
        share = self.unexplained_of_each
        odd = np.flatnonzero(share > MISSING)
        if not odd.size:
            return ()
        named = listed([f"{self.joint_names[motor]} {100 * share[motor]:.0f} %" for motor in odd], _NAMED)
        return (
            f"warning: more than {100 * MISSING:.0f} % of the PD's error is left of {named}. Do not read the "
            "constants of these motors as physics",
        )


def fit_quality(
    motors: Actuator,
    log: MotorLog,
    report: Callable[[int], None] = lambda count: None,
    of_the_log: bool = True,
    usual: Mapping[str, float] = MappingProxyType({}),
) -> FitQuality:
    """Replay a log with its motors, and with a PD tuned to it.

    Args:
        motors: one per joint of the log.
        log: with known loads.
        report: called after every evaluation of the tuning.
        of_the_log: whether the motors were fitted to this log.
        usual: conditions of the motors' recipe.
    """
    tell = scaled_gains(log)
    pd = tuned_pd(log, report, tell)
    segments, pools = zip(*replays(motors, log, _as_warm_as_there(log, usual)), strict=True)
    error, pool = np.concatenate(segments), np.concatenate(pools)
    baseline = np.concatenate([missed for missed, _ in replays(pd, log, tell)])
    places = replayed_segments(log).tolist()
    return FitQuality(
        _rms(error, axis=0), _rms(baseline, axis=0),
        {name: float(_rms(error[pool == index])) for index, name in enumerate(SPEEDS)},
        {place: float(_rms(missed)) for place, missed in zip(places, segments, strict=True)},
        len(log.segment_slices()), log.joint_names, of_the_log,
    )  # fmt: skip


def _as_warm_as_there(log: MotorLog, usual: Mapping[str, float]) -> AtGains:
    """What tells learned motors gains and conditions of a segment, how warm they are in its middle too, as the fit."""
    work, segment = seconds_of_work(log), np.zeros(len(log.time)) if log.segment is None else log.segment

    def tell(motors: Actuator, part: MotorLog) -> Actuator:
        motors = told(motors, part, usual)
        if not isinstance(motors, LatentActuator):
            return motors
        here = segment == (0 if part.segment is None else part.segment[0])
        warmth = motors.network.warmth(motors.z, float(np.median(work[here])))
        return replace(motors, conditions=motors.conditions._replace(warmth=warmth))

    return tell


def _rms(error: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Root mean square; nan of nothing."""
    return rms(error, axis) if error.size else np.array(np.nan)
