"""Sections of the demo's page: the answer, robustness on held-out robots, the simulations of the training."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_style import TEXT, describe, model_label, new_figure, panels
from motorprior.report.study import conditions_in, forest_plot, with_interval
from motorprior.studies.compare import FRICTIONS, PUSHES
from motorprior.studies.summary import COMPARED, OWN, OWN_FOREIGN, REFERENCE, Summary

BASELINES = ("ideal_pd", "friction_pd", "random_pd", "paper")
_PLACES = {"fleet": "other robots of the same fleet", "hard": "other motors, floor, load, delays and pushes"}
_AS_GOOD = 0.02  # difference of the time upright below which two conditions are called equal [-]


def answer(summary: Summary, speed: float, film: Picture) -> Section:
    """Question, result and uncertainty; the film; time upright, speed and transfer gap."""
    conditions = conditions_in(summary)
    policies = next(iter(summary.upright.values())).shape[1]
    asked = (
        f"Policies are trained in simulation on models of a robot's motors, and then walk robots that they have never "
        f"seen, commanded {speed:g} m/s: {'; '.join(f'{place}: {text}' for place, text in _PLACES.items())}."
    )
    sure = (
        f"95 % intervals over the robots, of {policies} policies per condition, all for one bench of motors. They "
        "contain no differences between trainings or benches; those of the study do (docs/transfer.md)."
    )
    table = Table(
        ("trained on", *(f"{place}: {name}" for place in _PLACES for name in ("upright [%]", "speed [m/s]", "gap"))),
        [(name, *(cell for place in _PLACES for cell in _cells(summary, place, name))) for name in conditions],
        "Means with 95 % intervals; gap: time upright in the training simulation minus that on held-out robots [%].",
    )
    drawn = picture(forest_plot(summary, conditions), "Time upright; hollow: in the training simulation.")
    return Section("What came out", (headline(summary), asked, sure), (drawn, film), (table,))


def headline(summary: Summary) -> str:
    """Time upright on held-out robots; says first if a baseline is as good as the prior."""

    def upright(place: str, name: str) -> float:
        return summary.estimates[place, name, "upright"].value

    def percent(name: str) -> str:
        return " and ".join(f"{100 * upright(place, name):.0f} % ({place})" for place in _PLACES)

    best = max(BASELINES, key=lambda name: sum(upright(place, name) for place in _PLACES))
    equal = all(upright(place, best) > upright(place, REFERENCE) - _AS_GOOD for place in _PLACES)
    first = f"Here a simpler model is as good as the learned prior: the {model_label(best)}. " if equal else ""
    return (
        f"{first}Policies trained on samples of the learned motor prior are upright for {percent(REFERENCE)} of the "
        f"time on robots they have never seen; trained on an ideal PD for {percent('ideal_pd')}; on the best of the "
        f"baselines, the {model_label(best)}, for {percent(best)}."
    )


def _cells(summary: Summary, place: str, condition: str) -> list[str]:
    own = OWN if place == "fleet" or (OWN_FOREIGN, condition) not in summary.upright else OWN_FOREIGN
    speed, upright = (summary.estimates[place, condition, measure] for measure in COMPARED)
    gap = summary.estimates[own, condition, "upright"].value - upright.value
    return [with_interval(upright, 100.0, ".0f"), with_interval(speed, 1.0, ".2f"), f"{100.0 * gap:+.0f}"]


def robustness(maps: Mapping[str, np.ndarray]) -> Section:
    """Condition -> (pushes, frictions) time upright [-], on one scale."""
    text = "Held-out robots of the fleet with stronger pushes and other floors than in any training, walks of 5 s."
    caption = "Time upright [%], over all policies."
    return Section("Robustness on held-out robots", (text,), (picture(_heat_maps(maps), caption),))


def _heat_maps(maps: Mapping[str, np.ndarray]) -> Figure:
    figure = new_figure(2.6)
    for column, (axes, (name, values)) in enumerate(
        zip(panels(figure, 1, len(maps), sharey=True)[0], maps.items(), strict=True)
    ):
        axes.imshow(values, vmin=0.0, vmax=1.0, cmap="Blues", origin="lower", aspect="auto")
        axes.grid(False)
        for row, line in enumerate(values):
            for at, value in enumerate(line):
                ink = "white" if value > 0.6 else "black"
                axes.text(at, row, f"{100 * value:.0f}", ha="center", va="center", fontsize=TEXT, color=ink)
        axes.set_xticks(range(len(FRICTIONS)), [f"{each:g}" for each in FRICTIONS])
        axes.set_yticks(range(len(PUSHES)), [f"{each:g}" for each in PUSHES])
        y = "largest push [N·s]" if column == 0 else None
        describe(axes, x="friction of the floor [-]", y=y, title=model_label(name))
    return figure
