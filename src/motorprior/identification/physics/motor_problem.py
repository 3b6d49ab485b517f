"""The least-squares problems of M motors, each on its own log.

The unknowns are decoder outputs, one per constant, relative to a central motor.

A decoder reaches constants within a factor of 148 of its central motor, but kp of servos and
quadrupeds spans 1 to 40 N·m/rad. Gains that are logged in N·m/rad set the scale of the initial
motor. Without them, several scales of all torques, and of the gain alone, are tried on the logs,
and the fit starts from the best if its loss is less than half the initial motor's.

Shapes: P outputs of a decoder, of which K = P are unknown; M motors; terms are names of optional
dynamics terms.
"""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.actuator.geared_motor_step import LOG_REACH, MAX_DELAY, PARAMETERS, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import CONSTANTS, INITIAL, NEGLIGIBLE, SIGNED
from motorprior.identification.physics.window_runs import (
    HIDDEN_FROM_ROTOR,
    SPEED_LIMITS,
    WindowRuns,
    grey_boxes,
)
from motorprior.identification.presets import GEAR, Recipe
from motorprior.identification.search import GaussianPrior, Search
from motorprior.logs.motor_log import PHYSICAL_GAINS

# precision, per unit of the loss, of the prior that keeps unidentifiable constants at its mean
WEAK = 1e-4
# standard deviation of log(time constant) of velocity filters around the initial motor's: real ones
# are short
FILTER_STD = 1.0
# a limit so many times the largest request or speed in the log has no effect
OFF = 4.0
# factors on constants of the initial motor with which it is a rigid gear with Coulomb and viscous
# friction
RIGID = {
    "velocity_filter": 0.1,
    "stribeck_torque": 0.1,
    "load_friction": 0.005,
    "gear_stiffness": 14.0,
    "gear_damping": 7.0,
    "backlash": 0.007,
}
INITIAL_MOTOR = {
    "kp": 10.0,
    "kd_over_kp": 0.09,
    "velocity_filter": 0.0005,
    "delay": 0.008,
    "torque_limit": 1.5,
    "armature": 0.002,
    "coulomb": 0.06,
    "stribeck_torque": 0.01,
    "viscous_damping": 0.004,
    "load_friction": 0.2,
    "gear_stiffness": 70.0,
    "backlash": 0.015,
    "gear_damping": 0.03,
    **INITIAL,
}
# constants that scale with the size of a motor
TORQUES = (
    "kp",
    "torque_limit",
    "armature",
    "coulomb",
    "stribeck_torque",
    "viscous_damping",
    "gear_stiffness",
    "gear_damping",
    *(name for name, constant in CONSTANTS.items() if constant.unit.startswith("N·m")),
)
# logarithms of the factors on torques, and on kp alone, that are tried on the logs
_LOG_FACTORS = np.log(4.0) * np.arange(3.0, -4.0, -1.0)
# maximum standard deviation of the logarithm of kp in a class; motors of one make have 0.1
MAX_KP_STD = 0.7
LIMITS = ("torque_limit", *SPEED_LIMITS, "profile_acceleration")
# a constant is identifiable if half and double of it both raise the loss by more than this factor
THRESHOLD = 1.02


class MotorProblem:
    """Residuals of free runs of motors that ``model`` decodes from x, see `search.Problem`."""

    def __init__(self, model: GreyBox, runs: WindowRuns):
        self.model = model
        self.runs = runs
        self.count = runs.num_motors
        self.weight = float(runs.channels)
        self.observations = len(runs.counted)

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, windows·channels·steps) scaled errors of motor ``problems[l]`` at unknowns x[l]."""
        residuals = self.runs.residuals(grey_boxes(self.model), x, problems)
        return residuals.reshape(len(problems), -1)


def motor_search(model: GreyBox, runs: WindowRuns) -> Search:
    """Search for the motors of these logs."""
    return Search(MotorProblem(model, runs))


def centred_search(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> Search:
    """Search around a central motor (K,), with `lower_bounds` of candidates."""
    problem = MotorProblem(grey_box(center, terms, runs.recipe), runs)
    return Search(problem, lower_bounds(center, terms, runs))


def scaled_center(runs: WindowRuns, terms: tuple[str, ...]) -> np.ndarray:
    """(P,) decoder outputs of `initial_center`, or of a motor of another size.

    The other size is used if its loss is less than half the initial motor's, and not if logged
    gains set the size.
    """
    center = initial_center(terms, runs)
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return center

    names = parameters_of(terms)
    torques = np.isin(names, TORQUES)
    kp = np.isin(names, ("kp",))
    centers = [center]
    for torque_factor, kp_factor in itertools.product(_LOG_FACTORS, _LOG_FACTORS):
        if torque_factor or kp_factor:
            centers.append(center + torque_factor * torques + kp_factor * kp)

    # median over the motors, each at its central motor
    z = np.zeros((runs.num_motors, len(names)))
    losses = []
    for scaled in centers:
        losses.append(motor_search(grey_box(scaled, terms, runs.recipe), runs).losses(z))
    medians = np.median(losses, axis=1)
    best = int(np.argmin(medians))
    return centers[best] if medians[best] < 0.5 * medians[0] else center


def rigid_motor(
    center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns
) -> tuple[np.ndarray, np.ndarray]:
    """The simplest motor that is nested in motors with these ``terms``.

    Limits and optional terms have no effect, and the gear is rigid with Coulomb and viscous
    friction; other constants are as in ``center`` (K,).

    Returns:
        Its decoder outputs (K,), and a mask (K,) of the constants that it lacks.
    """
    names = parameters_of(terms)
    max_torque = float(np.max(runs.max_request)) * np.exp(center[names.index("kp")]) or 1.0
    without_effect = encoded(NEGLIGIBLE | {"torque_limit": OFF * max_torque}, terms)

    is_switched_off = np.isin(names, (*NEGLIGIBLE, "torque_limit"))
    outputs = np.where(is_switched_off, without_effect, center)
    outputs += np.array([np.log(RIGID.get(name, 1.0)) for name in names])

    fixed = fixed_constants(terms, runs)
    missing = np.isin(names, (*RIGID, *NEGLIGIBLE, "torque_limit", "encoder_zero")) & ~fixed
    return np.where(fixed, center, outputs), missing


def with_more_terms(
    outputs: np.ndarray, old_terms: tuple[str, ...], terms: tuple[str, ...], runs: WindowRuns
) -> np.ndarray:
    """(M, K) decoder outputs with ``terms`` of motors that have ``outputs`` with ``old_terms``.

    Constants of new terms have no effect.
    """
    neutral = encoded(NEGLIGIBLE | runs.recipe.logged_values, terms)
    extended = np.tile(neutral, (len(outputs), 1))
    names = parameters_of(terms)
    for column, name in enumerate(parameters_of(old_terms)):
        if name in names:
            extended[:, names.index(name)] = outputs[:, column]
    return extended


def lower_bounds(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(M, K) lower bounds of candidates around a central motor (K,).

    Limits of speed are above the logged speeds; other constants, and fixed ones, have -inf. A limit
    far below the motor's own keeps a search in a poor optimum. An impact can drive a joint faster
    than its motor for 0.1 s, so Gauss-Newton steps may go below the bound.
    """
    motors = len(runs.sustained_speeds[SPEED_LIMITS[0]])
    lower = np.full((motors, len(center)), -np.inf)
    for column, name in enumerate(parameters_of(terms)):
        if name in SPEED_LIMITS:
            with np.errstate(divide="ignore"):
                log_speeds = np.log(1.02 * runs.sustained_speeds[name])
            lower[:, column] = np.minimum(log_speeds - center[column], LOG_REACH)
    lower[:, fixed_constants(terms, runs)] = -np.inf
    return lower


def fixed_constants(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(K,) mask of the constants that are not fitted.

    They are absent, logged, or hidden from the encoders.
    """
    fixed = {*runs.recipe.lacks, *runs.recipe.logged_values}
    if runs.at_rotor:
        fixed.update(HIDDEN_FROM_ROTOR)
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        fixed.add("kp")
        if logs_kd(runs):
            fixed.add("kd_over_kp")
    return np.array([name in fixed for name in parameters_of(terms)])


def separate_prior(
    search: Search, x: np.ndarray, mean: np.ndarray, initial: np.ndarray
) -> GaussianPrior:
    """Prior of single motors: WEAK about ``mean``, but informative for the velocity filter.

    The filter's mean is its value in ``initial`` (K,). Its standard deviation is FILTER_STD, at the
    loss of motors with the unknowns x (M, K). A filter of 0.1 s would replay some logs of slow
    motion slightly better, and no others.
    """
    is_filter = np.arange(mean.shape[-1]) == PARAMETERS.index("velocity_filter")
    precision = search.losses(x)[:, None] / search.problem.observations / FILTER_STD**2
    return GaussianPrior(np.where(is_filter, initial, mean), np.where(is_filter, precision, WEAK))


def initial_center(terms: tuple[str, ...], runs: WindowRuns | None = None) -> np.ndarray:
    """(P,) decoder outputs of the initial motor, adapted to the logs ``runs`` if they are given.

    The logs then give its limits of speed, gains and firmware. Where gains are logged in N·m/rad,
    every torque of the initial motor is scaled to a motor with such gains.
    """
    if runs is None:
        return encoded(INITIAL_MOTOR, terms)

    constants = dict(INITIAL_MOTOR)
    for name in runs.recipe.lacks:
        constants[name] = INITIAL_MOTOR[name] * RIGID[name] if name in GEAR else 1e-9

    if runs.max_speed:
        # a little above the logged speeds: a limit that is too low rises in the fit, one that is
        # too high has no effect
        profile_speed = 1.1 * float(np.median(runs.sustained_speeds["profile_speed"]))
        constants["profile_speed"] = profile_speed or runs.max_speed
        constants["no_load_speed"] = 1.3 * runs.max_speed

    constants |= runs.recipe.logged_values
    if runs.recipe.gain_unit:
        constants |= _relative_gains(constants, runs)
    return encoded(constants, terms)


def _relative_gains(constants: Mapping[str, float], runs: WindowRuns) -> dict[str, float]:
    """Constants relative to the logged gains, which replace constants of the initial motor.

    Gains in N·m/rad also give the size of the motor, and so its torques.
    """
    kp = float(np.median(runs.gains[0]))
    kd_over_kp = float(np.median(runs.gains[1] / runs.gains[0])) or 1.0
    if runs.recipe.gain_unit != PHYSICAL_GAINS:
        return {"kp": constants["kp"] / kp, "kd_over_kp": constants["kd_over_kp"] / kd_over_kp}

    size = kp / INITIAL_MOTOR["kp"]
    scaled = {name: size * constants[name] for name in TORQUES if name in constants}

    # the geometric mean of the scaled limit and of one that the motor does not reach, since the
    # logs may saturate
    max_torque = float(np.median(runs.max_request))
    limit = scaled["torque_limit"]
    scaled["torque_limit"] = float(np.sqrt(limit * max(limit, 2.0 * max_torque)))

    scaled["kp"] = 1.0
    if logs_kd(runs):
        scaled["kd_over_kp"] = 1.0
    return scaled


def logs_kd(runs: WindowRuns) -> bool:
    """Whether the logs have kd: where they do not, it is set to kp (`windows`)."""
    return bool(np.any(runs.gains[1] != runs.gains[0]))


def encoded(values: Mapping[str, Any], terms: tuple[str, ...]) -> np.ndarray:
    """(P,) or (P, n) decoder outputs of motors with these constants.

    Positive constants are logarithms, signed ones multiples of their unit; the output of a constant
    that is not given is 0.
    """
    outputs = []
    for name in parameters_of(terms):
        if name in SIGNED:
            outputs.append(values.get(name, 0.0) / SIGNED[name])
        else:
            outputs.append(np.log(np.maximum(values.get(name, 1.0), 1e-9)))
    return np.array(outputs)


def grey_box(center: np.ndarray, terms: tuple[str, ...], recipe: Recipe) -> GreyBox:
    """The decoder around a central motor (P,), with one latent per constant."""
    return GreyBox(center, np.eye(len(center)), recipe.period, terms, gain_unit=recipe.gain_unit)


def near_bounds(x: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(M, K) mask of the constants at a bound of the search.

    The unknowns x (M, K) are logarithms of constants, relative to the central motor (K,).
    """
    near = np.abs(x) > 0.99 * LOG_REACH
    delay = PARAMETERS.index("delay")
    near[:, delay] |= x[:, delay] + center[delay] > np.log(0.99 * MAX_DELAY)
    return near


def identifiable_constants(
    model: GreyBox, runs: WindowRuns, z: np.ndarray, names: Iterable[str]
) -> frozenset[str]:
    """The positive constants among ``names`` that at least half of the M motors identify.

    ``runs`` are the logs of the motors and ``z`` (M, Z) their latents.
    """
    ratios = _loss_ratios(model, runs, z, [(name,) for name in names])
    identifiable = set()
    for (name,), ratio in ratios.items():
        if np.median(ratio, axis=1).min() > THRESHOLD:
            identifiable.add(name)
    return frozenset(identifiable)


def unidentifiable_limits(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> dict[str, np.ndarray]:
    """Fitted LIMITS -> mask (M,) of the motors whose own logs do not identify them.

    ``runs`` are the logs of the motors and ``z`` (M, Z) their latents. Limits that all motors
    identify are left out.
    """
    names = parameters_of(model.terms)
    fixed = fixed_constants(model.terms, runs)
    fitted = [(name,) for name in LIMITS if name in names and not fixed[names.index(name)]]

    hidden = {}
    for (name,), ratio in _loss_ratios(model, runs, z, fitted).items():
        is_hidden = ratio.min(axis=0) <= THRESHOLD
        if is_hidden.any():
            hidden[name] = is_hidden
    return hidden


def unknown_torque_scale(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> np.ndarray:
    """(M,) whether a motor's log does not identify the scale of its torques.

    False if gains are logged in N·m/rad. True for a class of joints whose motors' kp differ by more
    than MAX_KP_STD: their loads are wrong, or too small. Arguments as for `unidentifiable_limits`.
    """
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return np.zeros(len(z), bool)

    is_hidden = _loss_ratios(model, runs, z, [TORQUES])[TORQUES].min(axis=0) <= THRESHOLD
    log_kp = z[:, PARAMETERS.index("kp")]
    same_class = runs.classes[:, None] == runs.classes
    differs = np.array([log_kp[row].std() > MAX_KP_STD for row in same_class])
    return is_hidden | differs


def _loss_ratios(
    model: GreyBox, runs: WindowRuns, z: np.ndarray, groups: Iterable[tuple[str, ...]]
) -> dict[tuple[str, ...], np.ndarray]:
    """(2, M) losses with half and with double of each group of constants, over the fit's losses."""
    fitted = motor_search(model, runs).losses(z)
    ratios = {}
    for names in groups:
        columns = np.isin(parameters_of(model.terms), names)
        losses = []
        for factor in (0.5, 2.0):
            changed = replace(model, center=model.center + np.log(factor) * columns)
            losses.append(motor_search(changed, runs).losses(z))
        ratios[names] = np.stack(losses) / fitted
    return ratios
