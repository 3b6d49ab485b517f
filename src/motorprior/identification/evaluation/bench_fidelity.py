"""Closed-loop fidelity on the bench: joint errors of models against true motors, on held-out excitation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.dynamometer import Response, Trial, run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import BenchPreset, trial
from motorprior.signals import rmse


@dataclass(frozen=True)
class Ensemble:
    """Several models of the same motors, each simulated in closed loop; the prediction is their mean trajectory.

    It is not an actuator, since a simulated robot has only one state.
    """

    members: tuple[Actuator, ...]


# indices of motors -> a model of these motors
ModelOfMotors = Callable[[np.ndarray], Actuator]
PredictorOfMotors = Callable[[np.ndarray], Actuator | Ensemble]

# held-out trials of 1 s, with loads inside the training range; chirp is in no preset of the bench
HELD_OUT = BenchPreset(0.002, 500, (4e-4, 2e-2), ("sine", "gait", "steps", "impacts", "chirp"), 5)
HELD_OUT_SEED = 7_000_000  # of the held-out random streams, never used for training
BENCH_STREAM, WORK_STREAM = 17, 53  # tags of the random streams of held-out trials, and of the motors' working times
MAX_WORK = 20.0  # maximum working time of the motors before a held-out trial [s]; their temperature is unknown
FLOOR_OFFSET = 0.004  # initial position offset of the floor, a second simulation of the same physical motors [rad]
_REPEATS = 4  # trials per excitation


def held_out_trials(kind: str, motors: int, seed: int, preset: BenchPreset = HELD_OUT) -> list[Trial]:
    """Trials of one excitation (``kind``) for all motors, every second one sampled and held at 100 Hz."""
    tags = [HELD_OUT_SEED, seed, preset.kinds.index(kind)]
    rngs = [np.random.default_rng([*tags, repeat, BENCH_STREAM]) for repeat in range(_REPEATS)]
    steps = preset.segment_steps
    return [trial(rng, kind, steps, motors, preset, hold=repeat % 2 == 0) for repeat, rng in enumerate(rngs)]


def seconds_of_work(kind: str, seed: int, preset: BenchPreset = HELD_OUT) -> np.ndarray:
    """(trials,) working time of the motors before each of `held_out_trials` [s], in [0, MAX_WORK]."""
    rng = np.random.default_rng([HELD_OUT_SEED, seed, preset.kinds.index(kind), WORK_STREAM])
    return rng.uniform(0.0, MAX_WORK, _REPEATS)


def bench_errors(
    motors: TrueMotors, models: Mapping[str, PredictorOfMotors], seed: int, preset: BenchPreset = HELD_OUT
) -> dict[str, dict[str, np.ndarray]]:
    """Joint RMSE [rad] per excitation, model and motor: errors[kind][model] of shape (motors,).

    ``physical`` is the floor: the true motors simulated again from a start FLOOR_OFFSET away.
    """
    index = np.arange(len(motors))
    errors: dict[str, dict[str, np.ndarray]] = {}
    for kind in preset.kinds:
        cases = held_out_trials(kind, len(motors), seed, preset)
        truths = [motors.after(seconds).actuator() for seconds in seconds_of_work(kind, seed, preset)]
        answers = [run(truth, case) for truth, case in zip(truths, cases, strict=True)]
        floor = [run(truth, case, FLOOR_OFFSET) for truth, case in zip(truths, cases, strict=True)]
        errors[kind] = {"physical": _mean_rmse(floor, answers)}
        for name, model in models.items():
            errors[kind][name] = _mean_rmse([respond(model(index), case) for case in cases], answers)
    return errors


def respond(model: Actuator | Ensemble, case: Trial) -> Response:
    """The response that the model predicts in a trial."""
    if not isinstance(model, Ensemble):
        return run(model, case)
    answers = [vars(run(member, case)).values() for member in model.members]
    return Response(*(np.mean(values, axis=0) for values in zip(*answers, strict=True)))


def _mean_rmse(responses: list[Response], answers: list[Response]) -> np.ndarray:
    pairs = zip(responses, answers, strict=True)
    return np.mean([rmse(one.joint_pos, other.joint_pos, axis=0) for one, other in pairs], axis=0)


def teacher_forced_torque(network: LatentNetwork, z: np.ndarray, case: Trial, answer: Response) -> np.ndarray:
    """(steps, n) torque on the joint [N·m] of motors z (n, Z) on the true history, one step ahead, as in the paper.

    It is averaged over the following step: the actuator's torque minus its damping and minus armature(z)·acceleration.
    NaN until the history is full. A grey box gets velocities of half a step earlier, as in an engine. Its forces are
    those at the time of the positions, so the average is over two rows and the last row is NaN. ``answer`` is the
    physical motors' response to the trial, whose period is that of the network.
    """
    actuator, velocity = LatentActuator(network, z), answer.joint_vel
    inputs = velocity if network.motor is None else 0.5 * (velocity + np.concatenate([velocity[:1], velocity[:-1]]))
    arrays, torque = actuator.arrays(network.period), np.zeros(answer.joint_pos.shape)
    reset_actuator(arrays, case.position_target[0].copy(), answer.joint_pos[0].copy())
    for row, (target, joint_pos) in enumerate(zip(case.position_target, answer.joint_pos, strict=True)):
        step_actuator(arrays, network.period, target.copy(), joint_pos.copy(), inputs[row].copy(), torque[row])
        torque[row] -= arrays.damping * velocity[row]
    torque -= actuator.armature * np.gradient(velocity, case.dt, axis=0)
    if network.motor is not None:
        torque[:-1], torque[-1] = 0.5 * (torque[:-1] + torque[1:]), np.nan
    torque[: network.taps[-1]] = np.nan
    return torque
