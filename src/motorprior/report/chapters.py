"""Sections of the page of a demo and of trained policies, from the files of their stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from motorprior.artifacts import read_tensors
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.families import FAMILIES
from motorprior.identification.evaluation.traces import read_traces
from motorprior.report import tables
from motorprior.report.film import film, gif_bytes
from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_motor import closed_loop, excitation_and_response, robot_traces, torque_fit
from motorprior.report.plots_style import model_label
from motorprior.report.plots_walk import learning_curves, read_curves, robustness_maps, transfer_bars
from motorprior.report.real_motors import draw_traces
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.studies.compare import DRAWS
from motorprior.studies.robot_fidelity import BENCH_METRICS, ROBOT_METRICS
from motorprior.studies.robot_fidelity import DRAWS as ROBOT_DRAWS
from motorprior.studies.robustness import ROBUSTNESS_DRAWS, UprightMap

Tensors = dict[str, np.ndarray]


def bench(folder: Path) -> Section:
    """Excitation and response of the first motor."""
    log, settings = read_bench(folder)
    segments = log.segment_slices()
    part = log.rows(segments[min(3, len(segments) - 1)]).joint(0).rows(slice(0, 700))
    columns = (part.joint_vel, part.joint_torque, part.external_torque)
    optional = [None if column is None else column[:, 0] for column in columns]
    target, joint_pos = part.position_target[:, 0], part.joint_pos[:, 0]
    title = "Preset rollout, first motor"
    figure = excitation_and_response(part.time - part.time[0], target, joint_pos, *optional, title=title)
    text = (
        f"{settings.motors} physical motors of fleet {settings.fleet.name} on a virtual dynamometer, {settings.steps} "
        f"steps each. {FAMILIES[settings.fleet.family].motor} The motors differ."
    )
    return _section("Bench: excitation and response", text, figure, "Excitation and response of one motor.")


def _section(title: str, text: str, figure: Figure, caption: str, *tables: Table) -> Section:
    return Section(title, (text,), (picture(figure, caption),), tables)


def validate(folder: Path) -> list[Section]:
    """Torque fit, closed loop on the bench, and closed loop inside the robot."""
    results = Results.load(folder / "results.json")
    tensors, header = read_tensors(folder / "traces.safetensors")
    return [_torque(tensors), _bench_loop(tensors, header, results), _robot_loop(tensors, header, results)]


def _by_model(tensors: Tensors, prefix: str) -> Tensors:
    return {name: tensors[prefix + name] for name in tables.MODELS if prefix + name in tensors}


def _torque(tensors: Tensors) -> Section:
    time, measured, predicted = (tensors[f"torque/paper_wide/{key}"] for key in ("time", "measured", "predicted"))
    figure = torque_fit(time, measured, {"paper_wide": predicted})
    text = (
        "A network trained as in the paper predicts the torque of the next step well from the recorded motion. This "
        "error does not predict the closed-loop error in the next sections."
    )
    return _section("Torque fit: open loop, one step", text, figure, "Torque from the recorded motion.")


def _fidelity_table(results: Results, columns: tuple[str, ...], caption: str) -> Table:
    titles = tuple(column.replace("_", " ").replace("hf", "> 20 Hz") for column in columns)
    return Table(("model", *titles), tables.fidelity_rows(results, columns), caption)


def _bench_loop(tensors: Tensors, header: dict[str, Any], results: Results) -> Section:
    target = tensors["bench/target"]
    time = np.arange(len(target)) * header["bench_dt"]
    models = _by_model(tensors, "bench/model/")
    figure = closed_loop(time, target, tensors["bench/truth"], models, "gait with impacts")
    ratio = results.value(quantity="armature_ratio", model="rollout")
    text = (
        "Each model drives one loaded joint under a held-out excitation and is compared with the physical motor, for "
        "every training motor.",
        f"The armature of rollout, identified from motion alone, is {ratio:.2f} times that of the rotors on average.",
    )
    caption = "Joint RMSE [rad] over 1 s, median of the motors. physical: the lower bound."
    table = _fidelity_table(results, tuple(BENCH_METRICS), caption)
    return Section("Closed loop on the bench", text, (picture(figure, "One held-out trial."),), (table,))


def _robot_loop(tensors: Tensors, header: dict[str, Any], results: Results) -> Section:
    truth, torque = tensors["robot/position/truth"], tensors["robot/torque/truth"]
    positions, torques = (_by_model(tensors, f"robot/{kind}/") for kind in ("position", "torque"))
    time = np.arange(len(truth)) * header["robot_dt"]
    figure = robot_traces(time, truth, positions, torque, torques, f"{header['joint']}, standing trot")
    caption = f"Joint RMSE [rad] and torque above 20 Hz [N·m], medians of {ROBOT_DRAWS} samples of motors."
    table = _fidelity_table(results, ROBOT_METRICS, caption)
    text = (
        "The same models drive a standing and a suspended robot. Torque above 20 Hz should equal that of the physical "
        "motors: more is chatter. The legs of paper_wide oscillate: a network fitted one step ahead infers the torque "
        "from the last change of velocity, which feeds back on itself in a simulator "
        "(docs/why-the-paper-oscillates.md)."
    )
    return _section("Closed loop inside the robot", text, figure, f"{header['joint']} in a trot on the ground.", table)


def replay(folder: Path) -> Section:
    """Real logs; the pictures are of the first two."""
    results, (traces, _) = Results.load(folder / "results.json"), read_traces(folder)
    caption = "Joint RMSE [mrad], no offset removed; samples: median (5-95 %)."
    table = Table(("log", "joint", *tables.replay_models(results)), tables.replay_rows(results), caption)
    text = (
        "The commands recorded on the real robot are replayed on a simulated one. physical is the central motor of the "
        "fleet, physical_draws are samples of it. For a fleet that was calibrated on these logs, this is a fit, not a "
        "prediction."
    )
    return _section("Real robot logs", text, draw_traces(traces[:2]), "The real robot and simulated motors.", table)


def learning(folders: Mapping[str, Sequence[Path]]) -> Section:
    """Learning curves of trainings: name -> a folder with curve.json per seed."""
    curves = {name: read_curves(seeds) for name, seeds in folders.items()}
    text = (
        "Augmented random search. Each return is measured in the training simulation of the policy, so returns of "
        "different motors are not comparable."
    )
    caption = "Mean return of the perturbed policies per iteration."
    return _section("Learning to walk", text, learning_curves(curves), caption)


def transfer(folder: Path, robot: Robot) -> Section:
    """The transfer table and films on the twin."""
    results = Results.load(folder / "results.json")
    tensors, _ = read_tensors(folder / "traces.safetensors")
    names, quantities = tables.conditions_in(results), ("speed", "upright")

    def means(motors: str) -> dict[str, list[float]]:
        return {name: [results.mean(quantity=q, motors=motors, model=name) for q in quantities] for name in names}

    caption = "Pale: in the training simulation. Full colour: on the twin."
    films = (_gait_film(robot, tensors[f"twin/{name}"], name, "on the twin") for name in names)
    table = Table(tables.TRANSFER_COLUMNS, tables.transfer_rows(results), f"{DRAWS} samples of motors, 5 s each.")
    text = (
        "Each policy is evaluated in its training simulation and on the twin, the held-out virtual robot: unseen "
        "physical motors, 1 kHz physics, sensor noise. The twin's motors are the same for all policies.",
        "ideal PD: the gains with the smallest closed-loop error on the bench; tuned PD: the gains, armature and delay."
        " Seeds of one condition differ by about 0.1 m/s, so small differences are not significant.",
    )
    return Section("Transfer", text, (picture(transfer_bars(means("own"), means("twin")), caption), *films), (table,))


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


def robustness_section(maps: Mapping[str, Sequence[UprightMap]]) -> Section:
    """Time upright under disturbances: name of the training -> maps of its policy."""
    text = (
        "Time upright at the maximum commanded speed, with two disturbances varied at a time. Every cell has the same "
        "samples of the training motors, in MuJoCo on flat ground."
    )
    return _section("Robustness", text, robustness_maps(maps), f"{ROBUSTNESS_DRAWS} walks of 5 s per cell.")
