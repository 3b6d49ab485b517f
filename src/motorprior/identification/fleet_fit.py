"""Fit of a fleet: every motor by itself, or together, where all motors' fits are a belief about each.

Decoder outputs are the logarithms of the constants (linear where they may be negative), around a central motor; one
latent is one output. Alone, motors are fitted by a random search, Gauss-Newton steps and restarts. Together, restarts
also begin at what other motors have, and a Gaussian over the motors is estimated with them by turns (empirical Bayes):

    m = median over motors, v = variance over motors;   precision = T / (N·v),   T the mean loss

so that a window, of N, fitted as well as the average one counts as an observation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_step import LOG_REACH, PARAMETERS, parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.servo_terms import INITIAL, SIGNED
from motorprior.identification.motor_fit import NARROW, WIDE, Belief, Fit, MotorFit
from motorprior.identification.window_runs import HIDDEN_FROM_ROTOR, WindowRuns
from motorprior.logs.motor_log import PHYSICAL_GAINS

INITIAL_MOTOR = {
    "kp": 10.0, "kd_over_kp": 0.09, "velocity_filter": 0.003, "delay": 0.008, "torque_limit": 1.5, "armature": 0.002,
    "coulomb": 0.06, "stribeck_torque": 0.01, "viscous_damping": 0.004, "load_friction": 0.2, "gear_stiffness": 70.0,
    "backlash": 0.015, "gear_damping": 0.03, **INITIAL,
}  # fmt: skip
"""Constants at which a fit begins, in SI units: a small geared servo."""
_TORQUES = (
    "torque_limit",
    "armature",
    "coulomb",
    "stribeck_torque",
    "viscous_damping",
    "gear_stiffness",
    "gear_damping",
)
"""Constants that scale with the size of a motor."""
SEARCH_RADII, SEARCH_DRAWS = (0.7, 0.35, 0.2), 48
RESTARTS, RESTART_DRAWS = 3, 96
TURNS = (*[(WIDE, 5)] * 6, *[(NARROW, 5)] * 10)
"""Of the empirical Bayes: reach of the differences, and Gauss-Newton steps."""
FIRST_STEPS, RESTART_STEPS = 10, 8
STAGES = 1 + RESTARTS + len(TURNS)
"""How often a fit reports."""
_WEAK = 1e-4
"""Precision of the belief in the initial motor, per unit of the loss."""
ROOM, UNSEEN = 4.0, 1.001
"""Torque limit that no log shows over the largest torque that the law asked for [-]; a loss that shows it, over that
without."""
_LEAST_SPREAD = 0.05
"""Standard deviation of a constant's logarithm over motors that is not undercut."""
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


def initial_center(terms: tuple[str, ...], runs: WindowRuns | None = None) -> np.ndarray:
    """(P,) decoder outputs of the initial motor; its limits of speed and stated gains are those of the logs, if given.

    Where gains are stated in N·m/rad, every torque of the initial motor is that of a motor with such gains.
    """
    motor = INITIAL_MOTOR
    if runs is not None and runs.fastest:
        motor = motor | {"profile_speed": runs.fastest, "no_load_speed": 1.3 * runs.fastest}
    if runs is None or not runs.gain_unit:
        return encoded(motor, terms)
    kp, ratio = float(np.median(runs.gains[0])), float(np.median(runs.gains[1] / runs.gains[0])) or 1.0
    if runs.gain_unit == PHYSICAL_GAINS:
        factor = kp / INITIAL_MOTOR["kp"]
        motor = motor | {name: factor * motor[name] for name in _TORQUES}
        needed = float(np.median(runs.largest_request))
        limit = float(np.sqrt(motor["torque_limit"] * max(motor["torque_limit"], 2.0 * needed)))  # it may saturate
        motor = motor | {"kp": 1.0, "torque_limit": limit} | ({"kd_over_kp": 1.0} if _states_kd(runs) else {})
    else:
        motor = motor | {"kp": motor["kp"] / kp, "kd_over_kp": motor["kd_over_kp"] / ratio}
    return encoded(motor, terms)


def encoded(values: Mapping[str, float], terms: tuple[str, ...]) -> np.ndarray:
    """(P,) decoder outputs of a motor with these constants; outputs of constants that are not given are 0."""
    return np.array([
        values.get(name, 0.0) / SIGNED[name] if name in SIGNED else np.log(values.get(name, 1.0))
        for name in parameters_of(terms)
    ])  # fmt: skip


def with_motor(network: LatentNetwork, center: np.ndarray, terms: tuple[str, ...]) -> LatentNetwork:
    """A network with this central motor, and one latent per constant; its own weights ignore the latents."""
    size = len(center)
    motor = GearedMotor(center, np.eye(size), terms)
    return replace(
        network, motor=motor, v1=np.zeros((size, network.num_neurons)), armature_slope=np.zeros(size), copula=None
    )


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
    rng = np.random.default_rng([seed, _STREAM])
    center = initial_center(terms, runs) if start is None else np.median(start, axis=0)
    fit, held = MotorFit(with_motor(network, center, terms), runs, chosen), _held(terms, runs)
    belief = weak_belief(len(center)).holding(held)
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
    for reach, steps in turns:
        if together:
            belief = _belief(found, fit.windows).holding(held)
        found = replace(found, energy=found.loss + belief.energy(found.z))
        again = fit.polish(found.z, belief, steps, reach)
        other = restart(rng, fit, again, belief, together)
        found = again.better(fit.polish(other, belief, steps, reach))
        report()
    z = np.where(held, 0.0, np.clip(found.z, -LOG_REACH, LOG_REACH))  # as the decoder has them
    z = _unlimited(fit, runs, center, z)
    # around a centre from which the decoder reaches every motor
    middle = np.clip(np.median(z, axis=0), z.max(axis=0) - LOG_REACH, z.min(axis=0) + LOG_REACH)
    return FleetFit(center + middle, z - middle, fit.losses(z), terms)


def _states_kd(runs: WindowRuns) -> bool:
    """Whether the logs state kd: where they do not, it is written as kp (`windows`)."""
    return bool(np.any(runs.gains[1] != runs.gains[0]))


def _unlimited(fit: MotorFit, runs: WindowRuns, center: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Latents whose torque limits are ROOM times what the logs ask for, if no motor of theirs reaches its limit.

    A log that does not show a limit would leave it where the search began, and the motors then saturate in others.
    """
    kp, limit = (PARAMETERS.index(name) for name in ("kp", "torque_limit"))
    asked = np.exp(center[kp] + z[:, kp]) * runs.largest_request
    free = z.copy()
    free[:, limit] = np.maximum(z[:, limit], np.log(ROOM * asked.max()) - center[limit])
    if np.any(free[:, limit] > LOG_REACH) or np.any(fit.losses(free) > UNSEEN * fit.losses(z)):
        return z
    return free


def _held(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(P,) constants that are not fitted: stated ones, and those that the log's encoders hide (`window_runs`)."""
    held = HIDDEN_FROM_ROTOR if runs.at_rotor else ()
    if runs.gain_unit == PHYSICAL_GAINS:
        held += ("kp", "kd_over_kp") if _states_kd(runs) else ("kp",)
    return np.array([name in held for name in parameters_of(terms)])


def weak_belief(size: int) -> Belief:
    """Next to nothing: what keeps constants that a log does not show where they began."""
    return Belief(np.zeros(size), np.full(size, _WEAK))


def _belief(found: Fit, windows: int) -> Belief:
    """What the motors say about one more."""
    mean = np.median(found.z, axis=0)
    variance = np.maximum(np.mean((found.z - mean) ** 2, axis=0), _LEAST_SPREAD**2)
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
