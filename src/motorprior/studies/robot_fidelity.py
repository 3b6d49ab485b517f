"""Closed-loop fidelity inside the robot: models of motors, compared with the physical motors.

All follow the same trot targets, held at 100 Hz for 2 s, standing and suspended. The physical motors run at the twin's
physics step; the floor ("physical") is a second simulation of them that starts 4 mrad away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.families import TrueMotors
from motorprior.exceptions import SimulationFault
from motorprior.identification.evaluation.bench_fidelity import FLOOR_OFFSET, HELD_OUT_SEED, Ensemble, PredictorOfMotors
from motorprior.locomotion.body import body_of
from motorprior.locomotion.trajectory_generator import open_loop_gait
from motorprior.robots.robot import Robot
from motorprior.signals import high_frequency_rms, rmse
from motorprior.simulation.playback import Playback, replay
from motorprior.simulation.world import World

DRAWS = 12
ROBOT_STREAM = 19
STEPS = 200
CUTOFF = 20.0  # [Hz] torque above counts as chatter
FAULT_RMSE = np.pi  # [rad] of a model whose simulation diverges


@dataclass(frozen=True)
class RobotFidelity:
    """Errors by model, (draws,) arrays over samples of motors.

    Attributes:
        rmse: RMSE of the joint angles [rad].
        torque_hf: RMS of the torque above 20 Hz, mean over joints [N·m].
        displacement_error: of the base after 2 s [m]; zero if suspended.
    """

    rmse: dict[str, np.ndarray]
    torque_hf: dict[str, np.ndarray]
    displacement_error: dict[str, np.ndarray]


def trot_targets(robot: Robot, rng: np.random.Generator, steps: int) -> np.ndarray:
    """(steps, joints) targets [rad] of a random trot.

    Frequency 0.4-0.7 of the usual, speed 0.4-0.8 of the maximum, height raised by up to a quarter of the swing height:
    within these bounds the robot does not roll over in open loop.
    """
    body = body_of(robot)
    frequency, forward = rng.uniform(0.4, 0.7) * body.frequency, rng.uniform(0.4, 0.8) * body.max_speed
    height, ratio = rng.uniform(0.0, 0.25) * body.swing_height, float(np.exp(rng.uniform(-0.3, 0.3)))
    return open_loop_gait(body, steps, forward, frequency, height, ratio, robot.control_dt)


def robot_fidelity(
    robot: Robot, motors: TrueMotors, models: Mapping[str, PredictorOfMotors], suspended: bool, seed: int
) -> RobotFidelity:
    """Compare every model, and the floor, over DRAWS samples of one motor per joint."""
    fast = World(robot, suspended=suspended)
    fine = World(robot, robot.twin_physics_dt, suspended)
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for draw in range(DRAWS):
        rng = np.random.default_rng([HELD_OUT_SEED, seed, draw, ROBOT_STREAM])
        index = rng.permutation(len(motors))[: robot.num_joints]
        targets, physical = trot_targets(robot, rng, STEPS), motors.take(index).actuator()
        truth = replay(fine, physical, targets)
        start = robot.nominal_pose + FLOOR_OFFSET * rng.choice([-1.0, 1.0], robot.num_joints)
        rows.setdefault("physical", []).append(compare(replay(fine, physical, targets, start), truth, robot.control_dt))
        for name, model in models.items():
            rows.setdefault(name, []).append(_try(fast, model(index), targets, truth))
    columns = {name: np.array(values).T for name, values in rows.items()}
    return RobotFidelity(*({name: column[i] for name, column in columns.items()} for i in range(3)))


def _try(world: World, model: Actuator | Ensemble, targets: np.ndarray, truth: Playback) -> tuple[float, float, float]:
    members = model.members if isinstance(model, Ensemble) else (model,)
    try:
        found = [replay(world, member, targets) for member in members]
        mean = Playback(*(np.mean([getattr(one, field.name) for one in found], axis=0) for field in fields(Playback)))
        return compare(mean, truth, world.control_dt)
    except SimulationFault:
        return FAULT_RMSE, float("inf"), float("inf")


def compare(model: Playback, truth: Playback, control_dt: float) -> tuple[float, float, float]:
    """RMSE at the ends of control steps [rad], the model's torque above CUTOFF [N·m], base displacement error [m]."""
    error = rmse(_at_control_steps(model), _at_control_steps(truth))
    period = control_dt * len(model.measured_joint_pos) / len(model.joint_torque)
    chatter = float(high_frequency_rms(model.joint_torque, period, CUTOFF).mean())
    apart = model.base[-1:, :2] - truth.base[-1:, :2]
    return float(error), chatter, float(np.hypot(apart[:, 0], apart[:, 1]).sum())


def _at_control_steps(recorded: Playback) -> np.ndarray:
    substeps = len(recorded.joint_pos) // len(recorded.measured_joint_pos)
    return recorded.joint_pos[substeps - 1 :: substeps]
