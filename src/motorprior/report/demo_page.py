"""Sections of the demo's page: results on held-out robots, and their robustness."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.page import Picture, Section, picture
from motorprior.report.plots_style import TEXT, model_label, new_figure, panels, set_labels
from motorprior.report.transfer_page import METRICS, conditions_in, estimate_table, forest_plot
from motorprior.studies.compare import FRICTIONS, PUSHES
from motorprior.studies.statistics import IN_TRAINING, SAMPLED_PRIOR, StudyStatistics
from motorprior.studies.transfer_models import LOG_SECONDS

BASELINES = ("ideal_pd", "friction_pd", "random_pd", "paper")
# environments of the demo, and what is new to a policy in them
_EXPLAINED = {
    "fleet": "other robots of the same fleet",
    "hard": "other motors, floor, load, delays and pushes",
}
# a baseline whose time upright is less by no more is called as good as the prior [-]
_EQUAL_UPRIGHT = 0.02


def results_section(summary: StudyStatistics, speed: float, film: Picture) -> Section:
    """Question, result and uncertainty; the film; time upright and speed."""
    environments = "; ".join(f"{env}: {text}" for env, text in _EXPLAINED.items())
    question = (
        "Policies are trained in simulation on models of a robot's motors, and then walk robots "
        f"that they have never seen, commanded {speed:g} m/s: {environments}."
    )
    num_policies = max(policies.shape[1] for policies in summary.upright.values())
    uncertainty = (
        f"95 % intervals over the robots, of at most {num_policies} policies per condition, all "
        "for one bench of motors. Intervals exclude variation between trainings and benches; those "
        "of the study include it (docs/transfer.md)."
    )
    drawn = picture(forest_plot(summary), "Time upright; hollow: in the training simulation.")
    tables = tuple(estimate_table(summary, metric) for metric in METRICS)
    texts = (headline(summary), question, _gaps(summary), uncertainty)
    return Section("Results", texts, (drawn, film), tables)


def headline(summary: StudyStatistics) -> str:
    """Time upright on held-out robots.

    The text starts with a baseline that is as good as the prior, if there is one.
    """
    best = max(BASELINES, key=lambda condition: _upright(summary, condition).sum())
    best_label = model_label(best)
    enough = _upright(summary, SAMPLED_PRIOR) - _EQUAL_UPRIGHT
    first = ""
    if np.all(_upright(summary, best) > enough):
        first = f"Here a simpler model is as good as the learned prior: the {best_label}. "
    return (
        f"{first}Time upright on held-out robots: {_percent(summary, SAMPLED_PRIOR)} after "
        f"training on samples of the prior; {_percent(summary, 'adapted_prior')} on the prior "
        f"adapted to {LOG_SECONDS:g} s of log of the robot; {_percent(summary, 'ideal_pd')} on "
        f"an ideal PD; {_percent(summary, best)} on the best baseline, the {best_label}."
    )


def _upright(summary: StudyStatistics, condition: str) -> np.ndarray:
    """(environments,) time upright of a training condition [-]."""
    return np.array([summary.estimates[env, condition, "upright"].value for env in _EXPLAINED])


def _percent(summary: StudyStatistics, condition: str) -> str:
    """Time upright of a training condition in every environment."""
    texts = []
    for env, value in zip(_EXPLAINED, _upright(summary, condition), strict=True):
        texts.append(f"{100 * value:.0f} % ({env})")
    return " and ".join(texts)


def _gaps(summary: StudyStatistics) -> str:
    """Time upright lost between the training simulation and held-out robots of the fleet."""
    gaps = []
    for condition in conditions_in(summary):
        in_training = summary.estimates[IN_TRAINING, condition, "upright"].value
        held_out = summary.estimates["fleet", condition, "upright"].value
        gaps.append(f"{model_label(condition)} {100 * (in_training - held_out):+.0f}")
    return (
        "Transfer gap, own simulation minus fleet, in percentage points upright: "
        f"{', '.join(gaps)}."
    )


def robustness(maps: Mapping[str, np.ndarray]) -> Section:
    """Maps of the time upright [-] over (pushes, frictions), by training condition."""
    text = (
        "Held-out robots of the fleet with stronger pushes and other floors than in any training, "
        "walks of 5 s."
    )
    caption = "Time upright [%], over all policies."
    return Section("Robustness on held-out robots", (text,), (picture(_heat_maps(maps), caption),))


def _heat_maps(maps: Mapping[str, np.ndarray]) -> Figure:
    """A panel per training condition, on one scale."""
    figure = new_figure(2.6)
    grid = panels(figure, 1, len(maps), sharey=True)[0]
    for axes, (condition, upright) in zip(grid, maps.items(), strict=True):
        _heat_map(axes, upright)
        set_labels(axes, x="friction of the floor [-]", title=model_label(condition))
    set_labels(grid[0], y="largest push [N·s]")
    return figure


def _heat_map(axes: Axes, upright: np.ndarray) -> None:
    axes.imshow(upright, vmin=0.0, vmax=1.0, cmap="Blues", origin="lower", aspect="auto")
    axes.grid(False)
    for (row, column), value in np.ndenumerate(upright):
        axes.text(
            column,
            row,
            f"{100 * value:.0f}",
            ha="center",
            va="center",
            fontsize=TEXT,
            color="white" if value > 0.6 else "black",
        )
    axes.set_xticks(range(len(FRICTIONS)), [f"{friction:g}" for friction in FRICTIONS])
    axes.set_yticks(range(len(PUSHES)), [f"{push:g}" for push in PUSHES])
