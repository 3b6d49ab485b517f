"""Closed-loop fidelity of models of motors, on the bench and inside the robot.

The models are compared with the physical motors. Inside the robot all models follow the same trot
targets, held at 100 Hz for 2 s, standing and suspended. The physical motors run at the twin's
physics step. The floor ("physical") is a second simulation of the physical motors that starts 4
mrad away.
"""

from collections.abc import Callable, Mapping

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.evaluation.errors import MAX_ERROR, capped
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.gait import open_loop_gait, walker_arrays
from motorprior.progress import Task
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.signals import rmse
from motorprior.simulation.playback import Playback, replay
from motorprior.simulation.world import World
from spectra import high_frequency_rms
from virtual_fleets.held_out_trials import (
    FLOOR_OFFSET,
    HELD_OUT,
    HELD_OUT_SEED,
    ModelOfMotors,
    bench_errors,
)

BENCH_METRICS = {
    "bench_sine_rmse": "sine",
    "bench_gait_rmse": "gait",
    "bench_steps_rmse": "steps",
    "bench_impact_rmse": "impacts",
    "bench_chirp_rmse": "chirp",
}
ROBOT_METRICS = ("standing_rmse", "suspended_rmse", "standing_torque_hf", "suspended_torque_hf")
# joint RMSE [rad] and torque above 20 Hz [N·m], over motors and trials; robots without legs have
# only the bench's
FIDELITY_METRICS = (*BENCH_METRICS, *ROBOT_METRICS)
POSTURES = {"standing": False, "suspended": True}  # posture -> whether the robot is suspended
# torque [N·m] and displacement [m] of a model whose simulation diverges; its angle error is
# MAX_ERROR
DIVERGED = 1e3
NUM_SAMPLES = 12  # samples of one motor per joint
ROBOT_STREAM = 19  # tag of a random stream
STEPS = 200
CUTOFF = 20.0  # [Hz] torque above counts as chatter


def fidelity(
    robot: Robot,
    motors: TrueMotors,
    models: Mapping[str, ModelOfMotors],
    motor_set: str,
    seed: int,
    task: Task,
) -> Results:
    """Medians and means of `FIDELITY_METRICS`, and the median displacement error of the base.

    ``task`` advances three times for a robot with legs, otherwise once.
    """
    # (quantity, unit) -> model -> values of motors or of samples
    measured: dict[tuple[str, str], Mapping[str, np.ndarray]] = {}
    errors = bench_errors(motors, models, seed, HELD_OUT.for_robot(robot))
    for quantity, excitation in BENCH_METRICS.items():
        measured[quantity, "rad"] = errors[excitation]
    task.advance()

    for posture, suspended in POSTURES.items() if robot.legs else ():
        of_models = robot_fidelity(robot, motors, models, suspended, seed)
        quantities = [("rmse", "rad"), ("torque_hf", "N·m")]
        if not suspended:
            quantities.append(("displacement_error", "m"))
        for row, (quantity, unit) in enumerate(quantities):
            by_model = {name: values[row] for name, values in of_models.items()}
            measured[f"{posture}_{quantity}", unit] = by_model
        task.advance()
    return _statistics(measured, motor_set)


def _statistics(
    measured: Mapping[tuple[str, str], Mapping[str, np.ndarray]], motor_set: str
) -> Results:
    """Median and mean of each quantity and model; of displacements only the median."""
    statistics: dict[str, Callable[[np.ndarray], np.floating]] = {
        "median": np.median,
        "mean": np.mean,
    }
    rows = []
    for (quantity, unit), by_model in measured.items():
        for model, values in by_model.items():
            for statistic, function in statistics.items():
                if unit != "m" or statistic == "median":
                    value = float(function(values))
                    rows.append(Result(quantity, unit, value, model, motor_set, statistic))
    return Results(rows)


def trot_targets(robot: Robot, rng: np.random.Generator, steps: int) -> np.ndarray:
    """(steps, joints) targets [rad] of a random trot.

    Frequency 0.4-0.7 of the usual, speed 0.4-0.8 of the maximum, height raised by up to a quarter
    of the swing height: within these bounds the robot does not roll over in open loop.
    """
    walker = walker_arrays(robot)
    frequency = rng.uniform(0.4, 0.7) * walker.frequency
    forward = rng.uniform(0.4, 0.8) * walker.max_speed
    height = rng.uniform(0.0, 0.25) * walker.swing_height
    ratio = float(np.exp(rng.uniform(-0.3, 0.3)))
    return open_loop_gait(walker, steps, forward, frequency, height, ratio)


def robot_fidelity(
    robot: Robot,
    motors: TrueMotors,
    models: Mapping[str, ModelOfMotors],
    suspended: bool,
    seed: int,
) -> dict[str, np.ndarray]:
    """(3, samples) results of `compare_playbacks`, by model and of the floor.

    A simulation that diverged has the largest values.
    """
    fast = World(robot, suspended=suspended)
    fine = World(robot, robot.twin_physics_dt, suspended)
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for sample in range(NUM_SAMPLES):
        rng = np.random.default_rng([HELD_OUT_SEED, seed, sample, ROBOT_STREAM])
        index = rng.permutation(len(motors))[: robot.num_joints]
        targets = trot_targets(robot, rng, STEPS)

        physical = motors.take(index).actuator()
        truth = replay(fine, physical, targets)
        start = robot.nominal_pose + FLOOR_OFFSET * rng.choice([-1.0, 1.0], robot.num_joints)
        floor = replay(fine, physical, targets, start)

        rows.setdefault("physical", []).append(compare_playbacks(floor, truth, robot.control_dt))
        for name, model in models.items():
            rows.setdefault(name, []).append(_compared(fast, model(index), targets, truth))

    limits = np.array([[MAX_ERROR], [DIVERGED], [DIVERGED]])
    return {name: capped(np.array(values).T, limits) for name, values in rows.items()}


def _compared(
    world: World, model: Actuator, targets: np.ndarray, truth: Playback
) -> tuple[float, float, float]:
    """`compare_playbacks` of a model; infinite if its simulation diverges."""
    try:
        return compare_playbacks(replay(world, model, targets), truth, world.control_dt)
    except SimulationFault:
        return np.inf, np.inf, np.inf


def compare_playbacks(
    model: Playback, truth: Playback, control_dt: float
) -> tuple[float, float, float]:
    """RMSE at the ends of control steps [rad], torque above CUTOFF [N·m], displacement error [m].

    The torque is that of the model; the displacement is that of the base, from start to end.
    """
    error = rmse(_at_control_steps(model), _at_control_steps(truth))
    period = control_dt * len(model.measured_joint_pos) / len(model.joint_torque)
    chatter = float(high_frequency_rms(model.joint_torque, period, CUTOFF).mean())
    apart = model.base[-1:, :2] - truth.base[-1:, :2]
    displacement = float(np.hypot(apart[:, 0], apart[:, 1]).sum())
    return float(error), chatter, displacement


def _at_control_steps(playback: Playback) -> np.ndarray:
    substeps = len(playback.joint_pos) // len(playback.measured_joint_pos)
    return playback.joint_pos[substeps - 1 :: substeps]
