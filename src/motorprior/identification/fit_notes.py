"""Notes on fitted motors: selected terms, and constants that the logs do not identify."""

import numpy as np

from motorprior.actuator.estimates import LIMITS, Estimates
from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import limit_text
from motorprior.exceptions import listed
from motorprior.identification import windows as channel
from motorprior.identification.physics import motor_problem
from motorprior.identification.physics.motor_model_fit import ModelLevel
from motorprior.identification.physics.term_selection import min_condition_difference
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData
from motorprior.progress import Note

_MAX_NAMES = 6  # joints that a note lists
_MIN_TWIST = 0.03  # share of a servo's deflection in its gear from which the encoder's place counts


def notes_on_terms(recipe: Recipe, tried: bool) -> list[Note]:
    """Note on the optional terms of the recipe, and warnings of operating conditions it ignores.

    ``tried`` states whether terms were tried.
    """
    names = []
    for name in recipe.terms:
        names.append(f"{name} (logged)" if name in recipe.logged_terms else name)
    without_terms = "none" if tried else "none was tried"
    notes = [Note("info", f"optional terms: {', '.join(names) or without_terms}")]
    if recipe.tries_terms:
        return notes

    for name, low, nominal, high in recipe.operating_conditions:
        if high - low >= min_condition_difference(name, nominal):
            text = (
                f"{name} varies from {low:.3g} to {high:.3g} in these logs, which a recipe "
                "without optional terms ignores -> use preset rollout or long_runs"
            )
            notes.append(Note("warning", text))
    return notes


def outlier_notes(
    model: GreyBox, z: np.ndarray, deviations: np.ndarray, data: TrainingData
) -> list[Note]:
    """Warnings of constants that the other motors of the same model contradict.

    ``z`` (M, Z) are the latents of the motors; ``deviations`` (M, P) are nonzero for outliers.
    """
    notes = []
    values = model.constants(z)
    for column, name in enumerate(parameters_of(model.terms)):
        texts = []
        for motor in np.flatnonzero(deviations[:, column]):
            joint = data.joint_names[motor] if data.joint_names else f"motor {motor}"
            texts.append(f"{joint} {values[name][motor]:.3g}")
        if texts:
            text = (
                f"outliers of {name} among motors of one model: {listed(texts, _MAX_NAMES)} -> "
                "check load and wiring of these joints; the constant counts as not identified"
            )
            notes.append(Note("warning", text))
    return notes


def encoder_notes(
    model: GreyBox, z: np.ndarray, data: TrainingData, recipe: Recipe, fixed: np.ndarray
) -> list[Note]:
    """Warning that kp depends on the place of the encoder, which the logs do not state.

    A servo that controls its output shaft with kp deflects under a load as one that controls its
    rotor with kp/(1 - kp/k), k the stiffness of its gear. ``z`` (M, Z) are the latents of the
    motors, ``fixed`` (P,) marks constants that were not fitted: a stated kp needs no warning.
    """
    constants = parameters_of(model.terms)
    is_stated = data.at_rotor or "output_encoder" in dict(recipe.firmware)
    is_fixed = fixed[constants.index("kp")] or fixed[constants.index("gear_stiffness")]
    if is_stated or is_fixed or data.command_mode != "position":
        return []

    values = model.constants(z)
    logged = np.ma.array(data.series[..., channel.KP])
    if data.series.shape[-1] > channel.CHANNELS:  # rows without position control have no kp
        logged[data.series[..., channel.KP_FACTOR] == 0.0] = np.ma.masked
    kp = values["kp"] * np.ma.median(logged, axis=1).filled(0.0)
    share = float(np.median(kp / (kp + values["gear_stiffness"])))
    if share < _MIN_TWIST:
        return []
    text = (
        "kp, torque limit and armature hold for a servo whose encoder is on its rotor; kp of one "
        f"with the encoder on its output shaft, as most hobby servos have, is {100 * share:.0f} % "
        "lower -> state the place as output_encoder, 1 for such a servo and 0 for an encoder on "
        "the rotor: under [firmware] of the column map, or as --firmware of logs import"
    )
    return [Note("warning", text)]


def identifiability(
    model: GreyBox,
    z: np.ndarray,
    runs: WindowRuns,
    estimates: Estimates,
    joint_names: tuple[str, ...],
    level: ModelLevel | None,
) -> tuple[FitMetrics, list[Note]]:
    """What the logs identify, and warnings of what they do not.

    They are about constants, limits and the scale of torques. ``z`` (M, Z) are the latents of the
    motors, ``runs`` their logs, and ``estimates`` the uncertainty of their constants. A limit that
    the maker of a motor states, in ``level``, needs no warning.
    """

    def warning(is_hidden: np.ndarray, unidentified: str) -> Note:
        """Warning that the logs of the motors in a mask (M,) do not identify something."""
        joints = ""
        if joint_names:
            hidden_names = [joint_names[motor] for motor in np.flatnonzero(is_hidden)]
            joints = f" ({listed(hidden_names, _MAX_NAMES)})"
        count = is_hidden.sum()
        logs = f"the logs of {count} of {len(is_hidden)} motors{joints}"
        return Note("warning", f"{logs} do not identify {unidentified}")

    constants = parameters_of(model.terms)
    values = model.constants(z)
    identified_motors = estimates.identified(values, model.terms)
    identified = {name: bool(np.mean(mask) >= 0.5) for name, mask in identified_motors.items()}

    notes = []
    is_free = ~motor_problem.fixed_constants(model.terms, runs)
    at_bound = motor_problem.near_bounds(z, model.center) & is_free
    for name, is_hidden in zip(constants, at_bound.T, strict=True):
        if is_hidden.any():
            text = f"{name}: it is at the bound of the search -> do not interpret it"
            notes.append(warning(is_hidden, text))

    limits = {}
    for name in LIMITS:
        if name not in constants or not is_free[constants.index(name)]:
            continue
        is_hidden = ~identified_motors[name]
        if level is not None:
            is_hidden &= ~level.is_stated[level.index, constants.index(name)]
        if not is_hidden.any():
            continue
        limits[name] = float(values[name][is_hidden].max())
        text = f"the fitted {limit_text(name, limits[name])}; policies may over-rely on it"
        notes.append(warning(is_hidden, text))

    is_hidden = motor_problem.unknown_torque_scale(model, runs, z)
    if is_hidden.any():
        text = (
            "the scale of torques; only ratios of kp, torque limit, armature and friction are "
            "physical -> log kp in N·m/rad, or motions under larger loads; if the controller "
            "compensates the weight of the load, log this torque as torque_feedforward"
        )
        notes.append(warning(is_hidden, text))

    metrics = FitMetrics(
        identified=identified,
        unidentified_limits=limits,
        unknown_torque_scales=int(is_hidden.sum()),
    )
    return metrics, notes
