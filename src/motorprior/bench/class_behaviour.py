"""Behaviour of a prior's classes of joints on a bench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.geared_motor_step import STRIBECK_VELOCITY
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial, run

LOAD = 3.0  # inertia of the load over the motor's armature [-]
SETTLE, STEP, STEP_DURATION = 0.1, 0.2, 1.5  # before the step [s], its height [rad], time after it [s]
CHIRP, CHIRP_DURATION, CHIRP_AMPLITUDE = (0.5, 8.0), 4.0, 0.1  # first and last frequency [Hz], [s], [rad]
SPEEDS = np.linspace(0.0, 6.0, 61)  # at which friction is evaluated [rad/s]
NUM_SAMPLES = 100


@dataclass(frozen=True)
class ClassBehaviour:
    """Responses of samples of one class and of its training motors: name -> (D, T) and (M, T)."""

    name: str
    axes: dict[str, np.ndarray]  # (T,) time [s], or speed [rad/s]
    sampled: dict[str, np.ndarray]
    training_motors: dict[str, np.ndarray]


def class_behaviours(prior: MotorPrior) -> list[ClassBehaviour]:
    """Step and chirp response [rad] on a load of LOAD, and friction [N·m] of grey boxes, of NUM_SAMPLES samples."""
    found = []
    for name in prior.classes.names:
        sampled = prior.sample((name,) * NUM_SAMPLES, np.random.default_rng([0, len(found)]))
        trained = prior.training_motors(prior.classes.rows_of(name))
        inertia = LOAD * float(np.median(_armature(trained)))
        responses, axes = _responses(sampled, inertia), {}
        for key, values in responses.items():
            axes[key] = SPEEDS if key == "friction" else prior.model.period * np.arange(values.shape[1])
        found.append(ClassBehaviour(name, axes, responses, _responses(trained, inertia)))
    return found


def _responses(motors: Actuator, inertia: float) -> dict[str, np.ndarray]:
    period, load = _period(motors), np.full(motors.num_motors, inertia)
    found = {"step": run(motors, _step(load, period)).joint_pos.T}
    time, (low, high) = np.arange(0.0, CHIRP_DURATION, period), CHIRP
    phase = 2.0 * np.pi * time * (low + 0.5 * (high - low) * time / CHIRP_DURATION)
    found["chirp"] = run(motors, _trial(CHIRP_AMPLITUDE * np.sin(phase), load, period)).joint_pos.T
    if isinstance(motors, GreyBoxActuator):
        values = {name: value[:, None] for name, value in motors.constants().items()}
        stribeck = values["stribeck_torque"] / (1.0 + (SPEEDS / STRIBECK_VELOCITY) ** 2)
        found["friction"] = values["coulomb"] + stribeck + values["viscous_damping"] * SPEEDS
    return found


def _armature(motors: Actuator) -> np.ndarray:
    return motors.constants()["armature"] if isinstance(motors, GreyBoxActuator) else np.maximum(motors.armature, 1e-3)


def _period(motors: Actuator) -> float:
    return motors.model.period if isinstance(motors, GreyBoxActuator) else 0.002


def _step(load: np.ndarray, period: float) -> Trial:
    target = np.full(round((SETTLE + STEP_DURATION) / period), STEP)
    target[: round(SETTLE / period)] = 0.0
    return _trial(target, load, period)


def _trial(target: np.ndarray, load: np.ndarray, period: float) -> Trial:
    """All joints with one target (T,), without external torque."""
    targets = np.broadcast_to(target[:, None], (len(target), len(load)))
    return Trial(targets, np.zeros(targets.shape), load, period)
