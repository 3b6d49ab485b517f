"""Fit of a fleet: every motor by itself, or together, where all motors' fits are a belief about each.

Decoder outputs are the logarithms of the constants (linear where they may be negative), around a central motor; one
latent is one output. Alone, motors are fitted by a random search, Gauss-Newton steps and restarts. Together, restarts
also begin at what other motors have, and a Gaussian over the motors is estimated with them by turns (empirical Bayes):

    m = median over M motors,   v = (M + 1)/(M - 1)·mean of (z - m)² + mean of diag S;   precision = T / (N·v)
    S = T/N·(G + diag(precision))⁻¹ of every motor,   T the mean loss, G the Gauss-Newton matrix

v is the variance of a further motor, as M motors tell it: how far apart they were found, and what their logs leave open
of each (the expectation-maximisation of a Gaussian over motors; the first turn, before anything is believed, has no S).
A window, of N, fitted as well as the average one counts as an observation. One motor is fitted alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.initial_motor import sized_center, states_kd, with_motor
from motorprior.identification.physics.motor_fit import NARROW, WIDE, Belief, Fit, MotorFit
from motorprior.identification.physics.speed_limits import SPEED_LIMITS, least_outputs
from motorprior.identification.physics.window_runs import HIDDEN_FROM_ROTOR, WindowRuns
from motorprior.logs.motor_log import PHYSICAL_GAINS

SEARCH_RADII, SEARCH_DRAWS = (0.7, 0.35, 0.2), 48
RESTARTS, RESTART_DRAWS = 3, 96
# Of the empirical Bayes: reach of the differences, and Gauss-Newton steps
TURNS = (*[(WIDE, 5)] * 6, *[(NARROW, 5)] * 10)
FIRST_STEPS, RESTART_STEPS = 10, 8
STAGES = 1 + RESTARTS + len(TURNS)  # How often a fit reports
_WEAK = 1e-4  # Precision of the belief in the initial motor, per unit of the loss
# A limit that no log shows over the most that was asked for or reached [-]; a loss that shows it, over the other
ROOM, UNSEEN = 4.0, 1.001
_LEAST_SPREAD = 0.05  # Standard deviation of a constant's logarithm over motors that is not undercut
_STREAM = 41


@dataclass(frozen=True)
class FleetFit:
    """A central motor's decoder outputs (P,), and those of M motors relative to it (M, P); their losses (M,)."""

    center: np.ndarray
    offsets: np.ndarray
    loss: np.ndarray
    terms: tuple[str, ...]

    @property
    def raw(self) -> np.ndarray:
        """(M, P) decoder outputs of the motors."""
        return self.center + self.offsets

    def network(self, like: LatentNetwork) -> LatentNetwork:
        """``like`` with these motors' decoder."""
        return with_motor(like, self.center, self.terms)


def fit_fleet(
    network: LatentNetwork,
    runs: WindowRuns,
    terms: tuple[str, ...],
    together: bool,
    seed: int,
    start: np.ndarray | None = None,
    chosen: np.ndarray | None = None,
    turns: tuple[tuple[float, int], ...] = TURNS,
    report: Callable[[], None] = lambda: None,
) -> FleetFit:
    """Fit all motors of the logs.

    Args:
        network: with a residual that stays as it is.
        runs: the logs.
        terms: of the motors (`servo_terms`).
        together: whether the motors help each other.
        seed: of the searches.
        start: (M, P) decoder outputs at which the fit begins; found by a random search if not given.
        chosen: (N,) mask of the windows that count; all if not given.
        turns: of the empirical Bayes.
        report: called 1 + RESTARTS + len(turns) times.
    """
    rng, together = np.random.default_rng([seed, _STREAM]), together and runs.num_motors > 1
    center = sized_center(network, runs, terms, chosen) if start is None else np.median(start, axis=0)
    fit, held = _bounded_fit(network, center, terms, runs, chosen), held_constants(terms, runs)
    belief, began = weak_belief(len(center)).holding(held), center
    if start is None:
        nowhere = np.zeros((runs.num_motors, len(center)))
        first = fit.search(rng, nowhere, belief, SEARCH_RADII, SEARCH_DRAWS)
    else:
        first = np.clip(start - center, -LOG_REACH, LOG_REACH)
    found = fit.polish(first, belief, FIRST_STEPS)
    report()
    for _ in range(RESTARTS):
        other = restart(rng, fit, found, belief, together)
        found = found.better(fit.polish(other, belief, RESTART_STEPS))
        report()
    for turn, (reach, steps) in enumerate(turns):
        fit, found = _recentred(fit, found, held)
        if together:
            belief = fleet_belief(found, fit.windows, left_open(fit, found, belief) if turn else 0.0)
        else:
            belief = replace(belief, mean=began - _center(fit))
        belief = belief.holding(held)
        found = replace(found, energy=found.loss + belief.energy(found.z))
        again = fit.polish(found.z, belief, steps, reach)
        other = restart(rng, fit, again, belief, together)
        found = again.better(fit.polish(other, belief, steps, reach))
        report()
    z = np.where(held, 0.0, np.clip(found.z, -LOG_REACH, LOG_REACH))  # as the decoder has them
    z = _unlimited(fit, z, together)
    center = _center(fit)
    # around a centre from which the decoder reaches every motor
    middle = np.clip(np.median(z, axis=0), z.max(axis=0) - LOG_REACH, z.min(axis=0) + LOG_REACH)
    center, z = center + middle, z - middle
    return FleetFit(center, z, MotorFit(with_motor(network, center, terms), runs, chosen).losses(z), terms)


def _center(fit: MotorFit) -> np.ndarray:
    """(P,) decoder outputs of the central motor of a fit."""
    assert fit.network.motor is not None
    return fit.network.motor.center


def _recentred(fit: MotorFit, found: Fit, held: np.ndarray) -> tuple[MotorFit, Fit]:
    """The same motors around their median, from which a decoder reaches what it did not from the initial motor."""
    assert fit.network.motor is not None
    z = np.clip(found.z, -LOG_REACH, LOG_REACH)  # as the decoder has them
    middle = np.where(held, 0.0, np.median(z, axis=0))
    center, left = _center(fit) + middle, np.clip(z - middle, -LOG_REACH, LOG_REACH)
    moved = _bounded_fit(fit.network, center, fit.network.motor.terms, fit.runs, fit.mask)
    loss = moved.losses(left)
    return moved, Fit(left, loss, loss)


def _bounded_fit(
    network: LatentNetwork,
    center: np.ndarray,
    terms: tuple[str, ...],
    runs: WindowRuns,
    chosen: np.ndarray | None = None,
) -> MotorFit:
    """A fit around this central motor whose searches give no motor a limit below the speed that it held."""
    return MotorFit(with_motor(network, center, terms), runs, chosen, least_latents(center, terms, runs))


def least_latents(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(M, P) bounds of searches around a central motor (P,), by `speed_limits`; -inf of what is held or not bounded."""
    least = least_outputs(center, terms, runs.held_speeds)
    least[:, held_constants(terms, runs)] = -np.inf
    return least


def _unlimited(fit: MotorFit, z: np.ndarray, together: bool) -> np.ndarray:
    """(M, Z) latents with limits that are ROOM times what the logs reach, in those motors that do not show their own.

    A limit that a log does not show would stay where the search went, and the motor then saturate in others. Of motors
    that are fitted together those that show theirs tell of the others, if they are half of them or more.
    """
    assert fit.network.motor is not None
    center, names = _center(fit), parameters_of(fit.network.motor.terms)
    kp = names.index("kp")
    asked = np.exp(center[kp] + z[:, kp]) * fit.runs.largest_request
    reached = {"torque_limit": asked} | dict.fromkeys(SPEED_LIMITS, np.full(len(z), fit.runs.fastest))
    losses, held = fit.losses(z), held_constants(fit.network.motor.terms, fit.runs)
    for name, most in reached.items():
        if name not in names or not most.max() or held[names.index(name)]:
            continue
        row, free = names.index(name), z.copy()
        farthest = z[:, row].min() + 2.0 * LOG_REACH  # from another centre the decoder reaches both
        free[:, row] = np.clip(np.log(ROOM * most.max()) - center[row], z[:, row], farthest)
        unseen = fit.losses(free) <= UNSEEN * losses
        if unseen.mean() > 0.5 or not together:
            z = np.where(unseen[:, None], free, z)
    return z


def held_constants(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(P,) constants that are not fitted: absent and stated ones, and those that the log's encoders hide."""
    held = (*runs.preset.lacks, *runs.preset.stated_constants, *(HIDDEN_FROM_ROTOR if runs.at_rotor else ()))
    if runs.gain_unit == PHYSICAL_GAINS:
        held += ("kp", "kd_over_kp") if states_kd(runs) else ("kp",)
    return np.array([name in held for name in parameters_of(terms)])


def weak_belief(size: int) -> Belief:
    """Next to nothing: what keeps constants that a log does not show where they began."""
    return Belief(np.zeros(size), np.full(size, _WEAK))


def left_open(fit: MotorFit, found: Fit, belief: Belief) -> np.ndarray:
    """(Z,) variance of a motor's z that its own log leaves open, mean over the motors."""
    precision = (fit.curvatures(found.z) + np.diag(belief.precision)) * fit.windows / found.loss.mean()
    return np.einsum("mzz->mz", np.linalg.inv(precision)).mean(axis=0)


def fleet_belief(found: Fit, windows: int, open_variance: np.ndarray | float) -> Belief:
    """What the motors say about one more; ``open_variance`` (Z,) is what `left_open` tells."""
    mean = np.median(found.z, axis=0)
    motors = len(found.z)
    spread = (motors + 1) / (motors - 1) * np.mean((found.z - mean) ** 2, axis=0)
    variance = np.maximum(spread + open_variance, _LEAST_SPREAD**2)
    return Belief(mean, found.loss.mean() / windows / variance)


def restart(rng: np.random.Generator, fit: MotorFit, found: Fit, belief: Belief, together: bool) -> np.ndarray:
    """(M, Z) of each motor the best of RESTART_DRAWS other beginnings.

    In half of them a random half of the constants is drawn anew: together, around the better motors' median with their
    spread; alone, around the motor's own. Together, other motors' fits are beginnings, too.
    """
    motors, size = found.z.shape
    if together:
        good = found.z[found.loss <= np.quantile(found.loss, 0.6)]
        middle = np.broadcast_to(np.median(good, axis=0), found.z.shape)
        spread = np.maximum(1.4826 * np.median(np.abs(good - middle[0]), axis=0), _LEAST_SPREAD)
    else:
        middle, spread = found.z, np.full(size, SEARCH_RADII[1])
    anew = middle[:, None] + spread * rng.standard_normal((motors, RESTART_DRAWS, size))
    candidates = np.where(rng.random(anew.shape) < 0.5, found.z[:, None], anew)
    if together and motors > 1:
        for motor in range(motors):
            others = rng.permutation(np.delete(np.arange(motors), motor))[: RESTART_DRAWS // 2]
            candidates[motor, : len(others)] = found.z[others]
    return fit.best_of(np.clip(candidates, -LOG_REACH, LOG_REACH), belief)
