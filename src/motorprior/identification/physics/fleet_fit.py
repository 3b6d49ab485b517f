"""Fit of a fleet: every motor by itself, or together, with a Gaussian prior over the motors.

Decoder outputs are the logarithms of the constants (linear where they may be negative), relative to a central motor;
one latent is one output. Alone, motors are fitted by a random search, Gauss-Newton steps and restarts. Together,
restarts also start at other motors' constants, and a Gaussian over the motors is estimated in turns (empirical Bayes):

    m = median over M motors,   v = (M + 1)/(M - 1)·mean of (z - m)² + mean of diag S;   precision = T / (N·v)
    S = T/N·(G + diag(precision))⁻¹ of every motor,   T the mean loss, G the Gauss-Newton matrix

v is the variance of one more motor: that between the motors, plus the uncertainty of each (the first turn has no S). A
window, of N, fitted as well as the average one counts as one observation. One motor is fitted alone.

Long free runs identify constants that short ones confuse, but a search on them ends in poor optima. So the search uses
short runs, and `refined` takes the last steps on longer ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.initial_motor import logs_kd, sized_center, with_motor
from motorprior.identification.physics.motor_fit import NARROW, WIDE, Fit, GaussianPrior, MotorFit
from motorprior.identification.physics.window_runs import HIDDEN_FROM_ROTOR, SPEED_LIMITS, WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData
from motorprior.logs.motor_log import PHYSICAL_GAINS

SEARCH_RADII, SEARCH_DRAWS = (0.7, 0.35, 0.2), 48
RESTARTS, RESTART_DRAWS = 3, 96
FIRST_STEPS, RESTART_STEPS = 10, 8
TURNS = (*[(WIDE, 5)] * 6, *[(NARROW, 5)] * 10)  # of empirical Bayes: step of the differences, and Gauss-Newton steps
STAGES = 1 + RESTARTS + len(TURNS)  # number of reports of a fit
_WEAK = 1e-4  # precision of the prior around the initial motor, per unit of the loss
# value of an unidentifiable limit over the largest request or speed; loss ratio of equal fits
UNIDENTIFIED_FACTOR, SAME_LOSS = 4.0, 1.001
_MIN_STD = 0.05  # minimum standard deviation over motors of the logarithm of a constant
LONGER_WINDOW, MIN_LONGER_WINDOWS, MAX_LOST = 200, 10, 0.2  # of `longer_runs`: window [steps], windows, share of rows
# refinement: wide differences average over ripples, narrow ones find the minimum
REFINEMENT = ((WIDE, 10), (NARROW, 10), (0.01, 10))
_STREAM = 41


@dataclass(frozen=True)
class FleetFit:
    """A central motor's decoder outputs (P,), and those of M motors relative to it (M, P); their losses (M,)."""

    center: np.ndarray
    offsets: np.ndarray
    loss: np.ndarray
    terms: tuple[str, ...]


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
        network: its residual does not change.
        runs: the logs.
        terms: optional terms of the motors (`optional_terms`).
        together: estimate a Gaussian over the motors.
        seed: of the searches.
        start: (M, P) initial decoder outputs; found by a random search if not given.
        chosen: (N,) mask of the windows that count; all if not given.
        turns: of the empirical Bayes.
        report: called 1 + RESTARTS + len(turns) times.
    """
    rng, together = np.random.default_rng([seed, _STREAM]), together and runs.num_motors > 1
    fixed = fixed_constants(terms, runs)

    def fit_around(center: np.ndarray) -> MotorFit:
        return MotorFit(with_motor(network, center, terms), runs, chosen, lower_bounds(center, terms, runs))

    center = sized_center(network, runs, terms, chosen) if start is None else np.median(start, axis=0)
    fit, prior, initial = fit_around(center), weak_prior(len(center)).fixing(fixed), center
    if start is None:
        first = fit.search(rng, np.zeros((runs.num_motors, len(center))), prior, SEARCH_RADII, SEARCH_DRAWS)
    else:
        first = np.clip(start - center, -LOG_REACH, LOG_REACH)
    found = fit.polish(first, prior, FIRST_STEPS)
    report()
    for _ in range(RESTARTS):
        other = restart(rng, fit, found, prior, together)
        found = found.better(fit.polish(other, prior, RESTART_STEPS))
        report()
    for turn, (diff_step, steps) in enumerate(turns):
        # recentre, so that the decoder reaches constants beyond its range around the initial motor
        z = np.clip(found.z, -LOG_REACH, LOG_REACH)  # as the decoder clips them
        middle = np.where(fixed, 0.0, np.median(z, axis=0))
        center, z = center + middle, np.clip(z - middle, -LOG_REACH, LOG_REACH)
        fit = fit_around(center)
        loss = fit.losses(z)
        found = Fit(z, loss, loss)
        if together:
            prior = fleet_prior(found, fit.windows, posterior_variance(fit, found, prior) if turn else 0.0)
        else:
            prior = replace(prior, mean=initial - center)
        prior = prior.fixing(fixed)
        found = replace(found, energy=found.loss + prior.energy(found.z))
        again = fit.polish(found.z, prior, steps, diff_step)
        other = restart(rng, fit, again, prior, together)
        found = again.better(fit.polish(other, prior, steps, diff_step))
        report()
    z = np.where(fixed, 0.0, np.clip(found.z, -LOG_REACH, LOG_REACH))  # as the decoder clips them
    z = _without_unidentified_limits(fit, z, fixed, together)
    # around a centre from which the decoder reaches every motor
    middle = np.clip(np.median(z, axis=0), z.max(axis=0) - LOG_REACH, z.min(axis=0) + LOG_REACH)
    center, z = center + middle, z - middle
    return FleetFit(center, z, MotorFit(with_motor(network, center, terms), runs, chosen).losses(z), terms)


def lower_bounds(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(M, P) lower bounds of searches around a central motor (P,): limits of speed are above the logged speeds.

    A limit far below the motor's own keeps a search in a poor optimum. An impact can drive a joint faster than its
    motor for 0.1 s, so Gauss-Newton steps may go below the bound. -inf for other and for fixed constants.
    """
    lower = np.full((len(runs.sustained_speeds[SPEED_LIMITS[0]]), len(center)), -np.inf)
    for row, name in enumerate(parameters_of(terms)):
        if name in SPEED_LIMITS:
            with np.errstate(divide="ignore"):
                lower[:, row] = np.minimum(np.log(1.02 * runs.sustained_speeds[name]) - center[row], LOG_REACH)
    lower[:, fixed_constants(terms, runs)] = -np.inf
    return lower


def _without_unidentified_limits(fit: MotorFit, z: np.ndarray, fixed: np.ndarray, together: bool) -> np.ndarray:
    """(M, Z) latents whose unidentified limits are UNIDENTIFIED_FACTOR times the largest request or speed.

    With lower limits the motor could saturate in other motions. Motors that are fitted together keep a limit if half of
    them identify it.
    """
    motor = fit.network.motor
    assert motor is not None
    center, names = motor.center, parameters_of(motor.terms)
    kp = names.index("kp")
    asked = np.exp(center[kp] + z[:, kp]) * fit.runs.max_request
    reached = {"torque_limit": asked} | dict.fromkeys(SPEED_LIMITS, np.full(len(z), fit.runs.max_speed))
    losses = fit.losses(z)
    for name, largest in reached.items():
        if name not in names or not largest.max() or fixed[names.index(name)]:
            continue
        row, free = names.index(name), z.copy()
        farthest = z[:, row].min() + 2.0 * LOG_REACH  # the decoder reaches both from a centre between them
        free[:, row] = np.clip(np.log(UNIDENTIFIED_FACTOR * largest.max()) - center[row], z[:, row], farthest)
        unidentified = fit.losses(free) <= SAME_LOSS * losses
        if unidentified.mean() > 0.5 or not together:
            z = np.where(unidentified[:, None], free, z)
    return z


def fixed_constants(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(P,) constants that are not fitted: absent or logged ones, and those that the encoders do not identify."""
    fixed = (*runs.preset.lacks, *runs.preset.logged_values, *(HIDDEN_FROM_ROTOR if runs.at_rotor else ()))
    if runs.gain_unit == PHYSICAL_GAINS:
        fixed += ("kp", "kd_over_kp") if logs_kd(runs) else ("kp",)
    return np.array([name in fixed for name in parameters_of(terms)])


def weak_prior(size: int) -> GaussianPrior:
    """Prior that keeps unidentifiable constants at their start."""
    return GaussianPrior(np.zeros(size), np.full(size, _WEAK))


def posterior_variance(fit: MotorFit, found: Fit, prior: GaussianPrior) -> np.ndarray:
    """(Z,) posterior variance of a motor's z, mean over the motors."""
    precision = (fit.curvatures(found.z) + np.diag(prior.precision)) * fit.windows / found.loss.mean()
    return np.einsum("mzz->mz", np.linalg.inv(precision)).mean(axis=0)


def fleet_prior(found: Fit, windows: int, variance: np.ndarray | float) -> GaussianPrior:
    """Gaussian of one more motor; ``variance`` (Z,) is that of `posterior_variance`."""
    mean = np.median(found.z, axis=0)
    motors = len(found.z)
    spread = (motors + 1) / (motors - 1) * np.mean((found.z - mean) ** 2, axis=0)
    variance = np.maximum(spread + variance, _MIN_STD**2)
    return GaussianPrior(mean, found.loss.mean() / windows / variance)


def restart(rng: np.random.Generator, fit: MotorFit, found: Fit, prior: GaussianPrior, together: bool) -> np.ndarray:
    """(M, Z) best of RESTART_DRAWS other starts for each motor.

    A random half of the constants is resampled: together, around the median of the better motors; alone, around the
    motor's own. Together, other motors' fits are starts, too.
    """
    motors, size = found.z.shape
    if together:
        good = found.z[found.loss <= np.quantile(found.loss, 0.6)]
        middle = np.broadcast_to(np.median(good, axis=0), found.z.shape)
        std = np.maximum(1.4826 * np.median(np.abs(good - middle[0]), axis=0), _MIN_STD)
    else:
        middle, std = found.z, np.full(size, SEARCH_RADII[1])
    samples = middle[:, None] + std * rng.standard_normal((motors, RESTART_DRAWS, size))
    candidates = np.where(rng.random(samples.shape) < 0.5, found.z[:, None], samples)
    if together and motors > 1:
        for motor in range(motors):
            others = rng.permutation(np.delete(np.arange(motors), motor))[: RESTART_DRAWS // 2]
            candidates[motor, : len(others)] = found.z[others]
    return fit.best_of(np.clip(candidates, -LOG_REACH, LOG_REACH), prior)


def longer_runs(data: TrainingData, preset: Preset, runs: WindowRuns) -> WindowRuns:
    """Free runs of about LONGER_WINDOW steps, or ``runs``, those of the recipe, if they are as long.

    Returns ``runs``, too, if longer windows lose more than MAX_LOST of the rows or are fewer than MIN_LONGER_WINDOWS.
    """
    lengths = np.array([part.stop - part.start - 1 - preset.history for part in data.parts])
    length = int(np.median(lengths[lengths >= preset.window]))
    window = length // max(1, round(length / LONGER_WINDOW))
    if window <= preset.window:
        return runs
    longer = WindowRuns(data, replace(preset, window=window), heartbeat=runs.heartbeat)
    enough = longer.windows * window >= (1.0 - MAX_LOST) * runs.windows * preset.window
    return longer if enough and longer.windows >= MIN_LONGER_WINDOWS else runs


def refined(
    network: LatentNetwork, z: np.ndarray, runs: WindowRuns, together: bool, chosen: np.ndarray | None = None
) -> np.ndarray:
    """(M, Z) latents after Gauss-Newton steps from ``z`` on ``runs``, longer than those of the fit (`motor_fit`).

    The prior is the fleet's if ``together``, estimated at z; otherwise it is weak, around z.
    """
    motor = network.motor
    assert motor is not None
    fit = MotorFit(network, runs, chosen)
    fixed = fixed_constants(motor.terms, runs)
    prior = replace(weak_prior(z.shape[1]), mean=z).fixing(fixed)
    if together and len(z) > 1:
        loss = fit.losses(z)
        found = Fit(z, loss, loss)
        first = fleet_prior(found, fit.windows, 0.0).fixing(fixed)
        prior = fleet_prior(found, fit.windows, posterior_variance(fit, found, first)).fixing(fixed)
    prior, refined_z = replace(prior, mean=np.where(fixed, z, prior.mean)), z
    for diff_step, steps in REFINEMENT:
        refined_z = fit.polish(refined_z, prior, steps, diff_step).z
    return np.where(fixed, z, np.clip(refined_z, -LOG_REACH, LOG_REACH))
