"""The chapters of a study's page: targets first, then speeds, other measures, the paper's claims, and gaits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.report.gait_sections import gait_pictures
from motorprior.report.page import Section, picture
from motorprior.report.plots_forest import forest, profiles
from motorprior.report.study_tables import (
    headline_table,
    measure_tables,
    percent,
    place_title,
    standing_table,
    step_tables,
    twin_table,
    verdict_table,
)
from motorprior.robots.robot import Robot
from motorprior.transfer.statistics import SURE, iqm
from motorprior.transfer.study_summary import ENOUGH_DRAWS, ENOUGH_POLICIES, Summary
from motorprior.transfer.study_verdicts import DECIDING, ORACLE, PRIOR, RIVALS, TWINS_WON, UNTRAINED, home_of
from motorprior.transfer.walk_table import OWN, WalkTable

_FILMED = (PRIOR, RIVALS[-1], ORACLE)
"""Conditions whose walk on the first twin is also shown moving."""


def study_sections(
    table: WalkTable, summary: Summary, traces: Mapping[str, np.ndarray], robot: Robot, control_dt: float
) -> tuple[Section, ...]:
    """All chapters.

    Args:
        table: of walks.
        summary: of the same table.
        traces: "PLACE/CONDITION" -> (steps, 7 + joints) base position, quaternion and joint angles of a walk.
        robot: that walked.
        control_dt: time between rows of a trace [s].
    """
    legs = [leg.name for leg in robot.legs]
    return (
        _targets(summary), _speeds(table, summary), *_steps(summary), _measures(summary, legs), _claims(summary),
        *_gaits(summary, traces, robot, control_dt),
    )  # fmt: skip


def first_paragraph(summary: Summary) -> str:
    """Which targets do not hold and why, then which cannot be told and what was found, then which hold.

    Of a study of few policies or walks only that it decides nothing.
    """
    if not summary.decides:
        has = f"{summary.policies} policies per condition and {summary.draws} walks of each at a twin"
        few = f"This study decides nothing: it has {has}; {ENOUGH_POLICIES} and {ENOUGH_DRAWS} are asked."
        return " ".join((few, "What they did is told below.", *_beside_the_gait(summary)))
    parts = []
    for holds, words in ((False, "do not hold"), (None, "cannot be told"), (True, "hold")):
        found = [each for each in summary.targets if each.holds is holds]
        if found:
            texts = "; ".join(each.said if each.holds else f"{each.said} ({each.why or each.found})" for each in found)
            parts.append(f"{len(found)} of {len(summary.targets)} targets {words}: {texts}.")
    return " ".join((*parts, *_beside_the_gait(summary)))


def _beside_the_gait(summary: Summary) -> list[str]:
    """What walks without any training, which every target has to be read beside."""
    found = []
    for twin in summary.twins():
        speed, upright = (summary.estimates.get((twin, UNTRAINED, name)) for name in ("speed", "upright"))
        if speed is not None and upright is not None:
            found.append(f"{place_title(twin)} {speed.value:.2f} m/s, {percent(upright.value)} upright")
    return [f"The gait that nothing trained: {'; '.join(found)}."] if found else []


def _targets(summary: Summary) -> Section:
    caption = (
        "The prior: sampled or adapted, and one of the two has all that is asked. Shares of speed and of time are "
        "judged by the estimate, whatever its interval. Better than a PD: with "
        f"p < {SURE:g} on {TWINS_WON} of the twins {', '.join(DECIDING)}, by permutation of the policies and after "
        "Holm over all these comparisons, with 0 outside of the interval; and worse on none, where "
        f"p < {SURE:g} without any correction is a loss, and so are 5 points or 0.05 m/s less, whatever their p."
    )
    table = verdict_table(summary.targets, "target", caption)
    return Section("Targets", "What was aimed at, and what was found.", tables=(table,))


def _speeds(table: WalkTable, summary: Summary) -> Section:
    twins, conditions = summary.twins(), summary.conditions()
    speeds = {
        place: {name: found for name in conditions if (found := summary.estimates.get((place, name, "speed")))}
        for place in summary.places()
    }
    pictures = []
    if twins:
        titled = {place_title(twin): speeds[twin] for twin in twins}
        own = {place_title(twin): own_speeds(table, twin) for twin in twins}
        walks = {place_title(twin): _all_speeds(table, twin, conditions) for twin in twins}
        pictures = [
            picture(forest(titled, own, conditions), "Speed on every twin, by what was trained on.", "speeds"),
            picture(profiles(walks), "Share of the walks faster than a speed: higher is better.", "profiles of speed"),
        ]
    body = (
        "Every policy walks the same draws of motors and conditions at a place, but those of the adapted prior and of "
        "the adapted PD, which meet the robot that they were adapted to. An interval resamples policies and draws "
        "together.",
    )
    standing = (standing_table(summary),) if summary.standing else ()
    tables = (headline_table(summary), *standing, *(twin_table(summary, twin) for twin in twins))
    return Section("Speed", "How fast every policy is on robots it never saw.", body, tuple(pictures), tables)


def _all_speeds(table: WalkTable, twin: str, conditions: list[str]) -> dict[str, np.ndarray]:
    """Condition, of those that walked there -> (seeds, draws) [m/s]."""
    found = {name: table.scores(twin, name, "speed") for name in conditions}
    return {name: speeds for name, speeds in found.items() if speeds.size}


def own_speeds(table: WalkTable, twin: str) -> dict[str, float]:
    """Condition -> speed where its policies at a twin were trained [m/s]."""
    known = {(walk.place, walk.condition) for walk in table.walks}
    homes = {name: home_of(twin, name, known) for name in table.at(twin).distinct("condition")}
    return {name: iqm(table.scores(*home, "speed")) for name, home in homes.items() if home in known}


def _steps(summary: Summary) -> list[Section]:
    body = (
        "Rows but the last go from a tuned PD to the oracle. What changes from one to the next is what the motors of "
        "training are; the oracle's, besides, are simulated at the physics step of the twins, which is shorter. "
        "The last three compare walks on the robots that policies were adapted to. The last row stands aside: two "
        "ways to use the same log, compared robot by robot.",
    )
    lead = "What each step from a tuned PD to true motors adds where no policy was trained."
    tables = tuple(step_tables(summary))
    return [Section("What counts", lead, body, tables=tables)] if tables else []


def _measures(summary: Summary, legs: list[str]) -> Section:
    tables = [table for place in summary.places() for table in measure_tables(summary, place, legs)]
    body = (
        "Per metre means per metre walked. What is measured along the way leaves out walks that fell within the first "
        "two and a half seconds.",
    )
    return Section("How they walk", "What else an owner sees.", body, tables=tuple(tables))


def _claims(summary: Summary) -> Section:
    caption = (
        "Policies of the paper's recipe against those of the ideal PD. Where the recipe's robot does not walk at home, "
        "all are told of the paper's loss on our data, or else of the sampled prior, another learned actuator. "
        "P values by permutation of the policies, after Holm over the claims."
    )
    table = verdict_table(summary.claims, "the paper says", caption)
    return Section("The paper's claims", "What the paper says of its learned motors.", tables=(table,))


def _gaits(summary: Summary, traces: Mapping[str, np.ndarray], robot: Robot, control_dt: float) -> list[Section]:
    """A chapter per place of which there are traces; the few that move are of the first twin."""
    found, filmed = [], next(iter(summary.twins()), None)
    for place in summary.places():
        shown = {name: traces[f"{place}/{name}"] for name in summary.conditions() if f"{place}/{name}" in traces}
        title = place_title(place)
        where = "in its own simulation" if place == OWN else f"on the twin “{title}”"
        pictures = [
            image
            for name, trace in shown.items()
            for image in gait_pictures(robot, trace, control_dt, name, where, place == filmed and name in _FILMED)
        ]
        if pictures:
            lead = "The walk of median speed of each condition's first policy: frames, and which foot is on the ground."
            found.append(Section(f"Gaits: {title}", lead, pictures=tuple(pictures)))
    return found
