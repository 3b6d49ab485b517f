"""Simulate position targets or an excitation on chosen motors, and record a motor log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.excitation import excitation_named
from motorprior.bounds import generator_of, require_finite
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import MotorSource, motor_sampler
from motorprior.simulation.playback import Playback, replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig


def simulate(
    robot: Robot | str | Path,
    motors: MotorSource,
    targets: np.ndarray,
    *,
    seed: int | np.random.Generator = 0,
    suspended: bool = False,
) -> Playback:
    """Simulate a robot that starts at rest in its nominal pose; each row of ``targets`` lasts one control step.

    Args:
        robot: a name, the path of a .toml file, or the result of `load_robot`; with legs or without.
        motors: one per joint, or a prior, posterior or fleet to sample.
        targets: (C, joints) position targets [rad], in the order of ``robot.joint_names``.
        seed: of the sample of motors.
        suspended: suspend a free base in the air.

    Returns:
        Angles [rad] and torques [N·m] of every physics step, encoders and base of every control step.

    Raises:
        ConfigError: motors or targets that do not fit the robot.
        ArtifactError: a robot that cannot be read.
        SimulationFault: NaN, a reset or a full buffer of the engine.
    """
    robot = as_robot(robot)
    draw, physics_dt = motor_sampler(motors, robot)
    wanted = require_finite("targets", targets, (len(targets), robot.num_joints))
    world = World(WorldConfig.of(robot, physics_dt=physics_dt, suspended=suspended))
    return replay(world, draw(generator_of(seed)), wanted)


def excitation_targets(robot: Robot, kind: str, seconds: float, amplitude: float, seed: int) -> np.ndarray:
    """(control steps, joints) targets [rad]: every joint has its own signal about the nominal pose.

    Raises:
        ConfigError: an unknown excitation.
    """
    signal = excitation_named(kind).target
    rng = np.random.default_rng([seed, 0x51E7])  # not the random stream of the motors
    steps = max(2, round(seconds / robot.control_dt))
    away = np.stack([signal(rng, steps, robot.control_dt) for _ in robot.joints], axis=1)
    away *= amplitude / np.maximum(1e-9, np.abs(away).max(axis=0))
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def simulated_log(robot: Robot, motors: Actuator, targets: np.ndarray, physics_dt: float) -> MotorLog:
    """Log of the motors of a fixed or suspended robot, a row per physics step; velocities are differences of angles."""
    world = World(WorldConfig.of(robot, physics_dt=physics_dt, suspended=robot.base == "free"))
    played, every = replay(world, motors, targets, targets[0]), round(robot.physics_dt / physics_dt)
    rows = slice(every - 1, None, every)
    substeps = round(robot.control_dt / robot.physics_dt)
    joint_pos = np.concatenate([targets[:1], played.joint_pos[rows][:-1]])
    log = MotorLog(
        time=robot.physics_dt * np.arange(len(joint_pos)),
        position_target=np.repeat(targets, substeps, axis=0),
        joint_pos=joint_pos,
        joint_vel=np.gradient(joint_pos, robot.physics_dt, axis=0),
        joint_torque=None,
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=f"simulated {robot.name}",
        encoder="joint",
    )
    return checked(log, where=log.source)
