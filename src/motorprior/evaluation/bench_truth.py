"""Models compared with the true motors of a simulated fleet, on the bench; coverage of bands of posterior samples.

Held-out trials last 1 s, with loads inside the training range; chirp is in no preset of the bench.
The motors worked for an unknown time of at most MAX_WORK before each trial. The floor ``physical``
is the true motors simulated again from a start FLOOR_OFFSET away. A sample of a band is a motor
with z from the posterior, simulated in closed loop, plus a residual of the prior
(`sample_residuals`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import BenchPreset, bench_trial
from motorprior.evaluation.errors import capped
from motorprior.evaluation.reference import GROWTH, GROWTH_STD, SPEEDS, percentile_names, speed_pool
from motorprior.evaluation.reference import LEVELS as PERCENTILES
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import POSITION_SCALE, VELOCITY_SCALE, WindowRuns
from motorprior.identification.windows import VEL
from motorprior.logs.motor_log import MotorLog
from motorprior.results import Result, Results
from motorprior.signals import rmse

# indices of motors -> a model of these motors
ModelOfMotors: TypeAlias = Callable[[np.ndarray], Actuator]

HELD_OUT = BenchPreset(0.002, 500, (4e-4, 2e-2), ("sine", "gait", "steps", "impacts", "chirp"), 5)
HELD_OUT_SEED = 7_000_000  # seed of held-out random streams, never used for training
MAX_WORK = 20.0  # [s]
FLOOR_OFFSET = 0.004  # [rad]
_REPEATS = 4  # trials per excitation
# tags of random streams
_TRIALS = 17
_WORK = 53
NUM_SAMPLES = 40  # samples of the posterior
LEVELS = (50, 90)  # coverage of the bands [%]
_COVERED = 2  # held-out trials per excitation: one held at 100 Hz, one not
# tags of random streams
_LOG_STREAM = 53
_BENCH_STREAM = 23


def held_out_trials(
    kind: str, motors: TrueMotors, seed: int, preset: BenchPreset = HELD_OUT
) -> list[tuple[Trial, Actuator]]:
    """Trials of one excitation for all motors, every second one held at 100 Hz, and the motors after their work."""
    tags = [HELD_OUT_SEED, seed, preset.kinds.index(kind)]
    work = np.random.default_rng([*tags, _WORK]).uniform(0.0, MAX_WORK, _REPEATS)
    rngs = [np.random.default_rng([*tags, repeat, _TRIALS]) for repeat in range(_REPEATS)]
    steps = preset.segment_steps
    count = len(motors)
    return [
        (
            bench_trial(rng, kind, steps, count, preset, hold=repeat % 2 == 0),
            motors.after(work[repeat]).actuator(),
        )
        for repeat, rng in enumerate(rngs)
    ]


def bench_errors(
    motors: TrueMotors,
    models: Mapping[str, ModelOfMotors],
    seed: int,
    preset: BenchPreset = HELD_OUT,
) -> dict[str, dict[str, np.ndarray]]:
    """Mean joint RMSE [rad] per excitation, model and motor, `capped`: errors[kind][model] of shape (motors,)."""
    index = np.arange(len(motors))
    errors: dict[str, dict[str, np.ndarray]] = {}
    for kind in preset.kinds:
        cases = held_out_trials(kind, motors, seed, preset)
        answers = np.array([run(truth, case).joint_pos for case, truth in cases])
        responses = {"physical": [run(truth, case, FLOOR_OFFSET) for case, truth in cases]}
        responses |= {
            name: [run(model(index), case) for case, _ in cases] for name, model in models.items()
        }
        for name, found in responses.items():
            joint_pos = np.array([each.joint_pos for each in found])
            errors.setdefault(kind, {})[name] = capped(rmse(joint_pos, answers, axis=1)).mean(
                axis=0
            )
    return errors


def zero_shot(prior: MotorPrior, log: MotorLog) -> LatentPosterior:
    """The distribution of the motors of a log, without the log: `MotorPrior.predicted`."""
    mean, std, misfit = prior.predicted(log)
    covariance = std[:, :, None] ** 2 * np.eye(mean.shape[1])
    return LatentPosterior(mean, covariance, np.zeros(len(mean)), 0, misfit)


def band(samples: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge (...,) of the central ``level`` % prediction interval of samples (D, ...).

    Weibull's plotting positions p·(D + 1) make it exact. The usual positions p·(D - 1) + 1 cover 86
    %, not 90 %.
    """
    low, high = np.percentile(samples, [50 - level / 2, 50 + level / 2], axis=0, method="weibull")
    return low, high


def sample_residual_scale(
    metrics: Mapping[str, float], misfit: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(M,) sampled factors on the residuals of motors with this ``misfit`` (M,) or (1,) on other rows."""
    std = metrics.get(GROWTH_STD, 0.0)
    return misfit * metrics.get(GROWTH, 1.0) * np.exp(std * rng.standard_normal(len(misfit)))


def sample_residuals(
    metrics: Mapping[str, float], rng: np.random.Generator, joint_vel: np.ndarray
) -> np.ndarray:
    """Sample residuals [rad] for simulated velocities [rad/s] of any shape, from the percentiles of their pools.

    The quantile function is linear between percentiles, and extrapolated by one interval at both
    ends.
    """
    pool = speed_pool(joint_vel)
    quantile = rng.uniform(0, 100, joint_vel.shape)
    out = np.zeros(joint_vel.shape)
    for index, name in enumerate(SPEEDS):
        values = np.array([metrics[percentile] for percentile in percentile_names(name)])
        low = 2 * values[0] - values[1]
        high = 2 * values[-1] - values[-2]
        chosen = pool == index
        out[chosen] = np.interp(quantile[chosen], [0, *PERCENTILES, 100], [low, *values, high])
    return out


def _inside(samples: np.ndarray, truth: np.ndarray | float) -> dict[int, np.ndarray]:
    """Level -> (...,) whether the truth (...,) is inside the band of the samples (D, ...)."""
    bands = {level: band(samples, level) for level in LEVELS}
    return {level: (low <= truth) & (high >= truth) for level, (low, high) in bands.items()}


def log_coverage(
    prior: MotorPrior, posterior: LatentPosterior, runs: Sequence[WindowRuns]
) -> dict[int, float]:
    """Level [%] -> share of the recorded angles inside the band of free runs."""
    rng = np.random.default_rng(_LOG_STREAM)
    inside = []
    for one in runs:
        recorded = one.recorded(VEL)
        errors = []
        for z in _latent_samples(posterior, rng):
            found = one.errors(prior.model.motors(z))
            velocity = recorded + VELOCITY_SCALE * found[:, :, 1]
            width = sample_residual_scale(prior.metrics, posterior.misfit, rng)[:, None, None]
            errors.append(
                POSITION_SCALE * found[:, :, 0]
                + width * sample_residuals(prior.metrics, rng, velocity)
            )
        inside.append(_inside(np.stack(errors), 0.0))
    return {
        level: float(np.mean(np.concatenate([each[level].ravel() for each in inside])))
        for level in LEVELS
    }


def _latent_samples(posterior: LatentPosterior, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """NUM_SAMPLES samples (M, Z) of the posteriors of M motors."""
    factors = np.linalg.cholesky(posterior.covariance)
    for _ in range(NUM_SAMPLES):
        noise = rng.standard_normal(posterior.mean.shape)
        yield posterior.mean + np.einsum("mij,mj->mi", factors, noise)


def bench_coverage(
    prior: MotorPrior,
    posterior: LatentPosterior,
    motors: TrueMotors,
    seed: int,
    preset: BenchPreset = HELD_OUT,
) -> Results:
    """Share of the physical motors' held-out trajectories inside the bands.

    ``coverage50`` and ``coverage90`` are over all motors and times, of all excitations and of each.
    """
    rng = np.random.default_rng([seed, _BENCH_STREAM])
    rows = []
    for kind in preset.kinds:
        inside = []
        for case, truth in held_out_trials(kind, motors, seed, preset)[:_COVERED]:
            samples = []
            for z in _latent_samples(posterior, rng):
                simulated = run(prior.model.motors(z), case)
                width = sample_residual_scale(prior.metrics, posterior.misfit, rng)
                samples.append(
                    simulated.joint_pos
                    + width * sample_residuals(prior.metrics, rng, simulated.joint_vel)
                )
            inside.append(_inside(np.stack(samples), run(truth, case).joint_pos))
        for level in LEVELS:
            share = sum(float(np.mean(each[level])) / _COVERED for each in inside)
            rows.append(Result(f"coverage{level}", "1", share, motors="held_out", part=kind))
    of_each = Results(rows)
    overall = {
        name: of_each.mean(quantity=name) for name in (f"coverage{level}" for level in LEVELS)
    }
    return (
        Results(Result(name, "1", share, motors="held_out") for name, share in overall.items())
        + of_each
    )
