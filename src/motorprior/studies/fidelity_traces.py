"""Traces of a validation for the report: one bench trial, one robot trial, one torque fit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_tensors
from motorprior.bench.dynamometer import run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import preset_of_period, trial
from motorprior.identification.evaluation.bench_truth import HELD_OUT, HELD_OUT_SEED, ModelOfMotors, held_out_trials
from motorprior.robots.robot import Robot
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.robot_fidelity import trot_targets

TORQUE_STREAM, TROT_STREAM = 41, 43  # tags of random streams; never zero, since numpy ignores trailing zeros of a seed


def write_traces(
    path: Path,
    robot: Robot,
    motors: TrueMotors,
    models: Mapping[str, ModelOfMotors],
    priors: Mapping[str, MotorPrior],
    seed: int,
) -> None:
    """Simulate the physical motors and all models, and write the traces."""
    index = np.arange(len(motors))
    case = held_out_trials("impacts", motors, seed, HELD_OUT.for_robot(robot))[0][0]
    truth = run(motors.actuator(), case)
    tensors = {"bench/target": case.position_target[:, 0], "bench/truth": truth.joint_pos[:, 0]}
    tensors |= {f"bench/model/{name}": run(model(index), case).joint_pos[:, 0] for name, model in models.items()}
    for name, prior in priors.items():
        if not isinstance(prior.model, GreyBox):
            tensors |= _torque_traces(f"torque/{name}", robot, prior.model, prior, motors, seed)
    header = {"bench_dt": case.dt}
    if robot.legs:
        joint = robot.legs[0].joints[-1]
        tensors |= _robot_traces(robot, joint, motors, models, seed)
        header |= {"robot_dt": robot.physics_dt, "joint": robot.joint_names[joint]}
    write_tensors(path, tensors, header)


def _torque_traces(
    name: str, robot: Robot, network: LatentNetwork, prior: MotorPrior, motors: TrueMotors, seed: int
) -> dict[str, np.ndarray]:
    """Torque on the first joint [N·m] one step ahead, as in the paper: a network on the true motion of 1 s of a sine.

    It is the actuator's torque minus its damping and minus armature·acceleration, from the first full history on.
    """
    period, first = network.period, network.taps[-1]
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TORQUE_STREAM])
    preset = preset_of_period(period).for_robot(robot)
    case = trial(rng, "sine", round(1.0 / period) + first, len(motors), preset, hold=False)
    truth, actuator = run(motors.actuator(), case), prior.training_motors(np.arange(len(motors)))
    arrays, torque = actuator.arrays(period), np.zeros(truth.joint_pos.shape)
    reset_actuator(arrays, case.position_target[0].copy(), truth.joint_pos[0].copy())
    for row, velocity in enumerate(truth.joint_vel):
        target, joint_pos = case.position_target[row].copy(), truth.joint_pos[row].copy()
        step_actuator(arrays, period, target, joint_pos, velocity.copy(), torque[row])
        torque[row] -= arrays.damping * velocity
    torque -= actuator.armature * np.gradient(truth.joint_vel, case.dt, axis=0)
    return {
        f"{name}/time": np.arange(first, len(torque)) * period,
        f"{name}/measured": truth.joint_torque[first:, 0],
        f"{name}/predicted": torque[first:, 0],
    }


def _robot_traces(
    robot: Robot, joint: int, motors: TrueMotors, models: Mapping[str, ModelOfMotors], seed: int
) -> dict[str, np.ndarray]:
    """One joint in a standing trot, positions [rad] and torques [N·m] at every physics step."""
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TROT_STREAM])
    index, targets = np.arange(robot.num_joints), trot_targets(robot, rng, 100)
    coarse, fine = (World(robot, dt) for dt in (robot.physics_dt, robot.twin_physics_dt))
    every = round(robot.physics_dt / robot.twin_physics_dt)
    truth = replay(fine, motors.take(index).actuator(), targets)
    tensors = {
        "robot/position/truth": truth.joint_pos[every - 1 :: every, joint],
        "robot/torque/truth": truth.joint_torque[every - 1 :: every, joint],
    }
    for name, model in models.items():
        played = replay(coarse, model(index), targets, tolerate_fault=True)
        tensors[f"robot/position/{name}"] = played.joint_pos[:, joint]
        tensors[f"robot/torque/{name}"] = played.joint_torque[:, joint]
    return {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in tensors.items()}
