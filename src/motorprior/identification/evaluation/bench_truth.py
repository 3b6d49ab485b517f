"""Models compared with the true motors of a simulated fleet, on the bench.

Held-out trials last 1 s, with loads inside the training range; chirp is in no preset of the bench. The motors worked
for an unknown time of at most MAX_WORK before each trial. The floor ``physical`` is the true motors simulated again
from a start FLOOR_OFFSET away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.dynamometer import Response, Trial, run
from motorprior.bench.families import TrueMotors
from motorprior.bench.recording import BenchPreset, trial
from motorprior.identification.evaluation.errors import capped
from motorprior.signals import rmse

# indices of motors -> a model of these motors, or an ensemble of models, whose mean trajectory is the prediction
ModelOfMotors: TypeAlias = Callable[[np.ndarray], Actuator]
PredictorOfMotors: TypeAlias = Callable[[np.ndarray], Actuator | tuple[Actuator, ...]]

HELD_OUT = BenchPreset(0.002, 500, (4e-4, 2e-2), ("sine", "gait", "steps", "impacts", "chirp"), 5)
HELD_OUT_SEED = 7_000_000  # of the held-out random streams, never used for training
MAX_WORK = 20.0  # [s]
FLOOR_OFFSET = 0.004  # [rad]
_REPEATS = 4  # trials per excitation
_TRIALS, _WORK = 17, 53  # tags of random streams


def held_out_trials(
    kind: str, motors: TrueMotors, seed: int, preset: BenchPreset = HELD_OUT
) -> list[tuple[Trial, Actuator]]:
    """Trials of one excitation for all motors, every second one held at 100 Hz, and the motors after their work."""
    tags = [HELD_OUT_SEED, seed, preset.kinds.index(kind)]
    work = np.random.default_rng([*tags, _WORK]).uniform(0.0, MAX_WORK, _REPEATS)
    rngs = [np.random.default_rng([*tags, repeat, _TRIALS]) for repeat in range(_REPEATS)]
    steps, count = preset.segment_steps, len(motors)
    return [
        (trial(rng, kind, steps, count, preset, hold=repeat % 2 == 0), motors.after(work[repeat]).actuator())
        for repeat, rng in enumerate(rngs)
    ]


def bench_errors(
    motors: TrueMotors, models: Mapping[str, PredictorOfMotors], seed: int, preset: BenchPreset = HELD_OUT
) -> dict[str, dict[str, np.ndarray]]:
    """Mean joint RMSE [rad] per excitation, model and motor, `capped`: errors[kind][model] of shape (motors,)."""
    index = np.arange(len(motors))
    errors: dict[str, dict[str, np.ndarray]] = {}
    for kind in preset.kinds:
        cases = held_out_trials(kind, motors, seed, preset)
        answers = [run(truth, case) for case, truth in cases]
        responses = {"physical": [run(truth, case, FLOOR_OFFSET) for case, truth in cases]}
        responses |= {name: [respond(model(index), case) for case, _ in cases] for name, model in models.items()}
        errors[kind] = {
            name: np.mean(
                [
                    capped(rmse(one.joint_pos, other.joint_pos, axis=0))
                    for one, other in zip(found, answers, strict=True)
                ],
                axis=0,
            )
            for name, found in responses.items()
        }
    return errors


def respond(model: Actuator | tuple[Actuator, ...], case: Trial) -> Response:
    """The response that a model, or an ensemble of them, predicts in a trial."""
    answers = [vars(run(each, case)).values() for each in (model if isinstance(model, tuple) else (model,))]
    return Response(*(np.mean(values, axis=0) for values in zip(*answers, strict=True)))
