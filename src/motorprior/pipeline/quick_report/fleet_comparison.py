"""Constants of real motors beside those of a fleet, and beside each other, in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from motorprior.bench.fleet import Fleet
from motorprior.report.real_motor_tables import CONSTANT, UNIDENTIFIED
from motorprior.results import Result, Results

DRAWS = 400
"""Of the fleet."""
LEVELS = {"p05": 0.05, "p50": 0.5, "p95": 0.95}
ALIKE = 1.05
"""Largest over smallest value of a constant up to which motors count as equal; then the logs do not show it, unless
they are sensitive to it (`physics.identifiability`)."""
TOLD = 3
"""Most constants in which motors are said to differ from each other."""


def fleet_results(fleet: Fleet, constants: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Results:
    """Quantiles of the fleet's draws, of the constants in which its motors differ."""
    return Results.of(
        Result(f"{CONSTANT}{name}", units[name], float(np.quantile(values, level)), fleet.name, statistic=statistic)
        for name, values in _draws(fleet, constants).items()
        for statistic, level in LEVELS.items()
    )


def beside_the_fleet(fleet: Fleet, constants: Mapping[str, np.ndarray], units: Mapping[str, str]) -> str:
    """A sentence: of which constants the motors' median is outside the 90 % of the fleet's draws."""
    outside, inside = [], []
    for name, values in _draws(fleet, constants).items():
        (low, high), median = np.quantile(values, [0.05, 0.95]), float(np.median(constants[name]))
        if low <= median <= high:
            inside.append(name)
        else:
            outside.append(f"{name} {median:.3g} {units[name]} (there {low:.3g} to {high:.3g})")
    said = f"beside fleet {fleet.name!r}, your median motor is outside 90 % of it in "
    said += "; ".join(outside) if outside else "nothing"
    return said + (f"; inside in {', '.join(inside)}" if inside else "")


def shown_by_logs(constants: Mapping[str, np.ndarray], identifiable: Collection[str]) -> dict[str, np.ndarray]:
    """The constants that the logs identify, or in which the motors differ by more than ALIKE."""
    return {name: values for name, values in constants.items() if name in identifiable or _ratio(values) > ALIKE}


def not_shown_results(constants: Mapping[str, np.ndarray], shown: Collection[str], units: Mapping[str, str]) -> Results:
    """A row for each constant that is not ``shown``, with the motors' median."""
    return Results.of(
        Result(f"{CONSTANT}{name}", units[name], float(np.median(values)), statistic=UNIDENTIFIED)
        for name, values in constants.items()
        if name not in shown
    )


def beside_each_other(
    constants: Mapping[str, np.ndarray], shown: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> str:
    """A sentence: the constants in which the motors differ most, and those that the logs do not show.

    Of one motor, all that are ``shown``.
    """
    if all(len(values) == 1 for values in constants.values()):
        values = [f"{name} {float(value[0]):.3g} {units[name]}" for name, value in shown.items()]
        said = f"your motor has {', '.join(values)}" if values else "the logs tell no constant of your motor"
    else:
        said = _differences({name: values for name, values in shown.items() if _ratio(values) > ALIKE}, units)
    hidden = [name for name in constants if name not in shown]
    return said + (f"; not shown by the logs: {', '.join(hidden)}" if hidden else "")


def _differences(apart: Mapping[str, np.ndarray], units: Mapping[str, str]) -> str:
    most = sorted(apart, key=lambda name: -_ratio(apart[name]))[:TOLD]
    differ = [f"{name} ({np.min(apart[name]):.3g} to {np.max(apart[name]):.3g} {units[name]})" for name in most]
    return f"your motors differ most in {', '.join(differ)}" if differ else "no constant tells your motors apart"


def _ratio(values: np.ndarray) -> float:
    return float(np.max(values) / max(np.min(values), 1e-12))


def _draws(fleet: Fleet, constants: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(DRAWS,) of the constants that differ within the fleet; those of one do not depend on what others there are."""
    known = {name: fleet.parameters[name] for name in constants if name in fleet.parameters}
    return {
        name: found.sample(np.random.default_rng([*name.encode()]), DRAWS)
        for name, found in known.items()
        if found.kind != "constant"
    }
