"""Prediction intervals of new motors' trajectories, and their measured coverage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import BenchPreset
from motorprior.identification.evaluation.bench_fidelity import HELD_OUT, held_out_trials, seconds_of_work
from motorprior.identification.evaluation.reference import sample_residuals
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.results import Result, Results

DRAWS = 40  # samples of the posterior
REPEATS = 2  # held-out trials per excitation: one held at 100 Hz, one not
LEVELS = (50, 90)  # of the prediction intervals [%]
COVERAGE_STREAM = 23


def latent_samples(posterior: Posterior, rng: np.random.Generator, count: int) -> Iterator[np.ndarray]:
    """``count`` samples (M, Z) of the posteriors of M motors."""
    factors = np.linalg.cholesky(posterior.covariance)
    for _ in range(count):
        noise = rng.standard_normal(posterior.mean.shape)
        yield posterior.mean + np.einsum("mij,mj->mi", factors, noise)


def predictive_samples(
    network: LatentNetwork, metrics: dict[str, float], posterior: Posterior, case: Trial, rng: np.random.Generator
) -> np.ndarray:
    """(DRAWS, steps, M) joint angles [rad]: z from the posterior, simulated in closed loop, plus a residual."""
    samples = []
    for z in latent_samples(posterior, rng, DRAWS):
        simulated = run(LatentActuator(network, z), case)
        samples.append(simulated.joint_pos + sample_residuals(metrics, rng, simulated.joint_vel))
    return np.stack(samples)


def band(samples: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge (...,) of the central ``level`` % prediction interval of samples (D, ...).

    Weibull's plotting positions p·(D + 1) make it exact. The usual positions p·(D - 1) + 1 cover 86 %, not 90 %.
    """
    low, high = np.percentile(samples, [50 - level / 2, 50 + level / 2], axis=0, method="weibull")
    return low, high


def coverage(
    network: LatentNetwork,
    metrics: dict[str, float],
    posterior: Posterior,
    motors: TrueMotors,
    seed: int,
    preset: BenchPreset = HELD_OUT,
) -> Results:
    """Share of the physical motors' held-out trajectories inside the central 50 % and 90 % prediction intervals.

    ``coverage50`` and ``coverage90`` are over all motors and times, of all excitations and of each.
    """
    rng = np.random.default_rng([seed, COVERAGE_STREAM])
    shares = {kind: np.zeros(len(LEVELS)) for kind in preset.kinds}
    for kind in preset.kinds:
        cases, work = held_out_trials(kind, len(motors), seed, preset), seconds_of_work(kind, seed, preset)
        for case, seconds in zip(cases[:REPEATS], work[:REPEATS], strict=True):
            answer = run(motors.after(seconds).actuator(), case).joint_pos
            samples = predictive_samples(network, metrics, posterior, case, rng)
            bands = [band(samples, level) for level in LEVELS]
            shares[kind] += [np.mean((answer >= low) & (answer <= high)) / REPEATS for low, high in bands]
    everything = {None: np.mean(list(shares.values()), axis=0), **shares}
    return Results.of(
        Result(f"coverage{level}", "1", float(values[index]), motors="held_out", part=kind)
        for kind, values in everything.items()
        for index, level in enumerate(LEVELS)
    )
