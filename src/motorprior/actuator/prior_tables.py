"""Tables of a motor prior for people: estimates of its motors, and ranges between units."""

from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.constants import (
    COLUMNS,
    ESTIMATE,
    PER_LOGGED_GAIN,
    RANGE,
    UNITS,
    Estimate,
    named_constants,
)
from motorprior.actuator.estimates import COMBINATIONS, MAX_RATIO
from motorprior.actuator.grey_box import GreyBox
from motorprior.exceptions import listed
from motorprior.logs.motor_log import PHYSICAL_GAINS
from motorprior.texts import Overview

if TYPE_CHECKING:
    from motorprior.actuator.motor_prior import MotorPrior

SPREAD = "spread"  # entry of the provenance: `standardise.spread_source`
MAX_JOINT_COLUMNS = 6  # maximum number of joints that have a column each in the overview
Table = tuple[Sequence[str], Sequence[Sequence[str]]]


def spread_facts(prior: "MotorPrior") -> dict[str, str]:
    """See `MotorPrior.spread_facts`."""
    spread = prior.provenance.get(SPREAD)
    if not spread:
        return {}

    units_of_class = spread["units"]
    has_classes = len(units_of_class) > 1
    units = [f"{name or 'all joints'} {count}" for name, count in units_of_class.items()]
    facts = {"measured": f"mean of each class of joints (units: {', '.join(units)})"}
    freedom = f"{spread['degrees_of_freedom']} degrees of freedom"
    if has_classes:
        freedom = f"pooled over {len(units_of_class)} classes, {freedom}"
    facts["spread between units"] = freedom
    if spread["assumed_units"]:
        worth = f"assumed, worth {spread['assumed_units']:g} units"
        facts[worth] = f"the spread of {spread['source']}"
    if has_classes:
        facts["a class that was not recorded"] = "mean of all classes and the spread between them"
    return facts


def spread_origin(prior: "MotorPrior") -> str:
    """Where the range between units comes from, in a few words."""
    spread = prior.provenance.get(SPREAD)
    if not spread:
        return ""
    motors = sum(spread["units"].values())
    if not spread["assumed_units"]:
        return f"measured on {motors}"
    if spread["degrees_of_freedom"] > 0:
        return f"pooled: {motors} motors and an assumed spread"
    return "assumed"


def motors_of(prior: "MotorPrior", joint_name: str | None, joint_class: str | None) -> np.ndarray:
    """Indices of the training motor with this name, of a class, or of all motors."""
    if joint_name in prior.joint_names:
        return np.array([prior.joint_names.index(joint_name)])
    if joint_class is None:
        return np.arange(len(prior.mean))
    return prior.classes.rows_of(joint_class)


def intervals(prior: "MotorPrior", level: float) -> dict[str, np.ndarray]:
    """See `MotorPrior.intervals`."""
    if prior.estimates is None or not isinstance(prior.model, GreyBox):
        return {}
    score = NormalDist().inv_cdf(0.5 + 0.005 * level)
    terms = prior.model.terms
    ends = prior.estimates.ends(prior.model.constants(prior.mean), terms, score)
    # at the logged gains, as the constants
    return {
        _shown_name(prior, name): _gain_factor(prior, name) * ends[name]
        for name in prior.estimates.fitted(terms)
    }


def estimates(prior: "MotorPrior", motors: np.ndarray) -> dict[str, Estimate]:
    """Estimates of the fitted constants of training ``motors`` (indices), by name.

    Of several motors, they are medians of the values and of both ends of the intervals. A constant
    is then identified if the logs of at least half of the motors identify it.
    """
    if prior.estimates is None or not isinstance(prior.model, GreyBox):
        return {}
    terms = prior.model.terms
    values = prior.model.constants(prior.mean)
    is_identified = prior.estimates.identified(values, terms)
    ends = intervals(prior, 90.0)
    of_constants = {}
    for name in prior.estimates.fitted(terms):
        shown = _shown_name(prior, name)
        value = _gain_factor(prior, name) * values[name]
        of_constants[shown] = _median_estimate(value, ends[shown], is_identified[name], motors)
    return of_constants


def unreached_torque_limits(prior: "MotorPrior") -> dict[str, float]:
    """Largest logged torque [N·m] of each class whose logs do not reach a torque limit."""
    limits = {}
    for name in prior.classes.names:
        estimate = estimates(prior, prior.classes.rows_of(name)).get("torque_limit")
        if estimate is not None and np.isinf(estimate.high):
            limits[name] = estimate.low
    return limits


def combination_estimates(prior: "MotorPrior", motors: np.ndarray) -> dict[str, Estimate]:
    """Estimates of COMBINATIONS of constants, by their formulas; otherwise as `estimates`.

    There are none if gains are logged.
    """
    if prior.estimates is None or not isinstance(prior.model, GreyBox) or prior.model.gain_unit:
        return {}
    values = prior.model.constants(prior.mean)
    ends = prior.estimates.combination_ends(values, prior.model.terms)
    of_combinations = {}
    for combination in COMBINATIONS:
        low, high = ends[combination.name]
        of_combinations[f"{combination.text} [{combination.unit}]"] = _median_estimate(
            combination.value(values), ends[combination.name], high < MAX_RATIO * low, motors
        )
    return of_combinations


def _median_estimate(
    value: np.ndarray, ends: np.ndarray, is_identified: np.ndarray, motors: np.ndarray
) -> Estimate:
    low, high = np.median(ends[:, motors], axis=1).tolist()
    identified = bool(np.mean(is_identified[motors]) >= 0.5)
    return Estimate(float(np.median(value[motors])), low, high, identified)


def _shown_name(prior: "MotorPrior", name: str) -> str:
    """Name of a decoded constant in tables: a multiple of a logged gain has a suffix."""
    if prior.command_mode == "velocity" and name == "kd_over_kp":
        name = "kd"  # kp has no meaning
    gains = None if prior.gains is None else prior.gains[:, :1]
    shown = named_constants(prior.model, prior.mean[:1], gains)
    return name if name in shown else f"{name}{PER_LOGGED_GAIN}"


def _gain_factor(prior: "MotorPrior", name: str) -> np.ndarray | float:
    """(M,) factor from a decoded constant to that of the training motors."""
    if prior.command_mode == "velocity" and isinstance(prior.model, GreyBox):
        return prior.model.constants(prior.mean)["kp"] if name == "kd_over_kp" else 1.0
    if prior.gains is None or prior.model.gain_unit != PHYSICAL_GAINS:
        return 1.0
    kp, kd = prior.gains
    return {"kp": kp, "kd_over_kp": kd / kp}.get(name, 1.0)


def overview(prior: "MotorPrior") -> Overview:
    """See `MotorPrior.overview`."""
    model_name = "grey box" if isinstance(prior.model, GreyBox) else "network"
    model = (
        f"{model_name}, {prior.model.num_latents} latents, "
        f"physics steps up to {1e3 * prior.model.period:g} ms"
    )
    metrics = prior.metrics
    minutes = ""
    if metrics.minutes_of_log is not None:
        minutes = f"{metrics.minutes_of_log:.3g} minutes of motors"
    replayed = ""
    if metrics.replay_rmse is not None:
        replayed = f"{1e3 * metrics.replay_rmse:.1f} mrad"
    facts = {
        "robot": prior.robot or "none stated",
        "motor": prior.motor,
        "preset": prior.preset,
        "model": model,
        "commands of the logs": prior.command_mode,
        "logs": minutes,
        "joints": listed(prior.joint_names, 8),
        **spread_facts(prior),
        "replayed logs, median error": replayed,
    }
    headline = f"motor prior of {len(prior.mean)} motors"
    if prior.estimates is not None:
        columns, rows = estimate_table(prior)
        return Overview(headline, facts, columns, rows, (_range_table(prior),))
    if len(prior.classes.names) == 1:
        return Overview(headline, facts, COLUMNS, prior.constants().cells)
    return Overview(headline, facts, *_range_table(prior))


def estimate_table(prior: "MotorPrior") -> Table:
    """Estimates and their intervals: a column per joint, or per class of many joints.

    The last rows are combinations that are identified for a column while a part of them is not.
    """
    columns = {name: np.array([row]) for row, name in enumerate(prior.joint_names)}
    if not 0 < len(columns) <= MAX_JOINT_COLUMNS:
        columns = {
            f"median of {name or 'all motors'}": prior.classes.rows_of(name)
            for name in prior.classes.names
        }
    of_columns = [estimates(prior, motors) for motors in columns.values()]
    rows = []
    for name in of_columns[0]:
        rows.append([name, UNITS[name], *_texts(of_columns, name)])

    combined = [combination_estimates(prior, motors) for motors in columns.values()]
    for combination in COMBINATIONS:
        text = f"{combination.text} [{combination.unit}]"
        needed = [
            _is_needed(of_constants, of_combinations.get(text), combination.parts)
            for of_constants, of_combinations in zip(of_columns, combined, strict=True)
        ]
        if any(needed):
            rows.append([combination.text, combination.unit, *_texts(combined, text)])
    return (ESTIMATE, "unit", *columns), rows


def _is_needed(
    of_constants: Mapping[str, Estimate], combined: Estimate | None, parts: tuple[str, ...]
) -> bool:
    """Whether a combination is identified, but one of its parts is not."""
    if combined is None or not combined.is_identified:
        return False
    return any(name in of_constants and not of_constants[name].is_identified for name in parts)


def _texts(of_columns: Sequence[Mapping[str, Estimate]], name: str) -> list[str]:
    return [str(of_column[name]) for of_column in of_columns]


def _range_table(prior: "MotorPrior") -> Table:
    """Ranges between units, a column per class of joints."""
    names = prior.classes.names
    tables = [prior.constants(name) for name in names]
    rows = []
    for constant_of_classes in zip(*tables, strict=True):
        first = constant_of_classes[0]
        cells = [row.range_text for row in constant_of_classes]
        rows.append([first.name, first.unit, *cells])
    origin = spread_origin(prior)
    title = f"{RANGE}, {origin}" if origin else RANGE
    return (title, "unit", *(name or "all joints" for name in names)), rows
