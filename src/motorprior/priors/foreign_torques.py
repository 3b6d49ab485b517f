"""Torques of contact and other foreign bodies in the log that a prior is adapted to.

A motor that pushes against a table looks like a motor with other constants. It differs from one in
two respects, which `foreign_torques` tests together:

    misfit    No motor of the prior's fleet explains the log. The energy of the posterior's mode,

                  (N·loss(z)/T + |z - m|²/d²) / (N + Z),

              is about 1 for a motor of the fleet (`latents.latent_fit` has the symbols).
    one side  In windows of at most WINDOW seconds, which begin in the recorded state, the prior's
              own motor leaves the recording by far more than its residuals, to the same side.
"""

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior, Prediction
from motorprior.evaluation.training_errors import half_bands, speed_pool
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import POSITION_SCALE, WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import POS, SECONDS, VEL, TrainingData
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import moved

WINDOW = 0.25  # [s]
MAX_ENERGY = 2.5  # of a motor of the fleet [-]
# mean error of a window, over half of the 90 % band of the prior's residuals at its speed
MIN_ERROR = 3.0
MIN_WINDOWS = 2
MIN_ONE_SIDED = 0.9  # absolute sum of the large errors over the sum of their absolute values


@dataclass(frozen=True)
class ForeignTorque:
    """A torque on a joint that no motor of the prior's fleet explains."""

    index: int  # joint of the log
    seconds: float  # total duration of its windows
    # begin of the first window and end of the last, since the log began [s]; none in a log of
    # several segments, whose clocks may differ
    times: tuple[float, float] | None
    angles: tuple[float, float]  # range of the angle in its windows [rad]

    def text(self, joint: str) -> str:
        """The finding and its consequence, for the user."""
        low, high = self.angles
        when = ""
        if self.times is not None:
            first, last = self.times
            when = f", {first:.3g} to {last:.3g} s after the start of its recording,"
        return (
            f"{joint}: for {self.seconds:.3g} s{when} at {low:.2f} to {high:.2f} rad, a torque "
            "acts that no motor of the prior explains (contact, another load); the joint keeps "
            "the prior -> adapt to motions without it"
        )


def foreign_torques(
    prior: MotorPrior,
    log: MotorLog,
    data: TrainingData,
    recipe: Recipe,
    posterior: LatentPosterior,
    predicted: Prediction,
    temperature: float,
) -> tuple[ForeignTorque, ...]:
    """The foreign torques in a log of M motors, to which a prior was adapted.

    A static joint has none: nothing is known about the torque that holds it.

    Args:
        prior: of grey boxes.
        log: of the motors.
        data: of the log, or of a part of it.
        recipe: of the adaptation.
        posterior: of the motors.
        predicted: the prior's prediction of the motors, from which they were adapted.
        temperature: T, see `latent_fit.fit_posterior`.
    """
    assert isinstance(prior.model, GreyBox)
    deviation = (posterior.mean - predicted.mean) / predicted.std  # (M, Z)
    energy = posterior.windows * posterior.loss / temperature + np.sum(deviation**2, axis=1)
    energy /= posterior.windows + deviation.shape[1]
    unexplained = np.flatnonzero((energy > MAX_ENERGY) & moved(log))
    if not len(unexplained):
        return ()

    window = min(recipe.window, round(WINDOW / recipe.period))
    runs = WindowRuns(data, replace(recipe, window=window))
    motors = prior.model.motors(predicted.mean)
    errors = POSITION_SCALE * runs.errors(motors)[:, :, 0].mean(axis=2)  # (M, N) [rad]
    speed = np.abs(runs.recorded(VEL)).mean(axis=2)
    is_large = np.abs(errors) > MIN_ERROR * half_bands(prior.metrics.residuals)[speed_pool(speed)]
    seconds = runs.recorded(SECONDS)
    angles = runs.recorded(POS)
    has_one_clock = len(log.segment_slices()) == 1

    torques = []
    for motor in unexplained.tolist():
        large = errors[motor, is_large[motor]]
        if len(large) < MIN_WINDOWS or abs(large.sum()) < MIN_ONE_SIDED * np.abs(large).sum():
            continue
        times = seconds[motor, is_large[motor]]
        where = angles[motor, is_large[motor]]
        torques.append(
            ForeignTorque(
                motor,
                len(large) * window * recipe.period,
                (float(times.min()), float(times.max())) if has_one_clock else None,
                (float(where.min()), float(where.max())),
            )
        )
    return tuple(torques)
