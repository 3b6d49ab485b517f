"""Descents and candidates that all searches for motors share."""

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR
from motorprior.identification.search import NARROW, WIDE, Fit

# candidates of each restart
CANDIDATES = 256
# descent of the simplest motors
RIGID_STEPS = ((10, WIDE), (6, NARROW))
# other descents: the widest differences cross ripples of the loss, which impacts cause
STEPS = ((8, 0.5), (8, 0.2), (8, WIDE), (6, NARROW))
# step of the differences of the last descent
FINEST = 0.01


def reachable(candidates: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """(M, ..., K) candidates within the reach of a decoder, with 0 for ``fixed`` (K,) unknowns."""
    return np.clip(np.where(fixed, 0.0, candidates), -MAX_LOG_FACTOR, MAX_LOG_FACTOR)


def half_resampled(rng: np.random.Generator, samples: np.ndarray, best: Fit) -> np.ndarray:
    """(M, C, K) ``samples``, in which a random half of the unknowns is from the best fit."""
    return np.where(rng.random(samples.shape) < 0.5, samples, best.x[:, None])


def add_other_motors(rng: np.random.Generator, candidates: np.ndarray, x: np.ndarray) -> None:
    """Replace up to a quarter of a motor's candidates (M, C, K) by other motors' x (M, K)."""
    motors = len(x)
    quarter = candidates.shape[1] // 4
    for motor in range(motors):
        shuffled = rng.permutation(np.delete(np.arange(motors), motor))[:quarter]
        candidates[motor, : len(shuffled)] = x[shuffled]
