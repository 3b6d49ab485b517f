"""Pictures of motors, logs and trainings: responses, traces, errors by joint, learning curves."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json
from motorprior.bench.class_behaviour import ClassBehaviour
from motorprior.bench.dynamometer import Trial, run
from motorprior.evaluation.free_runs import Trace
from motorprior.logs.motor_log import MotorLog
from motorprior.report import plots_style as style
from motorprior.signals import rmse

LOAD = 2e-3  # load inertia of joints in `step_responses` [kg·m²]
NUM_SAMPLES = 40  # sampled motors of a prior
STEP = 0.3  # size of the step [rad]
# drawn duration of a trace [s]: the end of the log, where a chirp has its highest frequency
SHOWN_SECONDS = 8.0
LearningCurve = tuple[np.ndarray, np.ndarray]  # iteration (N,) [-], mean return (N,) [m]

_EXTERNAL_TORQUE = "#8a6fb3"  # colour
_MARKERS = "osDx|^v*"  # of models in `draw_errors_by_joint`
# behaviours of a class of joints -> label of the y axis
_BEHAVIOURS = {"step": "step [rad]", "chirp": "chirp [rad]", "friction": "friction [N·m]"}


def excitation_and_response(log: MotorLog, title: str) -> Figure:
    """Commands and response of the first motor of a log: angles, velocity and logged torques."""
    figure = style.new_figure(4.6)
    grid = style.panels(figure, 3, sharex=True, heights=(1.4, 1, 1))
    angle, velocity, torque = grid[:, 0]

    time = log.time - log.time[0]
    style.target_line(angle, time, log.position_target[:, 0])
    for axes, values, color, label in (
        (angle, log.joint_pos, style.INK, "joint angle"),
        (velocity, log.joint_vel, style.INK, "joint velocity"),
        (torque, log.external_torque, _EXTERNAL_TORQUE, "external torque"),
        (torque, log.joint_torque, style.INK, "motor torque"),
    ):
        if values is not None:
            axes.plot(time, values[:, 0], color=color, lw=1.1, label=label)

    style.set_labels(angle, y="angle [rad]", title=title)
    style.set_labels(velocity, y="velocity [rad/s]")
    style.set_labels(torque, x=style.TIME, y="torque [N·m]")
    style.legend_below(figure, (angle, velocity, torque))
    return figure


def plot_steps(motors: MotorPrior | MotorPosterior) -> Figure:
    """Step responses of samples of a prior, or of a posterior; see `step_responses`."""
    if isinstance(motors, MotorPrior):
        title = f"{motors.motor or 'motors'}: {NUM_SAMPLES} samples of the prior"
        classes = np.resize(motors.classes.of_motors, NUM_SAMPLES).tolist()
        return step_responses(motors.sample(classes, 0), title, motors.model.period)

    count = len(motors.mean) if len(motors.mean) > 1 else NUM_SAMPLES
    samples = motors.sample(count, 0)
    return step_responses(samples, "samples of the posterior", motors.prior.model.period)


def step_responses(motors: Actuator, title: str, period: float) -> Figure:
    """Responses of motors to a step of 0.3 rad and back, and their 5-95 % range.

    Each motor is on a joint that carries LOAD. ``period`` is the largest physics step of the motors
    [s].
    """
    steps_per_period = max(1, round(period / 0.002))
    dt = period / steps_per_period
    count = motors.num_motors
    time = dt * np.arange(round(1.2 / dt))
    target = np.where((time >= 0.1) & (time < 0.7), STEP, 0.0)
    commands = np.repeat(target[:, None], count, axis=1)
    trial = Trial(commands, np.zeros_like(commands), np.full(count, LOAD), dt)
    angles = run(motors, trial).joint_pos
    low, median, high = np.percentile(angles, [5, 50, 95], axis=1)

    figure = style.new_figure(3.2)
    axes = style.panels(figure, 1)[0, 0]
    style.target_line(axes, time, target)
    axes.plot(time, angles[:, :10], color=style.INK, lw=0.4, alpha=0.5)
    axes.fill_between(time, low, high, color=style.INK, alpha=0.15, label="5-95 % of the motors")
    axes.plot(time, median, color=style.INK, lw=1.4, label="median")
    style.set_labels(
        axes, x=style.TIME, y="joint angle [rad]", title=f"{title}; load {LOAD:g} kg·m²"
    )
    style.legend_below(figure, (axes,))
    return figure


def draw_traces(traces: Sequence[Trace]) -> Figure:
    """A row per trace: true and simulated angles, and the errors, in the last SHOWN_SECONDS."""
    figure = style.new_figure(0.7 + 1.9 * len(traces))
    grid = style.panels(figure, len(traces), 2)
    for (angle, error), trace in zip(grid, traces, strict=True):
        _draw_trace(angle, error, trace)
    for axes in grid[-1]:
        style.set_labels(axes, x=style.TIME)
    style.legend_below(figure, grid[:, 0], columns=3)
    return figure


def _draw_trace(angle: Axes, error: Axes, trace: Trace) -> None:
    rows = trace.time >= trace.time[-1] - SHOWN_SECONDS
    time = trace.time[rows]
    target = trace.target[rows]
    measured = trace.measured[rows]
    simulated = {model: values[rows] for model, values in trace.models.items()}

    style.target_line(angle, time, target).set_linewidth(0.7)
    style.model_line(angle, time, measured, "measured").set_linewidth(1.9)
    for model, values in simulated.items():
        style.model_line(angle, time, values, model).set_linewidth(1.1)
        style.model_line(error, time, 1e3 * (values - measured), model).set_linewidth(0.9)

    # models that diverge leave the picture
    best = min(simulated.values(), key=lambda values: float(rmse(values, measured)))
    style.fit_y(angle, np.append(measured, target), 0.3)
    style.fit_y(error, 1e3 * (best - measured), 1.5)
    style.set_labels(angle, y="angle [rad]", title=f"{trace.joint}, {trace.log}")
    style.set_labels(error, y="simulated - measured [mrad]")


def draw_class_behaviours(behaviours: Sequence[ClassBehaviour]) -> Figure:
    """A row per class of joints: 90 % bands of samples, and the training motors as lines."""
    names = [name for name in _BEHAVIOURS if name in behaviours[0].axes]
    figure = style.new_figure(0.7 + 1.7 * len(behaviours))
    grid = style.panels(figure, len(behaviours), len(names))
    for row, behaviour in zip(grid, behaviours, strict=True):
        for axes, name in zip(row, names, strict=True):
            _draw_behaviour(axes, behaviour, name)
        style.set_labels(row[0], title=behaviour.name or "all joints")
    style.legend_below(figure, figure.axes[:1])
    return figure


def _draw_behaviour(axes: Axes, behaviour: ClassBehaviour, name: str) -> None:
    x = behaviour.axes[name]
    low, high = np.percentile(behaviour.sampled[name], [5, 95], axis=0)
    color = style.model_color("prior")
    axes.fill_between(x, low, high, color=color, alpha=0.25, lw=0.0, label="90 % of samples")
    lines = axes.plot(x, behaviour.training_motors[name].T, color=style.INK, lw=0.6)
    lines[0].set_label("training motors")

    x_label = "speed [rad/s]" if name == "friction" else style.TIME
    style.set_labels(axes, x=x_label, y=_BEHAVIOURS[name])


def draw_errors_by_joint(errors: Mapping[str, Mapping[str, float]]) -> Figure:
    """A line per joint with a marker per model, from model -> joint -> RMSE [rad]."""
    joints = list(dict.fromkeys(joint for by_joint in errors.values() for joint in by_joint))
    legend_height = 0.2 * len(errors) / 3.0
    figure = style.new_figure(1.1 + legend_height + 0.23 * len(joints))
    axes = style.panels(figure, 1)[0, 0]
    for number, (model, by_joint) in enumerate(errors.items()):
        axes.plot(
            [1e3 * error for error in by_joint.values()],
            [joints.index(joint) for joint in by_joint],
            _MARKERS[number % len(_MARKERS)],
            color=style.model_color(model),
            label=model,
            markersize=5,
        )

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_yticks(range(len(joints)), joints)
    axes.set_ylim(len(joints) - 0.5, -0.5)
    style.set_labels(axes, x="RMSE of the simulated angle [mrad]")
    style.legend_below(figure, axes, columns=3)
    return figure


def read_curves(folders: Iterable[Path]) -> list[LearningCurve]:
    """Learning curves of trainings, from curve.json in their folders."""
    curves = []
    for folder in folders:
        points = read_json(folder / "curve.json")
        iterations = np.array([point["iteration"] for point in points])
        mean_returns = np.array([point["mean_return"] for point in points])
        curves.append((iterations, mean_returns))
    return curves


def learning_curves(curves: Mapping[str, Sequence[LearningCurve]]) -> Figure:
    """Median over the seeds of each training, and every seed as a thin line."""
    figure = style.new_figure(3.5)
    axes = style.panels(figure, 1)[0, 0]
    for number, (name, seeds) in enumerate(curves.items()):
        color = style.model_color(name) if style.model_key(name) else f"C{number}"
        for iteration, mean_return in seeds:
            axes.plot(iteration, mean_return, color=color, lw=0.6, alpha=0.4)

        iteration, mean_return = _median(seeds)
        plural = "" if len(seeds) == 1 else "s"
        label = f"{style.model_label(name)}, {len(seeds)} seed{plural}"
        line = style.model_line(axes, iteration, mean_return, name, label, color)
        line.set_linewidth(2.0)
    style.set_labels(axes, x="ARS iteration [-]", y="mean return [m]")
    style.legend_below(figure, axes, columns=3)
    return figure


def _median(seeds: Sequence[LearningCurve]) -> LearningCurve:
    """Median curve over the iterations that all seeds have."""
    start = max(iteration[0] for iteration, _ in seeds)
    stop = min(iteration[-1] for iteration, _ in seeds)
    grid = np.unique(np.concatenate([iteration for iteration, _ in seeds]))
    grid = grid[(grid >= start) & (grid <= stop)]
    returns = [np.interp(grid, iteration, mean_return) for iteration, mean_return in seeds]
    return grid, np.median(returns, axis=0)
