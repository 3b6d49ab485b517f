"""Logs of motors that a decoder made: their constants are known, and a fit can reach them."""

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
    """Logs of a grey box's motors at latents z (M, Z), without noise; segments take the conditions in turn."""

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
        parts = []
        count = len(z)
        for segment in range(segments):
            kind = BENCH.excitations[segment % len(BENCH.excitations)]
            case = bench_trial(
                np.random.default_rng([seed, segment]), kind, rows, count, BENCH, hold=False
            )
            case = replace(case, load_inertia=load * case.load_inertia)
            seconds = np.broadcast_to(
                (segment * rows + np.arange(rows))[:, None] * BENCH.period, (rows, count)
            )
            warmth = box.warmth(z, float(seconds[:, 0].mean()))
            rise = temperature_rise[segment % len(temperature_rise)]
            under = OperatingConditions(warmth, supply[segment % len(supply)], rise)
            found: Any = run(GreyBoxActuator(box, z, under, gains), case)
            inertia = np.broadcast_to(case.load_inertia, (rows, count))
            logged = np.ones((2, rows, count)) * (1.0 if gains is None else gains[:, None])
            channels = (
                case.position_target,
                found.joint_pos,
                found.joint_vel,
                found.joint_torque,
                case.external_torque,
                inertia,
                seconds,
                *logged,
                np.full_like(seconds, under.supply),
                np.full_like(seconds, under.temperature_rise),
                np.zeros_like(seconds),
                found.joint_pos,
            )
            parts.append(np.stack(channels, axis=-1).transpose(1, 0, 2))
        return TrainingData(
            series=np.concatenate(parts, axis=1).astype(np.float32),
            starts=np.arange(segments * rows),
            segments=tuple(slice(index * rows, (index + 1) * rows) for index in range(segments)),
            scales=SCALES,
            has_torque=True,
        )

    return make
