"""Sections of the demo's page: results on held-out robots, their robustness, and their steps."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from motorprior.report.page import Picture, Section, picture
from motorprior.report.plots_style import TEXT, model_label, new_figure, panels, set_labels
from motorprior.report.transfer_page import (
    METRICS,
    STEPS,
    conditions_in,
    estimate_table,
    forest_plot,
)
from motorprior.studies.compare import FRICTIONS, PUSHES
from motorprior.studies.statistics import IN_TRAINING, SAMPLED_PRIOR, StudyStatistics
from motorprior.studies.transfer_models import LOG_SECONDS

BASELINES = ("ideal_pd", "friction_pd", "paper")
_MIN_WALKING = 0.5  # smallest time upright of policies that walk [-]
# environments of the demo, and what they are
_EXPLAINED = {
    "fleet": "other robots of the same fleet, with sensor noise",
    "hard": (
        "the same robots with an unknown floor and load, slopes, late and lost readings, and pushes"
    ),
}
_CONDITIONS = {
    "ideal_pd": "an ideal PD with gains and torque limit fitted to the bench",
    "friction_pd": "a PD with armature, delay and Coulomb friction fitted to the bench",
    "paper": (
        "the paper's network, on its own bench of sinusoids; one short training, since its "
        "policies do not walk in their own simulation"
    ),
    "sampled_prior": "samples of the motor prior, other motors in every episode",
    "adapted_prior": (
        f"the motor prior after {LOG_SECONDS:g} s of log of the robot that the policy walks on"
    ),
}


def results_section(summary: StudyStatistics, speed: float, film: Picture) -> Section:
    """Result, question, definitions and uncertainty; the film; time upright and speed."""
    environments = "; ".join(f"{env}: {text}" for env, text in _EXPLAINED.items())
    question = (
        "Policies are trained in simulation on models of a robot's motors, and then walk held-out "
        f"virtual robots, commanded {speed:g} m/s. Environments: {environments}."
    )
    definitions = [f"{model_label(name)}: {text}" for name, text in _CONDITIONS.items()]
    conditions = f"Trained on: {'; '.join(definitions)}."
    walks = (
        "Walk k of every policy has the same robot, floor and pushes; policies of the adapted "
        "prior walk on their own robot only."
    )
    num_policies = max(policies.shape[1] for policies in summary.upright.values())
    uncertainty = (
        f"95 % intervals over the walks (robots, floors, pushes) of at most {num_policies} "
        "policies per condition, all for one bench of motors; those of the adapted prior over "
        "floors and pushes only. They exclude the variation between trainings and benches, which "
        "the study includes (docs/transfer.md)."
    )
    caption = (
        "Time upright: mean with 95 % interval; small dots: the policies; hollow: mean in the "
        "simulation of the policies' own training."
    )
    drawn = picture(forest_plot(summary), caption)
    tables = tuple(estimate_table(summary, metric) for metric in METRICS)
    texts = (headline(summary), question, conditions, walks, _gaps(summary), uncertainty)
    return Section("Results", texts, (drawn, film), tables)


def headline(summary: StudyStatistics) -> str:
    """Which training condition is ahead, or that two are equal; then the times upright.

    The sampled prior is compared with the best baseline, see `leads`.
    """
    best = max(BASELINES, key=lambda condition: _upright(summary, condition).sum())
    best_label = model_label(best)
    prior_label = model_label(SAMPLED_PRIOR)
    lead = {env: leads(summary, env, best) for env in _EXPLAINED}
    ahead = [env for env, sign in lead.items() if sign > 0]
    behind = [env for env, sign in lead.items() if sign < 0]

    if ahead and not behind:
        result = f"The {prior_label} is ahead of the best baseline, the {best_label}"
        result += f", in {' and '.join(ahead)}."
    elif behind and not ahead:
        result = f"The best baseline, the {best_label}, is ahead of the {prior_label}"
        result += f" in {' and '.join(behind)}."
    elif ahead and behind:
        result = f"The {prior_label} is ahead of the best baseline, the {best_label}, in "
        result += f"{' and '.join(ahead)}, and behind it in {' and '.join(behind)}."
    else:
        result = f"The {prior_label} and the best baseline, the {best_label}, are equal within "
        result += "the uncertainty of this run."

    times = "; ".join(
        f"{model_label(condition)} {_percent(summary, condition)}"
        for condition in conditions_in(summary)
    )
    return f"{result} Time upright on held-out robots: {times}."


def leads(summary: StudyStatistics, env: str, baseline: str) -> int:
    """1 if the sampled prior is ahead of a baseline in an environment, -1 if it is behind, else 0.

    It is ahead if the 95 % interval of the difference of the times upright, over robots, excludes
    0, and if all its policies are upright longer than all policies of the baseline. Behind is the
    reverse.
    """
    difference = summary.differences[env, baseline, "upright"].difference  # baseline minus prior
    of_prior = summary.upright[env, SAMPLED_PRIOR]
    of_baseline = summary.upright[env, baseline]
    if difference.high < 0.0 and of_prior.min() > of_baseline.max():
        return 1
    if difference.low > 0.0 and of_baseline.min() > of_prior.max():
        return -1
    return 0


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
    """Time upright lost between the training simulation and held-out robots of the fleet.

    Policies that do not walk in their own simulation have nothing to lose.
    """
    gaps = []
    for condition in conditions_in(summary):
        in_training = summary.estimates[IN_TRAINING, condition, "upright"].value
        if in_training < _MIN_WALKING:
            continue
        held_out = summary.estimates["fleet", condition, "upright"].value
        gaps.append(f"{model_label(condition)} {100 * (in_training - held_out):+.0f}")
    return (
        "Transfer gap, time upright in the own simulation minus in fleet, in percentage points: "
        f"{', '.join(gaps)}."
    )


def steps_section(summary: StudyStatistics) -> Section:
    """Step frequency and foot lift, and what the paper observed."""
    claim = (
        "The paper observed that the policy of the learned actuator takes steps of lower frequency "
        "and lifts the legs higher than the policy of the ideal PD."
    )
    label = model_label(SAMPLED_PRIOR)
    texts = [claim]
    for env, place in ((IN_TRAINING, "In their own simulation"), ("fleet", "On held-out robots")):
        results = []
        for baseline in ("ideal_pd", "friction_pd"):
            frequency = _compared(summary, env, "step_frequency", baseline)
            lift = _compared(summary, env, "foot_lift_mm", baseline)
            results.append(f"{frequency}, and {lift}")
        texts.append(f"{place}, the policies of the {label} have {'; '.join(results)}.")
    texts.append("Walks with less than a second before a fall do not count.")
    tables = tuple(estimate_table(summary, metric) for metric in STEPS)
    return Section("Steps", tuple(texts), tables=tables)


_STEP_TEXTS = {
    "step_frequency": ("step frequency", "Hz", ".2f"),
    "foot_lift_mm": ("foot lift", "mm", ".1f"),
}


def _compared(summary: StudyStatistics, env: str, metric: str, baseline: str) -> str:
    """A metric of the sampled prior compared with that of a baseline, by their intervals."""
    name, unit, number_format = _STEP_TEXTS[metric]
    missing = [
        condition
        for condition in (SAMPLED_PRIOR, baseline)
        if (env, condition, metric) not in summary.estimates
    ]
    if missing:
        return f"no {name} to compare: no walk of {model_label(missing[0])} is long enough"

    of_prior = summary.estimates[env, SAMPLED_PRIOR, metric]
    of_baseline = summary.estimates[env, baseline, metric]
    comparison = f"a {name} not distinguishable from"
    if of_prior.low > of_baseline.high:
        comparison = f"a higher {name} than"
    elif of_prior.high < of_baseline.low:
        comparison = f"a lower {name} than"
    values = f"{of_prior.value:{number_format}} and {of_baseline.value:{number_format}} {unit}"
    return f"{comparison} the {model_label(baseline)} ({values})"


def robustness(maps: Mapping[str, np.ndarray]) -> Section:
    """Maps of the time upright [-] over (pushes, frictions), by training condition."""
    text = (
        "Held-out robots of the fleet, with pushes every second and floors of several frictions, "
        "up to three times the pushes of the training; walks of 5 s."
    )
    comparisons = []
    for condition, upright in maps.items():
        if condition != SAMPLED_PRIOR:
            comparisons.append(_map_comparison(maps[SAMPLED_PRIOR], condition, upright))
    caption = "Time upright [%], over all policies."
    drawn = picture(_heat_maps(maps), caption)
    return Section("Robustness on held-out robots", (text, *comparisons), (drawn,))


def _map_comparison(of_prior: np.ndarray, baseline: str, of_baseline: np.ndarray) -> str:
    """Who is ahead in how many cells of the maps."""
    difference = of_prior - of_baseline
    ahead = int(np.sum(difference > 0.0))
    behind = int(np.sum(difference < 0.0))
    return (
        f"Of {difference.size} cells, the {model_label(SAMPLED_PRIOR)} is ahead of the "
        f"{model_label(baseline)} in {ahead} and behind in {behind}; mean difference "
        f"{100.0 * difference.mean():+.0f} percentage points."
    )


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
