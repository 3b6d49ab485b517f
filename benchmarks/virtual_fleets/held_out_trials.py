"""Models compared with the true motors of a virtual fleet, in held-out trials on the bench.

Trials last 1 s, with loads inside the training range. Chirps are in no schedule of the bench. The
motors worked for an unknown time of at most MAX_WORK before each trial. The floor ``physical`` is
the true motors simulated again from a start FLOOR_OFFSET away.
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.recording import BenchSchedule, bench_trial
from motorprior.evaluation.bands import (
    LEVELS,
    inside_bands,
    latent_samples,
    sample_residual_scale,
    sample_residuals,
)
from motorprior.evaluation.errors import capped
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.results import Result, Results
from motorprior.signals import rmse

# indices of motors -> a model of these motors
ModelOfMotors: TypeAlias = Callable[[np.ndarray], Actuator]

HELD_OUT = BenchSchedule(0.002, 500, (4e-4, 2e-2), ("sine", "gait", "steps", "impacts", "chirp"), 5)
HELD_OUT_SEED = 7_000_000  # seed of held-out random streams, never used for training
MAX_WORK = 20.0  # [s]
FLOOR_OFFSET = 0.004  # [rad]
_REPEATS = 4  # trials per excitation
_COVERED = 2  # trials per excitation for the coverage: one held at 100 Hz, one not
# tags of random streams
_TRIALS = 17
_WORK = 53
_COVERAGE_STREAM = 23


def held_out_trials(
    excitation: str, motors: TrueMotors, seed: int, schedule: BenchSchedule = HELD_OUT
) -> list[tuple[Trial, Actuator]]:
    """Trials of one excitation for all motors, and the motors after their work before each trial.

    Commands of every second trial are held at 100 Hz.
    """
    tags = [HELD_OUT_SEED, seed, schedule.excitations.index(excitation)]
    work = np.random.default_rng([*tags, _WORK]).uniform(0.0, MAX_WORK, _REPEATS)

    trials = []
    for repeat in range(_REPEATS):
        rng = np.random.default_rng([*tags, repeat, _TRIALS])
        hold = repeat % 2 == 0
        trial = bench_trial(rng, excitation, schedule.segment_steps, len(motors), schedule, hold)
        trials.append((trial, motors.after(work[repeat]).actuator()))
    return trials


def bench_errors(
    motors: TrueMotors,
    models: Mapping[str, ModelOfMotors],
    seed: int,
    schedule: BenchSchedule = HELD_OUT,
) -> dict[str, dict[str, np.ndarray]]:
    """Mean joint RMSE [rad] over the trials of an excitation, `capped`.

    Returns:
        errors[excitation][model] of shape (motors,), with the floor as the model ``physical``.
    """
    index = np.arange(len(motors))
    errors: dict[str, dict[str, np.ndarray]] = {}
    for excitation in schedule.excitations:
        trials = held_out_trials(excitation, motors, seed, schedule)
        true_pos = np.array([run(truth, trial).joint_pos for trial, truth in trials])

        responses = {"physical": [run(truth, trial, FLOOR_OFFSET) for trial, truth in trials]}
        for name, model in models.items():
            responses[name] = [run(model(index), trial) for trial, _ in trials]

        errors[excitation] = {}
        for name, of_trials in responses.items():
            joint_pos = np.array([response.joint_pos for response in of_trials])
            by_trial = capped(rmse(joint_pos, true_pos, axis=1))
            errors[excitation][name] = by_trial.mean(axis=0)
    return errors


def bench_coverage(
    prior: MotorPrior,
    posterior: LatentPosterior,
    motors: TrueMotors,
    seed: int,
    schedule: BenchSchedule = HELD_OUT,
) -> Results:
    """Share of the physical motors' held-out trajectories inside the bands of the posterior.

    ``coverage50`` and ``coverage90`` are over all motors and times, of all excitations and of each.
    """
    rng = np.random.default_rng([seed, _COVERAGE_STREAM])
    rows = []
    for excitation in schedule.excitations:
        inside = []
        for trial, truth in held_out_trials(excitation, motors, seed, schedule)[:_COVERED]:
            samples = []
            for z in latent_samples(posterior, rng):
                simulated = run(prior.model.motors(z), trial)
                scale = sample_residual_scale(prior.metrics, posterior.misfit, rng)
                residuals = sample_residuals(prior.metrics, rng, simulated.joint_vel)
                samples.append(simulated.joint_pos + scale * residuals)
            inside.append(inside_bands(np.stack(samples), run(truth, trial).joint_pos))

        for level in LEVELS:
            share = sum(float(np.mean(trial_inside[level])) / _COVERED for trial_inside in inside)
            rows.append(Result(f"coverage{level}", "1", share, motors="held_out", part=excitation))

    of_excitations = Results(rows)
    overall = []
    for level in LEVELS:
        quantity = f"coverage{level}"
        mean = of_excitations.mean(quantity=quantity)
        overall.append(Result(quantity, "1", mean, motors="held_out"))
    return Results(overall) + of_excitations
