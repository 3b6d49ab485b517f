"""The chapters of the report, each from the files of one stage."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.families import FAMILIES
from motorprior.report.gait_sections import gait_pictures
from motorprior.report.latent_directions import behaviour_directions, best_explained
from motorprior.report.page import Section, Table, picture
from motorprior.report.plots_latent import latent_map
from motorprior.report.plots_motor import closed_loop, excitation_and_response, torque_fit
from motorprior.report.plots_robot import real_replay, robot_traces
from motorprior.report.plots_study import fidelity_bars, transfer_bars
from motorprior.report.tables import (
    TRANSFER_COLUMNS,
    by_model,
    conditions_in,
    fidelity_rows,
    replay_models,
    replay_rows,
    transfer_rows,
)
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.transfer.metrics import BENCH_METRICS, MODELS, ROBOT_METRICS

_RESULTS = "results.json"
_LATENT_PANELS = 6


def _by_model(tensors: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name: tensors[prefix + name] for name in MODELS if prefix + name in tensors}


def bench(run: Path) -> list[Section]:
    """Excitation and response of the first motor, both presets."""
    pictures = []
    for preset, segment, text in (
        ("rollout", 3, "gait and blows"),
        ("paper", 0, "sinusoid"),
    ):
        log, _ = read_bench(run / "bench" / preset)
        part = log.rows(log.segment_slices()[min(segment, len(log.segment_slices()) - 1)]).joint(0)
        first = slice(0, min(part.num_rows, 700))
        time = part.time[first] - part.time[0]
        columns = (part.position_target, part.joint_pos, part.joint_vel, part.joint_torque, part.external_torque)
        arrays = [None if column is None else column[first, 0] for column in columns]
        assert arrays[0] is not None and arrays[1] is not None
        title = f"Preset {preset}: {text}"
        figure = excitation_and_response(time, arrays[0], arrays[1], *arrays[2:], title=title)
        pictures.append(picture(figure, f"Bench preset {preset}, first motor.", f"{preset} excitation and response"))
    _, facts = read_bench(run / "bench" / "rollout")
    count = f"{facts.motors} physical motors of fleet {facts.fleet.name}"
    lead = f"{count} on a virtual dynamometer, {facts.steps} steps each."
    body = (f"{FAMILIES[facts.fleet.family].motor} No two motors are alike.",)
    return [Section("Bench: excitation and response", lead, body, tuple(pictures))]


def identify(run: Path) -> list[Section]:
    """The latent map of the training motors."""
    prior = MotorPrior.load(run / "priors" / "rollout" / "prior.safetensors")
    motors = read_bench(run / "bench" / "rollout")[1].physical_motors()
    directions = behaviour_directions(prior.network) if prior.network.num_latents > 1 else None
    points = prior.mean if directions is None else prior.mean @ directions.axes
    constants = {field.name: getattr(motors, field.name) for field in fields(motors)}
    known = best_explained(points, constants, _LATENT_PANELS)
    figure = latent_map(prior.mean, prior.log_var, known, directions)
    body = (
        "Each training motor owns a mean and a variance of z. A new motor is a draw z ~ N(0, I): the circles. The "
        "training never saw the physical parameters that colour the dots. Of all directions of z the map shows the two "
        "along which motors behave most differently on the standard bench (gain, lag, friction, stall, speed), and of "
        "all constants those that the two directions explain best, by R², best first.",
    )
    shown = picture(figure, f"The {len(prior.mean)} training motors in the latent space.", "latent map")
    return [
        Section("Motor prior: what makes motors differ", "A latent z per motor, learned from logs.", body, (shown,))
    ]


def validate(run: Path) -> list[Section]:
    """Torque fit, closed loop on the bench, and inside the robot."""
    results = Results.load(run / "validate" / _RESULTS)
    tensors, header = read_tensors(run / "validate" / "traces.safetensors")
    return [
        _torque_section(tensors),
        _bench_section(tensors, header, results),
        _robot_section(tensors, header, results),
    ]


def _torque_section(tensors: dict[str, np.ndarray]) -> Section:
    pictures = []
    for name in ("paper", "paper_wide", "rollout"):
        prefix = f"torque/{name}/"
        if prefix + "time" in tensors:
            time, measured, predicted = (tensors[prefix + key] for key in ("time", "measured", "predicted"))
            figure = torque_fit(time, measured, {name: predicted})
            pictures.append(picture(figure, f"{name}: torque from the true history.", f"torque fit of {name}"))
    lead = "Shown the true history, every network predicts torque: that is what the paper trains for."
    body = ("A small error here says nothing about the closed loop: see the next chapter.",)
    return Section("Torque fit: open loop, one step", lead, body, tuple(pictures))


def _fidelity_table(results: Results, columns: tuple[str, ...], caption: str) -> Table:
    titles = tuple(column.replace("_", " ").replace("hf", "> 20 Hz") for column in columns)
    return Table(("model", *titles), tuple(tuple(row) for row in fidelity_rows(results, columns)), caption)


def _bench_section(tensors: dict[str, np.ndarray], header: dict[str, Any], results: Results) -> Section:
    time = np.arange(len(tensors["bench/target"])) * header["bench_dt"]
    figure = closed_loop(
        time, tensors["bench/target"], tensors["bench/truth"], _by_model(tensors, "bench/model/"), "gait + impacts"
    )
    shown = picture(figure, "One held-out trial: every model in its own closed loop.", "closed-loop traces")
    caption = "Joint RMSE [rad] over 1 s, median of the motors. physical: the floor."
    table = _fidelity_table(results, tuple(BENCH_METRICS), caption)
    ratio = results.value(quantity="armature_ratio", model="rollout")
    lead = "One loaded joint, held-out excitation, compared with the physical motor."
    body = (
        "The motors are the training motors, each at the mean of its posterior; what is held out is the excitation.",
        f"The armature that rollout decodes from z is {ratio:.2f} of the rotors' own on "
        "average, though no log says what a rotor is: it is found from motion alone.",
    )
    return Section("Closed loop on the bench", lead, body, (shown,), (table,))


def _robot_section(tensors: dict[str, np.ndarray], header: dict[str, Any], results: Results) -> Section:
    positions, torques = (_by_model(tensors, f"robot/{kind}/") for kind in ("position", "torque"))
    time = np.arange(len(tensors["robot/target"])) * header["robot_dt"]
    traces = robot_traces(
        time, tensors["robot/position/truth"], positions, tensors["robot/torque/truth"], torques, header["joint"],
        "standing trot",
    )  # fmt: skip
    caption = (
        "Joint RMSE [rad] and torque above 20 Hz [N·m], medians of 12 draws of motors. The torque should be "
        "like the physical motors' own: more is chatter, less is missing life."
    )
    table = _fidelity_table(results, ROBOT_METRICS, caption)
    metrics = {"standing_rmse": "standing [rad]", "hung_rmse": "hung [rad]"}
    bars = {title: by_model(results, quantity) for quantity, title in metrics.items()}
    pictures = (
        picture(traces, f"{header['joint']} in a trot on the ground.", "traces inside the robot"),
        picture(fidelity_bars(bars), "Inside the robot.", "fidelity inside the robot"),
    )
    lead = "The same models as the motors of a standing and of a hung robot."
    torque = by_model(results, "standing_torque_hf")
    chatter = torque["paper_wide"] / torque["physical"]
    body = (
        "The paper's motors never carried a load on their bench, and here they cannot carry the robot. The control "
        "paper_wide has the paper's loss on the data, the clock and the history of the rollout prior: better than "
        f"a PD on the bench, but in the standing robot its torque above 20 Hz is {chatter:.1f} times the physical "
        "motors' own. The legs oscillate.",
        "Why: torque causes acceleration, so a network fitted one step ahead reads the torque off the last change of "
        "velocity, and in a simulator that feeds back on itself on every joint lighter than its motor. The page "
        "docs/why-the-paper-oscillates.md takes the loop apart.",
    )
    return Section("Closed loop inside the robot", lead, body, pictures, (table,))


def replay(run: Path) -> list[Section]:
    """Real logs."""
    results = Results.load(run / "replay" / _RESULTS)
    tensors, header = read_tensors(run / "replay" / "traces.safetensors")
    pictures = []
    for log in header["logs"]:
        joint = header["joint_names"][int(tensors[f"{log}/joint"])]
        models = _by_model(tensors, f"{log}/model/")
        band = (tensors[f"{log}/low"], tensors[f"{log}/high"]) if f"{log}/low" in tensors else None
        time, target, measured = (tensors[f"{log}/{key}"] for key in ("time", "target", "measured"))
        figure = real_replay(time, target, measured, models, band, joint, f"log {log}")
        pictures.append(picture(figure, f"Log {log}: the real robot and simulated motors.", f"replay of {log}"))
    columns = ("log", "joint", *replay_models(results))
    rows = tuple(tuple(row) for row in replay_rows(results))
    caption = "Joint RMSE [mrad], start included, nothing subtracted; draws: median (5-95 %)."
    lead = "The commands of the real robot, replayed on a simulated one."
    body = (
        "physical is the central motor of the fleet, physical_draws are random motors of it, and the prior's draws are "
        "what was learned from such motors. All are read at the encoders on their rotors, as the robot is.",
        "A fleet that was calibrated on logs of this robot is a fit, not a prediction: the shipped one was, on the "
        "public logs among others.",
    )
    return [Section("Real robot logs", lead, body, tuple(pictures), (Table(columns, rows, caption),))]


def no_logs() -> Section:
    """Where real logs come from."""
    body = (
        "Push-up logs of the shipped robot are in the repository jietan/puppersim, folder "
        "puppersim/data/system_id (Apache-2.0). Run the demo again with the folder of such logs: the "
        "finished stages are kept.",
    )
    return Section("Real robot logs", "None were given.", body)


def transfer(run: Path, robot: Robot) -> list[Section]:
    """The transfer table and the gaits."""
    results = Results.load(run / "transfer" / _RESULTS)
    tensors, header = read_tensors(run / "transfer" / "traces.safetensors")
    names = conditions_in(results)
    pairs = [
        {
            name: (
                results.mean(quantity="speed", motors=place, model=name),
                results.mean(quantity="upright", motors=place, model=name),
            )
            for name in names
        }
        for place in ("own", "twin")
    ]
    bars = picture(transfer_bars(*pairs), "Own simulation and twin.", "speed and time upright")
    pictures = [
        bars,
        *(
            image
            for name in names
            for image in gait_pictures(robot, tensors[f"twin/{name}"], header["control_dt"], name, "on the twin")
        ),
    ]
    table = Table(TRANSFER_COLUMNS, tuple(tuple(row) for row in transfer_rows(results)), "24 motor draws of 5 s each.")
    lead = "Every policy where it was trained, and on the held-out twin: unseen physical motors, 1 kHz physics, noise."
    body = (
        "The twin's draws are the same for every policy. The ideal PD has the gains, and the tuned PD the gains, "
        "armature and delay, with the least closed-loop error on the bench. Policies of one condition differ by "
        "0.1 m/s from seed to seed: small differences between conditions mean little.",
    )
    return [Section("Transfer", lead, body, tuple(pictures), (table,))]


def highlights(results: Results) -> tuple[tuple[str, str], ...]:
    """The four numbers to see first; policies are means over seeds."""
    errors = by_model(results, "bench_impact_rmse")
    rollout, ideal, tuned = (
        f"{results.mean(quantity='speed', motors='twin', model=name):.2f} m/s"
        for name in ("rollout", "ideal_pd", "tuned_pd")
    )
    return (
        (
            f"{errors['rollout'] / errors['ideal_pd']:.2f} ×",
            "closed-loop error of the learned motors over the ideal PD's, gait with impacts",
        ),
        (rollout, "on the twin, trained on the learned prior"),
        (ideal, "on the twin, trained on an ideal PD with fitted gains"),
        (tuned, "on the twin, trained on a PD with fitted armature and delay"),
    )
