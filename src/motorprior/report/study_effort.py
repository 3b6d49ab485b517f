"""What the PDs of a study took to fit, and how the width of the randomised one was chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from motorprior.report.page import Section, Table
from motorprior.report.study_tables import percent

_CONSTANTS = {
    "kp": "kp", "kd": "kd", "torque_limit": "limit", "armature": "armature", "delay": "delay", "coulomb": "Coulomb",
}  # fmt: skip


def effort_section(fits: Mapping[str, Any], widths: Mapping[str, Any] | None) -> Section:
    """A chapter of the page.

    Args:
        fits: condition -> constants, error [rad], evaluations, converged, see `pd_fit.PdFit`.
        widths: what `study_spreads.with_spread` wrote; None where the width was told.

    Raises:
        KeyError, TypeError: the files are not what a study writes.
    """
    open_ends = [name for name, fit in fits.items() if not fit["converged"]]
    lead = "Every PD of the bench was fitted to its log until its search had converged."
    if open_ends:
        lead = f"The fit of {', '.join(open_ends)} had not converged when its evaluations were used up."
    tables = (_fits_table(fits),) if widths is None else (_fits_table(fits), _widths_table(widths))
    return Section("What the PDs took", lead, tables=tables)


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
