"""Traces of a validation for the report: one bench trial, one robot trial, one torque fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_tensors
from motorprior.bench.dynamometer import run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import preset_of_period, trial
from motorprior.identification.evaluation.bench_fidelity import (
    HELD_OUT,
    HELD_OUT_SEED,
    ModelOfMotors,
    held_out_trials,
    teacher_forced_torque,
)
from motorprior.robots.robot import Robot
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.robot_fidelity import trot_targets

TORQUE_STREAM, TROT_STREAM = 41, 43  # tags of random streams; never zero, since numpy ignores trailing zeros of a seed


def write_traces(
    path: Path,
    robot: Robot,
    motors: TrueMotors,
    models: dict[str, ModelOfMotors],
    priors: dict[str, MotorPrior],
    seed: int,
) -> None:
    """Simulate the physical motors and all models, and write the traces."""
    index = np.arange(len(motors))
    case = held_out_trials("impacts", len(motors), seed, HELD_OUT.for_robot(robot))[0]
    truth = run(motors.actuator(), case)
    tensors = {
        "bench/target": case.position_target[:, 0],
        "bench/external": case.external_torque[:, 0],
        "bench/truth": truth.joint_pos[:, 0],
        "bench/torque": truth.joint_torque[:, 0],
    }
    for name, model in models.items():
        tensors[f"bench/model/{name}"] = run(model(index), case).joint_pos[:, 0]
    for name, prior in priors.items():
        tensors |= _torque_traces(name, robot, prior, motors, seed)
    header = {"bench_dt": case.dt}
    if robot.legs:
        joint = robot.legs[0].joints[-1]
        tensors |= _robot_traces(robot, joint, motors, models, seed)
        header |= {"robot_dt": robot.physics_dt, "joint": robot.joint_names[joint]}
    write_tensors(path, tensors, header)


def _torque_traces(name: str, robot: Robot, prior: MotorPrior, motors: TrueMotors, seed: int) -> dict[str, np.ndarray]:
    """Torque of the prior from the true history of 1 s of a sinusoid on the bench, at its own sample period."""
    period = prior.network.period
    preset = preset_of_period(period).for_robot(robot)
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TORQUE_STREAM])
    case = trial(rng, "sine", round(1.0 / period) + prior.network.taps[-1], len(motors), preset, hold=False)
    answer = run(motors.actuator(), case)
    predicted = teacher_forced_torque(prior.network, prior.mean, case, answer)[:, 0]
    valid = ~np.isnan(predicted)
    return {
        f"torque/{name}/time": np.arange(len(predicted))[valid] * period,
        f"torque/{name}/measured": answer.joint_torque[valid, 0],
        f"torque/{name}/predicted": predicted[valid],
    }


def _robot_traces(
    robot: Robot, joint: int, motors: TrueMotors, models: dict[str, ModelOfMotors], seed: int
) -> dict[str, np.ndarray]:
    """One joint in a standing trot, positions [rad] and torques [N·m] at every physics step."""
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TROT_STREAM])
    index, targets = np.arange(robot.num_joints), trot_targets(robot, rng, 100)
    coarse, fine = (World(robot, dt) for dt in (robot.physics_dt, robot.twin_physics_dt))
    every = round(robot.physics_dt / robot.twin_physics_dt)
    truth = replay(fine, motors.take(index).actuator(), targets)
    tensors = {
        "robot/target": np.repeat(targets[:, joint], coarse.substeps),
        "robot/position/truth": truth.joint_pos[every - 1 :: every, joint],
        "robot/torque/truth": truth.joint_torque[every - 1 :: every, joint],
    }
    for name, model in models.items():
        played = replay(coarse, model(index), targets, tolerate_fault=True)
        tensors[f"robot/position/{name}"] = played.joint_pos[:, joint]
        tensors[f"robot/torque/{name}"] = played.joint_torque[:, joint]
    return {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in tensors.items()}
