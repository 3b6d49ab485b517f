"""Sections of the page of a demo and of trained policies, from the files of their stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json, read_tensors
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.families import FAMILIES
from motorprior.report.film import film, gif_bytes
from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_motor import closed_loop, excitation_and_response, robot_traces, torque_fit
from motorprior.report.plots_prior import best_explained, latent_map, principal_directions
from motorprior.report.plots_style import model_label
from motorprior.report.plots_walk import learning_curves, robustness_maps, transfer_bars
from motorprior.report.tables import (
    TRANSFER_COLUMNS,
    conditions_in,
    fidelity_rows,
    replay_models,
    replay_rows,
    transfer_rows,
)
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.transfer import robot_fidelity
from motorprior.transfer.metrics import BENCH_METRICS, MODELS, ROBOT_METRICS
from motorprior.transfer.robustness import ROBUSTNESS_DRAWS, UprightMap
from motorprior.transfer.twin import DRAWS

Tensors = dict[str, np.ndarray]


def bench(folder: Path) -> Section:
    """Excitation and response of the first motor."""
    log, facts = read_bench(folder)
    segments = log.segment_slices()
    part = log.rows(segments[min(3, len(segments) - 1)]).joint(0).rows(slice(0, 700))
    columns = (part.joint_vel, part.joint_torque, part.external_torque)
    optional = [None if column is None else column[:, 0] for column in columns]
    time = part.time - part.time[0]
    target, joint_pos = part.position_target[:, 0], part.joint_pos[:, 0]
    figure = excitation_and_response(time, target, joint_pos, *optional, title="Preset rollout, first motor")
    text = (
        f"{facts.motors} physical motors of fleet {facts.fleet.name} on a virtual dynamometer, {facts.steps} steps "
        f"each. {FAMILIES[facts.fleet.family].motor} The motors differ.",
    )
    return Section("Bench: excitation and response", text, (picture(figure, "Excitation and response of one motor."),))


def identify(prior_file: Path, bench_folder: Path) -> Section:
    """The latent map of the training motors."""
    prior, motors = MotorPrior.load(prior_file), read_bench(bench_folder)[1].physical_motors()
    text = (
        "Each training motor has a mean and a variance of a latent z. A new motor is a sample z ~ N(0, I); the circles "
        "are one and two standard deviations. The axes are the two directions of z along which the behaviour on the "
        "standard bench varies most. Colours are the physical constants that the two directions explain best, by R². "
        "The training does not use these constants.",
    )
    pictures = ()
    if prior.network.num_latents > 1:
        axes, share = principal_directions(prior.network)
        points = prior.mean @ axes
        constants = {field.name: getattr(motors, field.name) for field in fields(motors)}
        figure = latent_map(points, share, best_explained(points, constants, 4))
        pictures = (picture(figure, f"The {len(points)} training motors in the latent space."),)
    return Section("Motor prior: how motors differ", text, pictures)


def validate(folder: Path) -> list[Section]:
    """Torque fit, closed loop on the bench, and closed loop inside the robot."""
    results = Results.load(folder / "results.json")
    tensors, header = read_tensors(folder / "traces.safetensors")
    return [_torque(tensors), _bench_loop(tensors, header, results), _robot_loop(tensors, header, results)]


def _by_model(tensors: Tensors, prefix: str) -> Tensors:
    return {name: tensors[prefix + name] for name in MODELS if prefix + name in tensors}


def _torque(tensors: Tensors) -> Section:
    time, measured, predicted = (tensors[f"torque/paper_wide/{key}"] for key in ("time", "measured", "predicted"))
    figure = torque_fit(time, measured, {"paper_wide": predicted})
    text = (
        "Given the recorded motion, a network trained as in the paper predicts the torque of the next step well. "
        "This error does not predict the closed-loop error, see the next section.",
    )
    return Section("Torque fit: open loop, one step", text, (picture(figure, "Torque from the recorded motion."),))


def _fidelity_table(results: Results, columns: tuple[str, ...], caption: str) -> Table:
    titles = tuple(column.replace("_", " ").replace("hf", "> 20 Hz") for column in columns)
    return Table(("model", *titles), tuple(map(tuple, fidelity_rows(results, columns))), caption)


def _bench_loop(tensors: Tensors, header: dict[str, Any], results: Results) -> Section:
    target = tensors["bench/target"]
    time = np.arange(len(target)) * header["bench_dt"]
    models = _by_model(tensors, "bench/model/")
    figure = closed_loop(time, target, tensors["bench/truth"], models, "gait with impacts")
    ratio = results.value(quantity="armature_ratio", model="rollout")
    text = (
        "Each model drives one loaded joint under a held-out excitation and is compared with the physical motor. The "
        "motors are the training motors, each at the mean of its posterior.",
        f"The armature that rollout decodes from z is {ratio:.2f} times that of the rotors on average, identified from "
        "motion alone.",
    )
    caption = "Joint RMSE [rad] over 1 s, median of the motors. physical: the lower bound."
    table = _fidelity_table(results, tuple(BENCH_METRICS), caption)
    return Section("Closed loop on the bench", text, (picture(figure, "One held-out trial."),), (table,))


def _robot_loop(tensors: Tensors, header: dict[str, Any], results: Results) -> Section:
    truth, torque = tensors["robot/position/truth"], tensors["robot/torque/truth"]
    positions, torques = (_by_model(tensors, f"robot/{kind}/") for kind in ("position", "torque"))
    time = np.arange(len(truth)) * header["robot_dt"]
    figure = robot_traces(time, truth, positions, torque, torques, f"{header['joint']}, standing trot")
    caption = f"Joint RMSE [rad] and torque above 20 Hz [N·m], medians of {robot_fidelity.DRAWS} samples of motors."
    table = _fidelity_table(results, ROBOT_METRICS, caption)
    chatter = results.where(quantity="standing_torque_hf", motors="train", statistic="median")
    ratio = chatter.value(model="paper_wide") / chatter.value(model="physical")
    text = (
        "The same models drive a standing and a suspended robot. Torque above 20 Hz should equal that of the physical "
        "motors: more is chatter.",
        "The paper's motors are trained without load and do not carry the robot. paper_wide has the paper's loss, but "
        "the data, period and history of the rollout prior. It is better than a PD on the bench, but in the standing "
        f"robot its torque above 20 Hz is {ratio:.1f} times that of the physical motors: the legs oscillate.",
        "Reason: torque causes acceleration, so a network fitted one step ahead infers the torque from the last change "
        "of velocity. In a simulator this feeds back on itself, see docs/why-the-paper-oscillates.md.",
    )
    pictures = (picture(figure, f"{header['joint']} in a trot on the ground."),)
    return Section("Closed loop inside the robot", text, pictures, (table,))


def replay(folder: Path) -> Section:
    """Real logs; the pictures are of the first two."""
    results = Results.load(folder / "results.json")
    tensors, header = read_tensors(folder / "traces.safetensors")
    pictures = []
    for log in header["logs"][:2]:
        joint = header["joint_names"][int(tensors[f"{log}/joint"])]
        band = (tensors[f"{log}/low"], tensors[f"{log}/high"]) if f"{log}/low" in tensors else None
        time, target, measured = (tensors[f"{log}/{key}"] for key in ("time", "target", "measured"))
        models, title = _by_model(tensors, f"{log}/model/"), f"log {log} · {joint}"
        figure = closed_loop(time, target, measured, models, title, truth_label="measured", band=band)
        pictures.append(picture(figure, f"Log {log}: the real robot and simulated motors."))
    caption = "Joint RMSE [mrad], no offset removed; samples: median (5-95 %)."
    table = Table(("log", "joint", *replay_models(results)), tuple(map(tuple, replay_rows(results))), caption)
    text = (
        "The commands recorded on the real robot are replayed on a simulated one. physical is the central motor of the "
        "fleet, physical_draws are random motors of it. Angles are those of the encoders, as on the robot.",
        "A fleet that was calibrated on logs of this robot is a fit, not a prediction. This holds for the shipped one "
        "and the public logs.",
    )
    return Section("Real robot logs", text, tuple(pictures), (table,))


def no_logs() -> Section:
    """Where to find real logs."""
    text = (
        "No logs were given. Push-up logs of the shipped robot are in the repository jietan/puppersim, folder "
        "puppersim/data/system_id (Apache-2.0). Run the demo again with that folder: finished stages are kept.",
    )
    return Section("Real robot logs", text)


def learning(folders: Mapping[str, Sequence[Path]]) -> Section:
    """Learning curves of trainings: name -> a folder with curve.json per seed."""
    curves: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for name, seeds in folders.items():
        for folder in seeds:
            points = read_json(folder / "curve.json")
            iteration, returns = (np.array([point[key] for point in points]) for key in ("iteration", "mean_return"))
            curves.setdefault(name, []).append((iteration, returns))
    text = (
        "Augmented random search. Each return is measured in the training simulation of the policy, so returns of "
        "different motors are not comparable.",
    )
    shown = picture(learning_curves(curves), "Mean return of the perturbed policies per iteration.")
    return Section("Learning to walk", text, (shown,))


def transfer(folder: Path, robot: Robot) -> Section:
    """The transfer table and films on the twin."""
    results = Results.load(folder / "results.json")
    tensors, _ = read_tensors(folder / "traces.safetensors")
    names = conditions_in(results)
    own, twin = (
        {
            name: (
                results.mean(quantity="speed", motors=motors, model=name),
                results.mean(quantity="upright", motors=motors, model=name),
            )
            for name in names
        }
        for motors in ("own", "twin")
    )
    caption = "Pale: in the training simulation. Full colour: on the twin."
    films = (_gait_film(robot, tensors[f"twin/{name}"], name, "on the twin") for name in names)
    table = Table(TRANSFER_COLUMNS, tuple(map(tuple, transfer_rows(results))), f"{DRAWS} samples of motors, 5 s each.")
    text = (
        "Each policy is evaluated in its training simulation and on the twin, the held-out virtual robot: unseen "
        "physical motors, 1 kHz physics, sensor noise. The twin's motors are the same for all policies.",
        "ideal PD: the gains with the least closed-loop error on the bench; tuned PD: the gains, armature and delay. "
        "Seeds of one condition differ by about 0.1 m/s, so small differences between conditions are not significant.",
    )
    return Section("Transfer", text, (picture(transfer_bars(own, twin), caption), *films), (table,))


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
        "Time upright at the largest commanded speed, with two disturbances varied at a time. Every cell has the same "
        "samples of the training motors, in MuJoCo on flat ground.",
    )
    shown = picture(robustness_maps(maps), f"{ROBUSTNESS_DRAWS} walks of 5 s per cell.")
    return Section("Robustness", text, (shown,))
