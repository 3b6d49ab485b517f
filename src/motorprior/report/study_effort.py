"""What the models of a study took to fit, and how the width of the randomised PD was chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.report.page import Section, Table
from motorprior.report.study_tables import percent

_CONSTANTS = {
    "kp": "kp", "kd": "kd", "torque_limit": "limit", "armature": "armature", "delay": "delay", "coulomb": "Coulomb",
}  # fmt: skip


@dataclass(frozen=True)
class Effort:
    """What a study took to fit.

    Attributes:
        fits: PDs of the bench: condition -> constants, error [rad], evaluations, converged, see `pd_fit.PdFit`.
        widths: what `study_spreads.with_spread` wrote; None where the width was told.
        robot_fits: PDs of one robot each, as those of ``fits``.
        seconds: what was fitted -> how long it took [s].
    """

    fits: Mapping[str, Any]
    widths: Mapping[str, Any] | None
    robot_fits: Sequence[Mapping[str, Any]]
    seconds: Mapping[str, float]


def effort_section(effort: Effort) -> Section:
    """A chapter of the page.

    Raises:
        KeyError, TypeError: the files are not what a study writes.
    """
    tables = [_fits_table(effort.fits), _seconds_table(effort.seconds)]
    if effort.widths is not None:
        tables.append(_widths_table(effort.widths))
    lead = f"{_converged(effort.fits)}{_robots_converged(effort.robot_fits)}"
    return Section("What the fits took", lead, tables=tuple(tables))


def _converged(fits: Mapping[str, Any]) -> str:
    open_ends = [name for name, fit in fits.items() if not fit["converged"]]
    if open_ends:
        return f"The fit of {', '.join(open_ends)} had not converged when its evaluations were used up."
    return "Every PD of the bench was fitted to its log until its search had converged."


def _robots_converged(fits: Sequence[Mapping[str, Any]]) -> str:
    """Nothing of a study without such PDs."""
    if not fits:
        return ""
    ended = sum(bool(fit["converged"]) for fit in fits)
    runs, error = (float(np.median([fit[name] for fit in fits])) for name in ("evaluations", "error"))
    return (
        f" Of the {len(fits)} PDs that are fitted to the log of one robot {ended} had converged, after {runs:.0f} runs "
        f"through it in the median, at an error of {1000.0 * error:.1f} mrad."
    )


def _fits_table(fits: Mapping[str, Any]) -> Table:
    columns = ("trained on", *_CONSTANTS.values(), "error [mrad]", "runs", "converged")
    rows = tuple(
        (
            name, *(fit["constants"].get(each) for each in _CONSTANTS), 1000.0 * fit["error"], fit["evaluations"],
            "yes" if fit["converged"] else "no",
        )
        for name, fit in fits.items()
    )  # fmt: skip
    caption = (
        "Constants of one PD for all motors of the bench: kp [N·m/rad], kd [N·m·s/rad], torque limit [N·m], armature "
        "[kg·m²], command delay [s], Coulomb friction [N·m]; its closed-loop error on the bench's log; runs through "
        "that log that its search took."
    )
    return Table(columns, rows, caption)


def _seconds_table(seconds: Mapping[str, float]) -> Table:
    rows = tuple(("PDs of the bench" if name == "fits" else name, taken) for name, taken in seconds.items())
    caption = (
        "Seconds on the clock, divided among what was fitted side by side. A prior has the name of its preset; rollout "
        "is that of all conditions that use the prior."
    )
    return Table(("fitted", "time [s]"), rows, caption)


def _widths_table(widths: Mapping[str, Any]) -> Table:
    columns = ("width", *(f"{what}, {where}" for where in ("there", "at home") for what in ("speed [m/s]", "upright")))
    rows = tuple(
        (
            f"±{percent(float(width))}{', chosen' if float(width) == widths['chosen'] else ''}",
            found["speed"], percent(found["upright"]), found["own_speed"], percent(found["own_upright"]),
        )
        for width, found in widths["tried"].items()
    )  # fmt: skip
    caption = (
        f"Widths of the randomised PD: how its policies walk on motors of the fleet “{widths['fleet']}”, which no twin "
        "has, and where they were trained. The one whose policies are upright there for longest is chosen."
    )
    return Table(columns, rows, caption)
