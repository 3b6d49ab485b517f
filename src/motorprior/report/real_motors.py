"""Sections on models of the motors in real logs, evaluated on held-out logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from motorprior.identification.evaluation import log_tables
from motorprior.identification.evaluation.traces import Trace, read_traces
from motorprior.report.page import Section, Table, picture
from motorprior.report.plots_style import (
    INK,
    TIME,
    describe,
    fit_y,
    legend_below,
    model_color,
    new_figure,
    panels,
    style,
    target_line,
)
from motorprior.results import Results
from motorprior.signals import rmse

SHOWN_SECONDS = 8.0  # of a trace, from its end, where a chirp is fastest
# colour and marker
_STYLES = {
    "ideal_pd": ("ideal_pd", "s"), "tuned_pd": ("tuned_pd", "D"), "prior": ("rollout", "o"),
    "prior_mean": ("rollout", "|"), "pure_delay": ("paper_wide", "x"), "second_order": ("tuned_pd", "D"),
    "servo_limits": ("one_network", "o"), "adapted": ("prior_adapted", "o"), "per_motor": ("prior_robust", "x"),
    "coulomb_viscous": ("physical", "|"), "stribeck": ("physical", "x"), "pooled_network": ("one_network", "s"),
}  # fmt: skip

_LEAD = "Models of the motors simulate the joints from recorded commands, without feedback from the log."


def real_motors(run: Path) -> list[Section]:
    """From the files of the stage ``real_motors`` of a run."""
    return [_section(run / "real_motors", "Your motors", log_tables.WHOLE_RUN_RMSE)]


def validated_log(folder: Path) -> Section:
    """From the files of `motorprior validate-log`."""
    return _section(folder, "Held-out log", "whole_run_rmse")


def _section(folder: Path, title: str, quantity: str) -> Section:
    results, (traces, lines) = Results.load(folder / "results.json"), read_traces(folder)
    tables = [Table(*log_tables.error_table(results, {quantity: "whole log"}), "Joint RMSE [mrad], over joints.")]
    if constants := log_tables.constants_in(results):
        tables.append(Table(*log_tables.constant_table(constants), "Constants of your motors, over joints."))
    for row in results.where(quantity="whole_run_coverage90"):
        lines.append(f"{row.model}: {100 * row.value:.0f} % of the recorded angles are inside the 90 % bands.")
    pictures = (
        picture(errors_by_joint(log_tables.errors_by_joint(results, quantity)), "Errors by joint."),
        picture(draw_traces(traces), "The joints with the median and maximum error."),
    )
    return Section(title, (_LEAD, *lines), pictures, tuple(tables))


def errors_by_joint(errors: Mapping[str, Mapping[str, float]]) -> Figure:
    """A line per joint with a marker per model.

    Args:
        errors: model -> joint -> RMSE [rad].
    """
    joints = list(dict.fromkeys(joint for values in errors.values() for joint in values))
    figure = new_figure(1.1 + 0.23 * len(joints))
    axes = figure.add_subplot()
    style(axes)
    for model, values in errors.items():
        color, marker = _STYLES[model]
        rows = [joints.index(joint) for joint in values]
        milli = [1e3 * value for value in values.values()]
        size = {"markersize": 9 if marker == "|" else 5, "markeredgewidth": 1.6 if marker in "|x" else 0.5}
        axes.plot(milli, rows, marker, color=model_color(color), label=model, **size)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(joints)), joints)
    axes.set_ylim(len(joints) - 0.5, -0.5)
    describe(axes, x="RMSE of the simulated angle [mrad]")
    legend_below(figure, axes, columns=3)
    return figure


def draw_traces(selected: Sequence[Trace]) -> Figure:
    """A row per trace: recorded and simulated angles, and the errors, in the last seconds."""
    figure = new_figure(0.7 + 1.9 * len(selected))
    grid = panels(figure, len(selected), 2)
    for (angle, error), trace in zip(grid, selected, strict=True):
        _draw(angle, error, trace)
    for axes in grid[-1]:
        describe(axes, x=TIME)
    legend_below(figure, grid[:, 0], columns=3)
    return figure


def _draw(angle: Axes, error: Axes, trace: Trace) -> None:
    rows = trace.time >= trace.time[-1] - SHOWN_SECONDS
    time, measured = trace.time[rows], trace.measured[rows]
    target_line(angle, time, trace.target[rows]).set_linewidth(0.7)
    angle.plot(time, measured, color=INK, linewidth=1.9, label="recorded")
    simulated = {model: values[rows] for model, values in trace.models.items()}
    for model, values in simulated.items():
        color = model_color(_STYLES.get(model, (model,))[0])
        angle.plot(time, values, color=color, linewidth=1.1, label=model)
        error.plot(time, 1e3 * (values - measured), color=color, linewidth=0.9)
    fit_y(angle, [measured, trace.target[rows]], list(simulated.values()))
    best = min(simulated.values(), key=lambda values: float(rmse(values, measured)))
    fit_y(error, [1e3 * (best - measured)], [1e3 * (values - measured) for values in simulated.values()], margin=3.0)
    describe(angle, y="angle [rad]", title=f"{trace.joint}, {trace.log}")
    describe(error, y="simulated - recorded [mrad]")
