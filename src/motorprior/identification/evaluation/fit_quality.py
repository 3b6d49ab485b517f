"""How well a prior's motors replay the logs they were fitted to, compared with a carefully tuned PD.

Segments are replayed from their first rows without feedback of the recording. Where the motors' error is above MISSING
times the PD's, apart from an unavoidable MEASURED, the model lacks dynamics or the fit missed the constants: then
constants are not physical, and the standard deviation of samples is scaled. The PD's gains scale with logged gains.
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
from motorprior.identification.baselines.replay_error import scaled_gains
from motorprior.identification.evaluation.reference import at_log_conditions, replay_errors
from motorprior.identification.training_data.windows import seconds_of_work
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rms

MISSING = 0.35  # error over the tuned PD's above which a fit lacks dynamics [-]
# error that counts as explained [rad]: servo encoders resolve 1.5 mrad, and a PD may be as close on an easy motion
MEASURED = 0.002


@dataclass(frozen=True)
class FitQuality:
    """Root mean square errors of replayed angles."""

    motors: np.ndarray  # (M,) of every motor [rad]
    baseline: np.ndarray  # (M,) of the tuned PD, the same for all motors [rad]
    joint_names: tuple[str, ...]
    of_the_log: bool = True  # the motors were fitted to this log, not to others

    @property
    def unexplained_of_each(self) -> np.ndarray:
        """(M,) √(max(e² - MEASURED², 0)) / e_PD of every motor, with its error e and the tuned PD's [-]."""
        errors = np.where(np.isfinite(self.motors), self.motors, 1.0)  # a diverged simulation explains nothing
        return np.sqrt(np.maximum(errors**2 - MEASURED**2, 0.0)) / np.maximum(self.baseline, 1e-9)

    @property
    def unexplained(self) -> float:
        """Median of `unexplained_of_each`."""
        return float(np.median(self.unexplained_of_each))

    @property
    def misses_physics(self) -> bool:
        """Whether that is above MISSING."""
        return self.unexplained > MISSING

    @property
    def std_scale(self) -> float:
        """Factor on the standard deviation of samples: 1 up to MISSING, 2 where nothing is explained."""
        return 1.0 + max(0.0, min(1.0, self.unexplained) - MISSING) / (1.0 - MISSING)

    def lines(self) -> list[str]:
        """A summary and warnings for the user."""
        worst, share = int(self.motors.argmax()), self.unexplained_of_each
        lines = [
            f"replayed logs: {1e3 * np.median(self.motors):.1f} mrad (median over motors), one PD tuned to all of them "
            f"{1e3 * np.median(self.baseline):.1f} mrad; worst: {self.joint_names[worst]} with "
            f"{1e3 * self.motors[worst]:.1f} mrad"
        ]
        poor = [
            f"{name} {100 * part:.0f} %" for name, part in zip(self.joint_names, share, strict=True) if part > MISSING
        ]
        if self.misses_physics:
            cause = "the model lacks dynamics of these motors, or the search missed their constants (try another seed)"
            if not self.of_the_log:
                cause = "these motors differ from the prior's, or the model lacks some of their dynamics"
            lines.append(
                f"warning: {100 * self.unexplained:.0f} % of the PD's error is left (above {100 * MISSING:.0f} %): "
                f"{cause}. Do not read the constants as physical"
            )
        elif poor:
            lines.append(
                f"warning: more than {100 * MISSING:.0f} % of the PD's error is left of {listed(poor, 10)}. Do not "
                "read the constants of these motors as physical"
            )
        return lines


def fit_quality(
    motors: Actuator,
    log: MotorLog,
    report: Callable[[int], None] = lambda count: None,
    of_the_log: bool = True,
    usual: Mapping[str, float] = MappingProxyType({}),
) -> FitQuality:
    """Replay a log with known loads with its motors, and with a PD tuned to it.

    ``report`` is called after every evaluation of the tuning; ``usual`` are the conditions of the motors' recipe.
    """
    work, segment = seconds_of_work(log), np.zeros(len(log.time)) if log.segment is None else log.segment

    def at_segment(motors: Actuator, part: MotorLog) -> Actuator:
        # as in the fit: the temperature rise of the middle of the segment
        motors = at_log_conditions(motors, part, usual)
        if not isinstance(motors, LatentActuator):
            return motors
        here = segment == (0 if part.segment is None else part.segment[0])
        warmth = motors.network.warmth(motors.z, float(np.median(work[here])))
        return replace(motors, conditions=motors.conditions._replace(warmth=warmth))

    at_gains = scaled_gains(log)
    pd = tuned_pd(log, report, at_gains)
    errors, baseline = replay_errors(motors, log, at_segment)[0], replay_errors(pd, log, at_gains)[0]
    return FitQuality(rms(errors, axis=0), rms(baseline, axis=0), log.joint_names, of_the_log)
