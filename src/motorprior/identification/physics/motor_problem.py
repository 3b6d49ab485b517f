"""The least-squares problems of M motors, each on its own log: unknowns are decoder outputs relative to a centre.

A decoder reaches constants within a factor of 148 of its central motor, but kp of servos and
quadrupeds spans 1 to 40 N·m/rad. Gains that are logged in N·m/rad set the scale of the initial
motor. Elsewhere several scales of all torques, and of the gain alone, are tried on the logs, and
the fit starts from the best if its loss is less than half the initial motor's.
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
OFF = 4.0  # a limit so many times the largest request or speed in the log has no effect
# factors on constants of the initial motor with which it is a rigid gear with Coulomb and viscous
# friction
RIGID = {
    "velocity_filter": 0.1, "stribeck_torque": 0.1, "load_friction": 0.005, "gear_stiffness": 14.0,
    "gear_damping": 7.0, "backlash": 0.007,
}  # fmt: skip

_SIZES = np.log(4.0) * np.arange(3.0, -4.0, -1.0)  # logarithms of the factors that are tried
INITIAL_MOTOR = {
    "kp": 10.0, "kd_over_kp": 0.09, "velocity_filter": 0.0005, "delay": 0.008, "torque_limit": 1.5, "armature": 0.002,
    "coulomb": 0.06, "stribeck_torque": 0.01, "viscous_damping": 0.004, "load_friction": 0.2, "gear_stiffness": 70.0,
    "backlash": 0.015, "gear_damping": 0.03, **INITIAL,
}  # fmt: skip
# Constants that scale with the size of a motor
TORQUES = (
    "kp", "torque_limit", "armature", "coulomb", "stribeck_torque", "viscous_damping", "gear_stiffness", "gear_damping",
    *(name for name, constant in CONSTANTS.items() if constant.unit.startswith("N·m")),
)  # fmt: skip
# standard deviation of the logarithm of kp in a class; that of motors of one make is 0.1
MAX_SPREAD = 0.7
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

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, windows·channels·steps) scaled errors of motor ``which[l]`` with constants x[l]."""
        return self.runs.residuals(grey_boxes(self.model), x, which).reshape(len(which), -1)


def motor_search(model: GreyBox, runs: WindowRuns) -> Search:
    """Search for the motors of these logs."""
    return Search(MotorProblem(model, runs))


def centred(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> Search:
    """Search around a central motor (K,)."""
    return Search(
        MotorProblem(grey_box(center, terms, runs.recipe), runs), lower_bounds(center, terms, runs)
    )


def scaled_center(runs: WindowRuns, terms: tuple[str, ...]) -> np.ndarray:
    """(P,) decoder outputs of `initial_center`, or of a motor of another size where that fits the logs much better."""
    center = initial_center(terms, runs)
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return center
    names = parameters_of(terms)
    torques = np.isin(names, TORQUES)
    gain = np.isin(names, ("kp",))
    sizes = [
        center,
        *(center + a * torques + b * gain for a, b in itertools.product(_SIZES, _SIZES) if a or b),
    ]
    z = np.zeros((runs.num_motors, len(names)))
    losses = [motor_search(grey_box(size, terms, runs.recipe), runs).losses(z) for size in sizes]
    middle = np.median(losses, axis=1)
    best = int(np.argmin(middle))
    return sizes[best] if middle[best] < 0.5 * middle[0] else center


def rigid_motor(
    center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns
) -> tuple[np.ndarray, np.ndarray]:
    """The simplest motor that is nested in those with these terms, and (K,) its missing constants.

    Limits and optional terms have no effect, and the gear is rigid with Coulomb and viscous
    friction.
    """
    names = parameters_of(terms)
    largest = float(np.max(runs.max_request)) * np.exp(center[names.index("kp")]) or 1.0
    simple = encoded(NEGLIGIBLE | {"torque_limit": OFF * largest}, terms)
    raw = np.where(np.isin(names, (*NEGLIGIBLE, "torque_limit")), simple, center)
    raw += np.array([np.log(RIGID.get(name, 1.0)) for name in names])
    fixed = fixed_constants(terms, runs)
    missing = np.isin(names, (*RIGID, *NEGLIGIBLE, "torque_limit", "encoder_zero")) & ~fixed
    return np.where(fixed, center, raw), missing


def with_more_terms(
    raw: np.ndarray, before: tuple[str, ...], terms: tuple[str, ...], runs: WindowRuns
) -> np.ndarray:
    """(M, K) decoder outputs with these terms, of motors with outputs ``raw`` and the terms ``before``.

    Constants of terms that are new have no effect.
    """
    neutral = encoded(NEGLIGIBLE | runs.recipe.logged_values, terms)
    found = np.tile(neutral, (len(raw), 1))
    names = parameters_of(terms)
    for row, name in enumerate(parameters_of(before)):
        if name in names:
            found[:, names.index(name)] = raw[:, row]
    return found


def lower_bounds(center: np.ndarray, terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(M, K) lower bounds of candidates around a central motor (K,): limits of speed are above the logged speeds.

    A limit far below the motor's own keeps a search in a poor optimum. An impact can drive a joint
    faster than its motor for 0.1 s, so Gauss-Newton steps may go below the bound. -inf for other
    and for fixed constants.
    """
    lower = np.full((len(runs.sustained_speeds[SPEED_LIMITS[0]]), len(center)), -np.inf)
    for row, name in enumerate(parameters_of(terms)):
        if name in SPEED_LIMITS:
            with np.errstate(divide="ignore"):
                lower[:, row] = np.minimum(
                    np.log(1.02 * runs.sustained_speeds[name]) - center[row], LOG_REACH
                )
    lower[:, fixed_constants(terms, runs)] = -np.inf
    return lower


def fixed_constants(terms: tuple[str, ...], runs: WindowRuns) -> np.ndarray:
    """(K,) constants that are not fitted: absent or logged ones, and those that the encoders do not identify."""
    fixed = (
        *runs.recipe.lacks,
        *runs.recipe.logged_values,
        *(HIDDEN_FROM_ROTOR if runs.at_rotor else ()),
    )
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        fixed += ("kp", "kd_over_kp") if logs_kd(runs) else ("kp",)
    return np.array([name in fixed for name in parameters_of(terms)])


def separate_prior(
    search: Search, x: np.ndarray, mean: np.ndarray, initial: np.ndarray
) -> GaussianPrior:
    """Prior of single motors: WEAK about ``mean``, except for the velocity filter, which has that of ``initial`` (K,).

    The filter's precision is that of FILTER_STD at the loss of motors ``x`` (M, K). A filter of 0.1
    s would replay some logs of slow motion slightly better, and no other.
    """
    filtered = np.arange(mean.shape[-1]) == PARAMETERS.index("velocity_filter")
    precision = search.losses(x)[:, None] / search.problem.observations / FILTER_STD**2
    return GaussianPrior(np.where(filtered, initial, mean), np.where(filtered, precision, WEAK))


def initial_center(terms: tuple[str, ...], runs: WindowRuns | None = None) -> np.ndarray:
    """(P,) decoder outputs of the initial motor; its limits of speed, logged gains and firmware are those of the logs.

    Where gains are logged in N·m/rad, every torque of the initial motor is that of a motor with
    such gains.
    """
    if runs is None:
        return encoded(INITIAL_MOTOR, terms)
    absent = {
        name: INITIAL_MOTOR[name] * RIGID[name] if name in GEAR else 1e-9
        for name in runs.recipe.lacks
    }
    motor = INITIAL_MOTOR | absent
    if runs.max_speed:
        # a little above the logged speeds: a limit that is too low rises in the fit, one that is
        # too high has no effect
        profile = 1.1 * float(np.median(runs.sustained_speeds["profile_speed"])) or runs.max_speed
        motor = motor | {"profile_speed": profile, "no_load_speed": 1.3 * runs.max_speed}
    motor = motor | runs.recipe.logged_values
    if not runs.recipe.gain_unit:
        return encoded(motor, terms)
    kp = float(np.median(runs.gains[0]))
    ratio = float(np.median(runs.gains[1] / runs.gains[0])) or 1.0
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        factor = kp / INITIAL_MOTOR["kp"]
        motor = motor | {name: factor * motor[name] for name in TORQUES if name in motor}
        needed = float(np.median(runs.max_request))
        # it may saturate
        limit = float(np.sqrt(motor["torque_limit"] * max(motor["torque_limit"], 2.0 * needed)))
        motor = (
            motor
            | {"kp": 1.0, "torque_limit": limit}
            | ({"kd_over_kp": 1.0} if logs_kd(runs) else {})
        )
    else:
        motor = motor | {"kp": motor["kp"] / kp, "kd_over_kp": motor["kd_over_kp"] / ratio}
    return encoded(motor, terms)


def logs_kd(runs: WindowRuns) -> bool:
    """Whether the logs have kd: where they do not, it is set to kp (`windows`)."""
    return bool(np.any(runs.gains[1] != runs.gains[0]))


def encoded(values: Mapping[str, Any], terms: tuple[str, ...]) -> np.ndarray:
    """(P,) or (P, n) decoder outputs of motors with these constants; 0 for constants that are not given."""
    return np.array(
        [
            values.get(name, 0.0) / SIGNED[name]
            if name in SIGNED
            else np.log(np.maximum(values.get(name, 1.0), 1e-9))
            for name in parameters_of(terms)
        ]
    )


def grey_box(center: np.ndarray, terms: tuple[str, ...], recipe: Recipe) -> GreyBox:
    """The decoder around a central motor (P,), with one latent per constant."""
    return GreyBox(center, np.eye(len(center)), recipe.period, terms, gain_unit=recipe.gain_unit)


def near_bounds(x: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(M, K) whether constants, as logarithms x relative to the central motor's (K,), are at a bound of the search."""
    found = np.abs(x) > 0.99 * LOG_REACH
    delay = PARAMETERS.index("delay")
    found[:, delay] |= x[:, delay] + center[delay] > np.log(0.99 * MAX_DELAY)
    return found


def identifiable_constants(
    model: GreyBox, runs: WindowRuns, z: np.ndarray, names: Iterable[str]
) -> frozenset[str]:
    """The positive constants among ``names`` that at least half of the M motors identify.

    ``runs`` are the logs of the motors and ``z`` (M, Z) their latents.
    """
    ratios = _loss_ratios(model, runs, z, [(name,) for name in names])
    return frozenset(
        name for (name,), ratio in ratios.items() if np.median(ratio, axis=1).min() > THRESHOLD
    )


def unidentifiable_limits(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> dict[str, np.ndarray]:
    """Fitted LIMITS -> (M,) motors whose own logs do not identify them; arguments as above."""
    rows = parameters_of(model.terms)
    fixed = fixed_constants(model.terms, runs)
    limits = [(name,) for name in LIMITS if name in rows and not fixed[rows.index(name)]]
    found = {
        name: ratio.min(axis=0) <= THRESHOLD
        for (name,), ratio in _loss_ratios(model, runs, z, limits).items()
    }
    return {name: hidden for name, hidden in found.items() if hidden.any()}


def unknown_torque_scale(model: GreyBox, runs: WindowRuns, z: np.ndarray) -> np.ndarray:
    """(M,) whether a motor's log does not identify the scale of its torques; False if gains are logged in N·m/rad.

    Nor do the logs of a class whose motors' kp differ by more than MAX_SPREAD: their loads are
    wrong, or too small.
    """
    if runs.recipe.gain_unit == PHYSICAL_GAINS:
        return np.zeros(len(z), bool)
    hidden = _loss_ratios(model, runs, z, [TORQUES])[TORQUES].min(axis=0) <= THRESHOLD
    kp = z[:, PARAMETERS.index("kp")]
    of_class = runs.classes[:, None] == runs.classes
    return hidden | np.array([kp[row].std() > MAX_SPREAD for row in of_class])


def _loss_ratios(
    model: GreyBox, runs: WindowRuns, z: np.ndarray, groups: Iterable[tuple[str, ...]]
) -> dict[tuple[str, ...], np.ndarray]:
    """(2, M) losses with half and with double of each group of constants, over the losses of the fitted motors."""
    ratios = {}
    fitted = motor_search(model, runs).losses(z)
    for names in groups:
        rows = np.isin(parameters_of(model.terms), names)
        changed = [
            replace(model, center=model.center + np.log(factor) * rows) for factor in (0.5, 2.0)
        ]
        losses = [motor_search(each, runs).losses(z) for each in changed]
        ratios[names] = np.stack(losses) / fitted
    return ratios
