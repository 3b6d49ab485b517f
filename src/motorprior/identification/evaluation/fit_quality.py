"""Errors of motors and of a tuned PD in replays of a log.

Segments are replayed from their first rows with their commands and loads, without feedback of the recording. Where the
log has gains, the PD's gains scale with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.latent import LatentActuator
from motorprior.identification.baselines.pd_fit import tuned_pd
from motorprior.identification.baselines.replay_error import scaled_gains
from motorprior.identification.evaluation.reference import at_log_conditions, replay_errors
from motorprior.identification.training_data.windows import seconds_since_cold
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rms


def fit_quality(
    motors: Actuator,
    log: MotorLog,
    report: Callable[[int], None] = lambda count: None,
    nominal: Mapping[str, float] = MappingProxyType({}),
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) root mean square errors [rad] of a log's motors, and of one PD tuned to it, in replays of the log.

    Args:
        motors: one per joint of the log.
        log: with known loads.
        report: called after every evaluation of the tuning.
        nominal: conditions of the motors' recipe.
    """
    work, segment = seconds_since_cold(log), np.zeros(len(log.time)) if log.segment is None else log.segment

    def at_segment(motors: Actuator, part: MotorLog) -> Actuator:
        # as in the fit: the temperature rise of the middle of the segment
        motors = at_log_conditions(motors, part, nominal)
        if not isinstance(motors, LatentActuator):
            return motors
        here = segment == (0 if part.segment is None else part.segment[0])
        warmth = motors.network.warmth(motors.z, float(np.median(work[here])))
        return replace(motors, conditions=motors.conditions._replace(warmth=warmth))

    at_gains = scaled_gains(log)
    pd = tuned_pd(log, report, at_gains)
    errors, baseline = replay_errors(motors, log, at_segment)[0], replay_errors(pd, log, at_gains)[0]
    return rms(errors, axis=0), rms(baseline, axis=0)
