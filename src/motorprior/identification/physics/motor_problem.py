"""The least-squares problems of M motors, each on its own log.

The unknowns are decoder outputs, one per constant, relative to a central motor.

A decoder reaches constants within a factor of 148 of its central motor, but kp of servos and
quadrupeds spans 1 to 40 N·m/rad. Gains that are logged in N·m/rad set the scale of the initial
motor. Without such gains, motors with several scales of all torques, and of kp alone, are tried on
the logs. The fit starts from the best of these motors if its loss is less than half the loss of the
initial motor.

Shapes: a decoder has P outputs, a problem has K unknowns, and K = P. There are M motors. ``terms``
are names of optional dynamics terms.
"""

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.actuator.geared_motor_step import (
    MAX_DELAY,
    MAX_LOG_FACTOR,
    PARAMETERS,
    parameters_of,
)
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import CONSTANTS, INITIAL, NEGLIGIBLE, SIGNED
from motorprior.identification.checkpoint import PartCheckpoint, unsaved_part
from motorprior.identification.physics.window_runs import (
    HIDDEN_FROM_ROTOR,
    SPEED_LIMITS,
    WindowRuns,
    grey_boxes,
)
from motorprior.identification.presets import GEAR, Recipe
from motorprior.identification.search import GaussianPrior, Search
from motorprior.logs.motor_log import PHYSICAL_GAINS

# precision of a weak prior, in the energy of `search`; it keeps unidentifiable constants at its
# mean
WEAK_PRECISION = 1e-4
# standard deviation of log(time constant of the velocity filter) around the initial motor's value;
# real filters are short
FILTER_STD = 1.0
# A limit has no effect if it is this factor times the largest requested torque or speed of the log.
DISABLED_LIMIT_FACTOR = 4.0
# factors on constants of the initial motor; they turn it into a motor with a rigid gear and with
# Coulomb and viscous friction only
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
# maximum standard deviation of log(kp) in a class of joints; it is 0.1 for motors of one make
MAX_KP_STD = 0.7
# The torque scale is identified if halving and doubling it both raise the loss by more than this
# factor.
MIN_LOSS_RATIO = 1.02


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


def motor_search(
    model: GreyBox, runs: WindowRuns, checkpoint: PartCheckpoint = unsaved_part
) -> Search:
    """Search for the motors of these logs."""
    return Search(MotorProblem(model, runs), checkpoint=checkpoint)


def centred_search(
    center: np.ndarray,
    terms: tuple[str, ...],
    runs: WindowRuns,
    checkpoint: PartCheckpoint = unsaved_part,
) -> Search:
    """Search around a central motor (K,), with `lower_bounds` of candidates."""
    problem = MotorProblem(grey_box(center, terms, runs.recipe), runs)
    return Search(problem, lower_bounds(center, terms, runs), checkpoint)


def scaled_center(runs: WindowRuns, terms: tuple[str, ...]) -> np.ndarray:
    """(P,) decoder outputs of `initial_center`, or of a motor of another size.

    The motor of another size is used if its loss is less than half the loss of the initial motor.
    If logged gains set the size, no other size is tried.
    """
    center = initial_center(terms, runs)
    names = parameters_of(terms)
    torques = np.isin(names, TORQUES)
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return center

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
    """The simplest motor, as a special case of motors with these ``terms``.

    Limits and optional terms have no effect. The gear is rigid, with Coulomb and viscous friction.
    The other constants are as in ``center`` (K,).

    Returns:
        The decoder outputs (K,) of the simplest motor, and a mask (K,) of the fitted constants that
        it simplifies.
    """
    names = parameters_of(terms)
    without_effect = encoded(NEGLIGIBLE, terms)
    without_effect[names.index("torque_limit")] = log_unlimited_torque(center, terms, runs)

    is_switched_off = np.isin(names, (*NEGLIGIBLE, "torque_limit"))
    outputs = np.where(is_switched_off, without_effect, center)
    outputs += np.array([np.log(RIGID.get(name, 1.0)) for name in names])

    fixed = fixed_constants(terms, runs)
    simplified_names = (*RIGID, *NEGLIGIBLE, "torque_limit", "encoder_zero")
    is_simplified = np.isin(names, simplified_names) & ~fixed
    return np.where(fixed, center, outputs), is_simplified


def log_unlimited_torque(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> float:
    """Logarithm of a torque limit [N·m] without effect on a motor with decoder outputs (K,)."""
    log_kp = center[parameters_of(terms).index("kp")]
    max_request = float(np.max(runs.max_request))
    if max_request == 0.0:
        return float(np.log(DISABLED_LIMIT_FACTOR))
    return float(np.log(DISABLED_LIMIT_FACTOR * max_request) + log_kp)


def with_more_terms(
    outputs: np.ndarray, old_terms: tuple[str, ...], terms: tuple[str, ...], runs: WindowRuns
) -> np.ndarray:
    """(M, K) decoder outputs with ``terms`` of motors with other optional terms.

    ``outputs`` are the motors' decoder outputs with ``old_terms``. The constants of new terms get
    values with almost no effect.
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

    Limits of speed are bounded by the logged speeds: a candidate with a limit far below the motor's
    own limit keeps a search in a poor optimum. Other constants, and fixed constants, have the bound
    -inf. An impact can drive a joint faster than its motor for 0.1 s, so the true limit may be
    below the bound. Gauss-Newton steps may therefore go below it.
    """
    motors = len(runs.sustained_speeds[SPEED_LIMITS[0]])
    lower = np.full((motors, len(center)), -np.inf)
    for column, name in enumerate(parameters_of(terms)):
        if name in SPEED_LIMITS:
            with np.errstate(divide="ignore"):
                min_log_limit = np.log(1.02 * runs.sustained_speeds[name])
            lower[:, column] = np.minimum(min_log_limit - center[column], MAX_LOG_FACTOR)
    lower[:, fixed_constants(terms, runs)] = -np.inf
    return lower


def fixed_constants(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(K,) mask of the constants that are not fitted.

    The recipe leaves them out, the log states them, or the encoders do not see them.
    """
    fixed = {*runs.recipe.lacks, *runs.recipe.logged_values}
    if runs.at_rotor:
        fixed.update(HIDDEN_FROM_ROTOR)
    if runs.command_mode in ("velocity", "torque"):
        fixed.add("kp")  # it has no effect; kd of velocity control is kp·kd_over_kp
    if runs.command_mode == "torque":
        fixed.add("kd_over_kp")
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        fixed.add("kp")
        if runs.logs_kd:
            fixed.add("kd_over_kp")
    return np.array([name in fixed for name in parameters_of(terms)])


def single_motor_prior(
    search: Search, x: np.ndarray, mean: np.ndarray, initial: np.ndarray
) -> GaussianPrior:
    """Prior of motors that are fitted one by one.

    The prior has WEAK_PRECISION about ``mean``, and is informative for the velocity filter only. A
    filter of 0.1 s would replay some logs of slow motion slightly better, but not other logs. The
    prior mean of the filter is its value in ``initial`` (K,), and its standard deviation is
    FILTER_STD if a window with the loss at x (M, K) counts as one observation.
    """
    is_filter = np.arange(mean.shape[-1]) == PARAMETERS.index("velocity_filter")
    loss_per_window = search.losses(x)[:, None] / search.problem.observations
    filter_precision = loss_per_window / FILTER_STD**2
    return GaussianPrior(
        mean=np.where(is_filter, initial, mean),
        precision=np.where(is_filter, filter_precision, WEAK_PRECISION),
    )


def initial_center(terms: tuple[str, ...], runs: WindowRuns | None = None) -> np.ndarray:
    """(P,) decoder outputs of the initial motor, adapted to the logs ``runs`` if they are given.

    Limits of speed, gains and firmware are then from the logs. If the gains are logged in N·m/rad,
    all torques of the initial motor are scaled to a motor with such gains.
    """
    if runs is None:
        return encoded(INITIAL_MOTOR, terms)

    constants = dict(INITIAL_MOTOR)
    for name in runs.recipe.lacks:
        is_gear = name in GEAR
        constants[name] = INITIAL_MOTOR[name] * RIGID[name] if is_gear else 1e-9

    # Limits of speed start a little above the logged speeds: the fit raises a limit that is too
    # low, but a limit that is too high has no effect.
    if runs.max_speed:
        profile_speed = 1.1 * float(np.median(runs.sustained_speeds["profile_speed"]))
        if profile_speed == 0.0:
            profile_speed = runs.max_speed
        constants["profile_speed"] = profile_speed
        constants["no_load_speed"] = 1.3 * runs.max_speed

    constants |= runs.recipe.logged_values
    if runs.recipe.gain_unit:
        constants |= _relative_gains(constants, runs)
    return encoded(constants, terms)


def _relative_gains(constants: Mapping[str, float], runs: WindowRuns) -> dict[str, float]:
    """Constants that replace constants of the initial motor if the gains are logged.

    kp and kd_over_kp become multiples of the logged gains. Gains in N·m/rad also give the size of
    the motor, and thereby its torques.
    """
    kp = kp_of_size(runs)
    kd_over_kp = float(np.median(runs.gains[1] / runs.gains[0]))
    if kd_over_kp == 0.0:
        kd_over_kp = 1.0
    if runs.recipe.gain_unit != PHYSICAL_GAINS:
        return {"kp": constants["kp"] / kp, "kd_over_kp": constants["kd_over_kp"] / kd_over_kp}

    size = kp / INITIAL_MOTOR["kp"]
    scaled = {name: size * constants[name] for name in TORQUES if name in constants}

    # Torque limit: geometric mean of the limit of a motor of this size, and of a limit above all
    # requested torques. The logs may saturate, so neither is certain.
    limit_of_size = scaled["torque_limit"]
    max_torque = float(np.median(runs.max_request))
    high_limit = max(limit_of_size, 2.0 * max_torque)
    scaled["torque_limit"] = float(np.sqrt(limit_of_size * high_limit))

    scaled["kp"] = 1.0
    if runs.logs_kd:
        scaled["kd_over_kp"] = 1.0
    return scaled


def kp_of_size(runs: WindowRuns) -> float:
    """Logged kp, or without position control the kp of a motor of this size [N·m/rad].

    A motor under velocity control has the size of its kd. A motor under torque control commands a
    third of the torque limit of its size.
    """
    if runs.command_mode == "velocity":
        return float(np.median(runs.gains[1])) / INITIAL_MOTOR["kd_over_kp"]
    if runs.command_mode == "torque":
        max_torque = float(np.median(runs.max_request))
        return INITIAL_MOTOR["kp"] * 3.0 * max_torque / INITIAL_MOTOR["torque_limit"]
    return float(np.median(runs.gains[0]))


def encoded(values: Mapping[str, Any], terms: tuple[str, ...]) -> np.ndarray:
    """(P,) or (P, n) decoder outputs of motors with these constants.

    The output of a positive constant is its logarithm. The output of a signed constant is a
    multiple of its unit. The output of a constant that is not given is 0.
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
    is_near = np.abs(x) > 0.99 * MAX_LOG_FACTOR
    delay = PARAMETERS.index("delay")
    log_delay = x[:, delay] + center[delay]
    is_near[:, delay] |= log_delay > np.log(0.99 * MAX_DELAY)
    return is_near


def unknown_torque_scale(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> np.ndarray:
    """(M,) whether a motor's log does not identify the scale of its torques.

    The scale is known if the gains are logged in N·m/rad. It counts as unknown for all motors of a
    class of joints if the standard deviation of log(kp) in the class exceeds MAX_KP_STD: the loads
    are then wrong, or too small. ``runs`` are the logs of the motors, ``z`` (M, Z) their latents.
    """
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return np.zeros(len(z), bool)

    fitted = motor_search(model, runs).losses(z)
    is_torque = np.isin(parameters_of(model.terms), TORQUES)
    is_unidentified = np.zeros(len(z), bool)
    for factor in (0.5, 2.0):
        scaled = replace(model, center=model.center + np.log(factor) * is_torque)
        losses = motor_search(scaled, runs).losses(z)
        is_unidentified |= losses <= MIN_LOSS_RATIO * fitted

    log_kp = z[:, PARAMETERS.index("kp")]
    is_same_class = runs.classes[:, None] == runs.classes  # (M, M)
    kp_std = np.array([log_kp[in_class].std() for in_class in is_same_class])
    return is_unidentified | (kp_std > MAX_KP_STD)
