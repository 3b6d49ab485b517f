"""Tables of a study: one row per condition, the same numbers on the page and in Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from motorprior.report.page import MINUS, Cell, Table
from motorprior.report.plots_style import model_key, model_label
from motorprior.transfer.statistics import SURE, Estimate
from motorprior.transfer.study_summary import Summary
from motorprior.transfer.study_verdicts import (
    COMPARED,
    LEAST_UPRIGHT,
    MEASURES,
    PRIOR,
    STEPS,
    Pairing,
    Verdict,
)
from motorprior.transfer.walk_table import OWN, OWN_ABROAD

PLACES = {
    OWN: "own simulation", OWN_ABROAD: "own, foreign motors", "foreign": "foreign motors", "hard": "hard",
    "pybullet": "PyBullet",
}  # fmt: skip
"""Titles of places; any other place has its own name."""
LESS, MORE = "↓", "↑"
_NO_BREAK = "\u00a0"
_PATH = {
    "distance": "distance before a fall", "heading_deg_per_m": "heading error", "lateral_share": "sideways per metre",
    "drift": "sideways at the end", "slip": "slip", "transport": "cost of transport",
    "torque_beyond": "torque beyond the limit",
}  # fmt: skip
_LEGS = {"step_frequency": "step frequency", "body_rate": "shaking of the body", "foot_lift_mm": "foot lift"}


def place_title(place: str) -> str:
    """What a reader sees in place of its name."""
    return PLACES.get(place, place.replace("_", " "))


def headline_caption() -> str:
    """What the cells of `headline_rows` are."""
    return (
        "Speed [m/s], interquartile mean of policies and draws, share of the time upright, both with 95 % intervals, "
        "and how far to the side of its way a walk ends [m], interquartile mean. "
        f"{LESS} less, {MORE} more than that of the sampled prior there: p < {SURE:g}, corrected, and 0 outside of "
        "the difference's interval; what was adapted is compared on the robots that it was adapted to, the gait not "
        "at all. The way to the side is that of walks without a fall, and not compared: who falls more keeps easier "
        "walks."
    )


def headline_rows(summary: Summary) -> list[list[str]]:
    """Name of every condition, and a cell per place."""
    return [
        [condition, *(_headline(summary, place, condition) for place in summary.places())]
        for condition in summary.conditions()
    ]


def headline_markdown(summary: Summary) -> str:
    """`headline_rows` as a Markdown table, and its caption."""
    header = ["trained on", *(place_title(place) for place in summary.places())]
    rows = [[model_label(row[0]), *row[1:]] for row in headline_rows(summary)]
    lines = [header, ["---"] * len(header), *rows]
    escaped = [[cell.replace("|", "\\|").replace(_NO_BREAK, " ") for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in escaped) + f"\n\n{headline_caption()}\n"


def verdicts_markdown(verdicts: Sequence[Verdict], said: str) -> str:
    """Verdicts as a Markdown table."""
    lines = [(said, "holds", "found"), ("---", "---", "---")]
    lines += [(each.said, verdict_word(each), each.found) for each in verdicts]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def headline_table(summary: Summary) -> Table:
    """`headline_rows` for the page."""
    columns = ("trained on", *(place_title(place) for place in summary.places()))
    rows = tuple((_name(row[0]), *row[1:]) for row in headline_rows(summary))
    return Table(columns, rows, headline_caption())


def twin_table(summary: Summary, twin: str) -> Table:
    """All about the speed on one twin."""
    columns = (
        "trained on", "speed [m/s]", "of its own speed", "behind the oracle [m/s]",
        "behind the prior [m/s]", "slower walks", "p",
    )  # fmt: skip
    rows = tuple((_name(name), *_twin_cells(summary, twin, name)) for name in _conditions_at(summary, twin))
    caption = (
        f"Twin “{place_title(twin)}”: interquartile means with 95 % intervals. Of its own speed: of that where it was "
        "trained; oracle and what was adapted were trained for the twin's own population. Behind: how much slower it "
        "is. Slower walks: chance that a walk is slower than one of the sampled prior on the same draw. p: two-sided, "
        "of no difference from the sampled prior, by permutation of the policies, after Holm over its family: what "
        "targets ask, the steps of “What counts”, or all other conditions. "
        "What was adapted is compared on the robots that it was adapted to."
    )
    return Table(columns, rows, caption)


def standing_table(summary: Summary) -> Table:
    """How many policies stand at every place: what an interquartile mean leaves out."""
    places = summary.homes() + summary.twins()
    columns = ("trained on", *(place_title(place) for place in places))
    rows = tuple(
        (_name(name), *(_percent_or_none(summary.standing.get((place, name))) for place in places))
        for name in summary.conditions()
    )
    caption = (
        f"Share of the policies that are upright for {100 * LEAST_UPRIGHT:.0f} % of the time: an interquartile mean "
        "hides that one policy of eight fell."
    )
    return Table(columns, rows, caption)


def measure_tables(summary: Summary, place: str, legs: Sequence[str]) -> list[Table]:
    """The other measures at a place: of the way, and of the legs."""
    lifts = {f"foot_lift_mm/{leg}": f"foot lift {leg}" for leg in legs}
    kinds = {"the way": _PATH, "the legs": _LEGS | lifts}
    found, conditions = [], _conditions_at(summary, place)
    for kind, titles in kinds.items():
        names = [name for name in titles if any((place, each, name) in summary.estimates for each in conditions)]
        if names:
            columns = ("trained on", *(f"{titles[name]} {_unit(name, lifts)}" for name in names))
            rows = tuple(
                (_name(condition), *(_value(summary, place, condition, name) for name in names))
                for condition in conditions
            )
            found.append(
                Table(columns, rows, f"At “{place_title(place)}”, {kind}: interquartile means; – is not known.")
            )
    return found


def step_tables(summary: Summary) -> list[Table]:
    """What each of STEPS adds on every twin: a table per measure that is compared."""
    twins, found = summary.twins(), []
    for measure, told in COMPARED.items():
        rows = [
            (f"{model_label(before)} → {model_label(after)}: {adds}", *cells)
            for before, after, adds in STEPS
            if any(cells := [_step(summary, Pairing(twin, after, before, measure)) for twin in twins])
        ]
        if rows:
            columns = ("step", *(place_title(twin) for twin in twins))
            more = f"How much {told.more} [{told.unit}], with 95 % interval"
            caption = f"{more}; * where that is without 0 and p < {SURE:g}, corrected over all steps."
            found.append(Table(columns, tuple(rows), caption))
    return found


def _step(summary: Summary, pairing: Pairing) -> str | None:
    compared = summary.comparisons.get(pairing)
    if compared is None or not math.isfinite(compared.difference.value):
        return None
    factor, digits = (100.0, 1) if COMPARED[pairing.measure].unit == "points" else (1.0, 3)
    value, low, high = (_signed(factor * each, digits) for each in _ends(compared.difference))
    mark = "*" if compared.is_sure(summary.corrected[pairing]) else ""
    return f"{value}{mark} [{low},{_NO_BREAK}{high}]"


def _signed(value: float, digits: int) -> str:
    """With its sign, and 0 without one."""
    rounded = round(value, digits) + 0.0
    return f"{rounded:+.{digits}f}".replace("-", MINUS) if rounded else f"{0.0:.{digits}f}"


def verdict_table(verdicts: Sequence[Verdict], said: str, caption: str) -> Table:
    """What was said, whether it holds, and what was found."""
    rows = tuple((each.said, verdict_word(each), each.found) for each in verdicts)
    return Table((said, "holds", "found"), rows, caption)


def verdict_word(verdict: Verdict) -> str:
    """Whether it holds, for readers."""
    return {True: "holds", False: "does not", None: "cannot be told"}[verdict.holds]


def _conditions_at(summary: Summary, place: str) -> list[str]:
    return [name for name in summary.conditions() if (place, name, "speed") in summary.estimates]


def _headline(summary: Summary, place: str, condition: str) -> str:
    speed = summary.estimates.get((place, condition, "speed"))
    if speed is None:
        return "–"
    parts = [_with_interval(speed, _sign(summary, place, condition, "speed"))]
    upright, drift = (summary.estimates.get((place, condition, measure)) for measure in ("upright", "drift"))
    if upright is not None:
        parts.append(_percent_with_interval(upright, _sign(summary, place, condition, "upright")))
    if drift is not None:
        parts.append(_metres(drift.value))
    return ", ".join(parts)


def _sign(summary: Summary, place: str, condition: str, measure: str) -> str:
    """Whether it is beyond doubt less or more than the prior's."""
    pairing = Pairing(place, PRIOR, condition, measure)
    compared = summary.comparisons.get(pairing)
    if compared is None or not compared.is_sure(summary.corrected[pairing]):
        return ""
    return LESS if compared.difference.value > 0.0 else MORE


def _twin_cells(summary: Summary, twin: str, condition: str) -> list[Cell]:
    pair = (twin, condition)
    ratio, regret = summary.ratios.get(pair), summary.regrets.get(pair)
    pairing = Pairing(twin, PRIOR, condition, "speed")
    compared = summary.comparisons.get(pairing)
    return [
        _with_interval(summary.estimates[*pair, "speed"]),
        None if ratio is None or not math.isfinite(ratio.value) else f"{ratio.value:.2f}",
        None if regret is None else _with_interval(regret),
        None if compared is None else _with_interval(compared.difference),
        None if compared is None or not math.isfinite(compared.improvement) else percent(compared.improvement),
        None if compared is None else _p(summary.corrected[pairing]),
    ]


def _with_interval(found: Estimate, sign: str = "") -> str:
    """0.41 [0.38, 0.44], a sign behind the first; the bracket may go to the next line, but not break."""
    value, low, high = (f"{each:.2f}".replace("-0.00", "0.00").replace("-", MINUS) for each in _ends(found))
    return f"{value}{sign} [{low},{_NO_BREAK}{high}]"


def _percent_with_interval(found: Estimate, sign: str = "") -> str:
    """96 %↓ [91, 99]."""
    low, high = (percent(end).removesuffix(f"{_NO_BREAK}%") for end in (found.low, found.high))
    return f"{percent(found.value)}{sign} [{low},{_NO_BREAK}{high}]"


def _ends(found: Estimate) -> tuple[float, float, float]:
    return found.value, found.low, found.high


def percent(value: float) -> str:
    """99.6 is not 100: only what is whole is called so."""
    whole = f"{math.floor(100.0 * value + 1e-9):.0f}" if value > 0.99 else f"{100.0 * value:.0f}"
    return f"{whole}{_NO_BREAK}%"


def _percent_or_none(share: float | None) -> str | None:
    return None if share is None else percent(share)


def _metres(value: float) -> str:
    return f"{value:.2f}{_NO_BREAK}m"


def _p(value: float) -> str:
    return f"{value:.3f}" if value >= 0.001 else "< 0.001"


def _value(summary: Summary, place: str, condition: str, measure: str) -> float | None:
    found = summary.estimates.get((place, condition, measure))
    return None if found is None else found.value


def _unit(name: str, lifts: dict[str, str]) -> str:
    unit = MEASURES["foot_lift_mm" if name in lifts else name]
    return "[-]" if unit == "1" else f"[{unit}]"


def _name(condition: str) -> str:
    """What the page turns into the name and the colour of a condition; a user's own name without underscores."""
    return condition if model_key(condition) else model_label(condition)
