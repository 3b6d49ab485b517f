"""Predictive bands of new motors' trajectories, and whether they hold what they promise."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.adapt import Posterior
from motorprior.identification.reference import draw_residuals
from motorprior.identification.validate import HELD_OUT, held_out_trials

DRAWS = 40
COVERAGE_STREAM = 23


def predictive_draws(
    network: LatentNetwork, metrics: dict[str, float], posterior: Posterior, case: Trial, rng: np.random.Generator
) -> np.ndarray:
    """(DRAWS, steps, M) joint angles [rad]: z from the posterior, simulated in closed loop, plus a residual."""
    factors = np.linalg.cholesky(posterior.covariance)
    draws = []
    for _ in range(DRAWS):
        noise = rng.standard_normal(posterior.mean.shape)
        z = posterior.mean + np.einsum("mij,mj->mi", factors, noise)
        simulated = run(LatentActuator(network, z), case)
        draws.append(simulated.joint_pos + draw_residuals(metrics, rng, simulated.joint_vel))
    return np.stack(draws)


def coverage(
    network: LatentNetwork, metrics: dict[str, float], posterior: Posterior, motors: MotorParameters, seed: int
) -> dict[str, float]:
    """Share of the physical motors' held-out trajectories inside the central 50 and 90 % bands.

    Returns:
        ``coverage50`` and ``coverage90`` over all motors, times and excitations, and per excitation.
    """
    rng, truth = np.random.default_rng([seed, COVERAGE_STREAM]), PhysicalActuator(motors)
    inside: dict[str, list[float]] = {}
    for kind in HELD_OUT.kinds:
        case = held_out_trials(kind, len(motors), seed)[0]
        answer = run(truth, case).joint_pos
        draws = predictive_draws(network, metrics, posterior, case, rng)
        for level in (50, 90):
            low, high = np.percentile(draws, [50 - level / 2, 50 + level / 2], axis=0)
            share = float(np.mean((answer >= low) & (answer <= high)))
            inside.setdefault(f"coverage{level}", []).append(share)
            inside[f"coverage{level}/{kind}"] = [share]
    return {name: float(np.mean(values)) for name, values in inside.items()}
