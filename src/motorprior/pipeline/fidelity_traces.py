"""What the report draws of a validation: one bench trial, one robot trial, one torque fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.artifacts import write_tensors
from motorprior.bench.dynamometer import run
from motorprior.bench.record import preset_of_period, trial
from motorprior.identification.validate import HELD_OUT_SEED, ModelOfMotors, held_out_trials, teacher_forced_torque
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.replay import replay
from motorprior.simulation.world import World, WorldConfig
from motorprior.transfer.robot_fidelity import trot_targets

TORQUE_STREAM, TROT_STREAM = 41, 43
"""Tags of random streams; never zero, since numpy ignores trailing zeros of a seed."""


def write_traces(
    path: Path, motors: MotorParameters, models: dict[str, ModelOfMotors], priors: dict[str, MotorPrior], seed: int
) -> None:
    """What the report draws: one bench trial, one robot trial, one torque fit."""
    index = np.arange(len(motors))
    case = held_out_trials("impacts", len(motors), seed)[0]
    truth = run(PhysicalActuator(motors), case)
    tensors = {
        "bench/target": case.position_target[:, 0],
        "bench/external": case.external_torque[:, 0],
        "bench/truth": truth.joint_pos[:, 0],
        "bench/torque": truth.joint_torque[:, 0],
    }
    for name, model in models.items():
        tensors[f"bench/model/{name}"] = run(model(index), case).joint_pos[:, 0]
    for name, prior in priors.items():
        tensors |= _torque_traces(name, prior, motors, seed)
    tensors |= _robot_traces(motors, models, seed)
    header = {"bench_dt": case.dt, "robot_dt": spec.CONTROL_DT, "joint": "FR_knee"}
    write_tensors(path, tensors, header)


def _torque_traces(name: str, prior: MotorPrior, motors: MotorParameters, seed: int) -> dict[str, np.ndarray]:
    """The prior shown the true history of 1 s of a sinusoid, on the bench and at the clock of its own logs."""
    period = prior.network.period
    preset = preset_of_period(period)
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TORQUE_STREAM])
    case = trial(rng, "sine", round(1.0 / period) + prior.network.taps[-1], len(motors), preset, hold=False)
    answer = run(PhysicalActuator(motors), case)
    predicted = teacher_forced_torque(prior.network, prior.mean, case, answer)[:, 0]
    known = ~np.isnan(predicted)
    return {
        f"torque/{name}/time": np.arange(len(predicted))[known] * period,
        f"torque/{name}/measured": answer.joint_torque[known, 0],
        f"torque/{name}/predicted": predicted[known],
    }


def _robot_traces(motors: MotorParameters, models: dict[str, ModelOfMotors], seed: int) -> dict[str, np.ndarray]:
    """The right front knee in a standing trot, positions [rad] and torques [N·m] at 2 ms."""
    rng = np.random.default_rng([HELD_OUT_SEED, seed, TROT_STREAM])
    index, targets = np.arange(spec.NUM_JOINTS), trot_targets(rng, 100)
    knee, coarse = spec.JOINT_NAMES.index("FR_knee"), World(WorldConfig())
    fine = World(WorldConfig(physics_dt=spec.TWIN_PHYSICS_DT))
    every = round(spec.PHYSICS_DT / spec.TWIN_PHYSICS_DT)
    truth = replay(fine, PhysicalActuator(motors.take(index)), targets)
    tensors = {
        "robot/target": np.repeat(targets[:, knee], coarse.config.substeps),
        "robot/position/truth": truth.joint_pos[every - 1 :: every, knee],
        "robot/torque/truth": truth.joint_torque[every - 1 :: every, knee],
    }
    for name, model in models.items():
        played = replay(coarse, model(index), targets, tolerate_fault=True)
        tensors[f"robot/position/{name}"] = played.joint_pos[:, knee]
        tensors[f"robot/torque/{name}"] = played.joint_torque[:, knee]
    return {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in tensors.items()}
