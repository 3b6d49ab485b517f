"""Sections of the pages, from the files of their stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.class_behaviour import LOADS, class_behaviours
from motorprior.bench.families import FAMILIES
from motorprior.identification.evaluation import log_tables
from motorprior.identification.evaluation.free_runs import read_traces
from motorprior.report.film import film, gif_bytes
from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_motor import draw_class_behaviours, draw_traces, errors_by_joint, excitation_and_response
from motorprior.report.plots_style import model_label
from motorprior.report.plots_walk import learning_curves, read_curves
from motorprior.robots.robot import Robot
from motorprior.stage import read_results


def _section(title: str, text: str, figure: Figure, caption: str, *tables: Table) -> Section:
    return Section(title, (text,), (picture(figure, caption),), tables)


def real_motors(folder: Path) -> Section:
    """Models of the motors in real logs, from the files of the quick report."""
    return _models_of_logs(folder, "Your motors", log_tables.WHOLE_RUN_RMSE)


def validated_log(folder: Path) -> Section:
    """From the files of `motorprior validate-log`."""
    return _models_of_logs(folder, "Held-out log", "whole_run_rmse")


def samples(prior: MotorPrior) -> Section:
    """Behaviour of samples of each class of joints, and where their spread comes from."""
    figure = draw_class_behaviours(class_behaviours(prior))
    caption = f"Responses on a load of {LOADS[1]:g} times the armature, and friction; a row per class of joints."
    text = " ".join(f"{line[0].upper()}{line[1:]}." for line in prior.spread_notes())
    return _section("Samples of the prior", text, figure, caption)


def _models_of_logs(folder: Path, title: str, quantity: str) -> Section:
    results, (traces, lines) = read_results(folder), read_traces(folder)
    tables = [Table(*log_tables.error_table(results, {quantity: "whole log"}), "Joint RMSE [mrad], over joints.")]
    if constants := log_tables.constants_in(results):
        tables.append(Table(*log_tables.constant_table(constants), "Constants of your motors, over joints."))
    for row in results.where(quantity="whole_run_coverage90"):
        lines.append(f"{row.model}: {100 * row.value:.0f} % of the recorded angles are inside the 90 % bands.")
    pictures = (
        picture(errors_by_joint(log_tables.errors_by_joint(results, quantity)), "Errors by joint."),
        picture(draw_traces(traces), "The joints with the median and maximum error."),
    )
    text = "Models of the motors simulate the joints from recorded commands, without feedback from the log."
    return Section(title, (text, *lines), pictures, tuple(tables))


def bench(folder: Path) -> Section:
    """Excitation and response of the first motor."""
    log, settings = read_bench(folder)
    segments = log.segment_slices()
    part = log.rows(segments[min(3, len(segments) - 1)]).joint(0).rows(slice(0, 700))
    text = (
        f"{settings.motors} physical motors of fleet {settings.fleet.name} on a virtual dynamometer, {settings.steps} "
        f"steps each. {FAMILIES[settings.fleet.family].motor} The motors differ."
    )
    figure = excitation_and_response(part, "Preset rollout, first motor")
    return _section("Bench: excitation and response", text, figure, "Excitation and response of one motor.")


def learning(folders: Mapping[str, Sequence[Path]]) -> Section:
    """Learning curves of trainings: name -> a folder with curve.json per seed."""
    figure = learning_curves({name: read_curves(seeds) for name, seeds in folders.items()})
    text = (
        "Augmented random search. Each return is measured in the training simulation of the policy, so returns of "
        "different motors are not comparable."
    )
    return _section("Learning to walk", text, figure, "Mean return of the perturbed policies per iteration.")


def gaits(robot: Robot, traces: Mapping[str, np.ndarray]) -> Section:
    """Films of policies in their training simulation: name -> (steps, 7 + joints) of a walk."""
    films = (_gait_film(robot, trace, name, "in its training simulation") for name, trace in traces.items())
    return Section("Gaits", (f"Robot {robot.name} in the training simulation of each policy.",), tuple(films))


def _gait_film(robot: Robot, trace: np.ndarray, name: str, where: str) -> Picture:
    """The first 2.5 s, or less if the robot falls before, at 10 pictures per second."""
    stride = max(1, round(0.1 / robot.control_dt))
    walk = trace[: round(2.5 / robot.control_dt) : stride]
    seconds = stride * robot.control_dt
    notes = [f"{step * seconds:.1f} s    {x:z.2f} m" for step, x in enumerate(walk[:, 0] - walk[0, 0])]
    pictures = film(robot, [walk], [model_label(name)], [notes])
    return Picture(f"Trained on {model_label(name)}, {where}.", gif_bytes(pictures, seconds), "gif")
