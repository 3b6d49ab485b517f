"""Logs of motors that a decoder simulated: their constants are known, and a fit can reach them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.optional_terms import OperatingConditions
from motorprior.bench.dynamometer import run
from motorprior.bench.recording import BENCH_SCHEDULES, bench_trial
from motorprior.identification.windows import TrainingData

BENCH = BENCH_SCHEDULES["rollout"]
SCALES = {"error_scale": 0.1, "velocity_scale": 2.0, "torque_scale": 0.3, "torque_limit": 3.0}


@pytest.fixture(scope="session")
def decoder_data() -> Callable[..., TrainingData]:
    """Function that makes logs of a grey box's motors at latents z (M, Z), without noise.

    Segments have the supply voltages and temperatures in turn.
    """

    def make(
        box: GreyBox,
        z: np.ndarray,
        segments: int = 6,
        rows: int = 400,
        seed: int = 9,
        gains: np.ndarray | None = None,
        load: float = 1.0,
        supply: Sequence[float] = (1.0,),
        temperature_rise: Sequence[float] = (0.0,),
    ) -> TrainingData:
        segment_series = []
        count = len(z)
        for segment in range(segments):
            excitation_name = BENCH.excitations[segment % len(BENCH.excitations)]
            rng = np.random.default_rng([seed, segment])
            trial = bench_trial(rng, excitation_name, rows, count, BENCH, hold=False)
            trial = replace(trial, load_inertia=load * trial.load_inertia)

            time = BENCH.period * (segment * rows + np.arange(rows))
            seconds = np.broadcast_to(time[:, None], (rows, count))
            conditions = OperatingConditions(
                box.warmth(z, float(seconds[:, 0].mean())),
                supply[segment % len(supply)],
                temperature_rise[segment % len(temperature_rise)],
            )
            response: Any = run(GreyBoxActuator(box, z, conditions, gains), trial)

            inertia = np.broadcast_to(trial.load_inertia, (rows, count))
            logged_gains = np.ones((2, rows, count))
            if gains is not None:
                logged_gains = logged_gains * gains[:, None]
            channels = (
                trial.position_target,
                response.joint_pos,
                response.joint_vel,
                response.joint_torque,
                trial.external_torque,
                inertia,
                seconds,
                *logged_gains,
                np.full_like(seconds, conditions.supply),
                np.full_like(seconds, conditions.temperature_rise),
                np.zeros_like(seconds),
                response.joint_pos,
            )
            segment_series.append(np.stack(channels, axis=-1).transpose(1, 0, 2))

        return TrainingData(
            series=np.concatenate(segment_series, axis=1).astype(np.float32),
            starts=np.arange(segments * rows),
            segments=tuple(slice(index * rows, (index + 1) * rows) for index in range(segments)),
            scales=SCALES,
            has_torque=True,
        )

    return make
