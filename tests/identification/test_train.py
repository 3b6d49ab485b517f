"""Training recovers what generated the data, and the same seed gives the same bytes."""

from collections.abc import Callable
from dataclasses import asdict, replace

import jax
import numpy as np
import pytest
from motor_logs import log_of

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.dynamometer import Trial, run
from motorprior.excitation.hand_made import gait, impacts
from motorprior.identification.identify import identify
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData, training_data

PERIOD = 0.002
FINE = 8
SMALL = replace(
    PRESETS["latent_network"], taps=(0, 1, 2), num_neurons=8, num_latents=2, warm_up=20, batch=16, window=10, steps=40
)  # fmt: skip


def bench_log(armature, segments=10, rows=400, seed=0):
    """PD motors without friction, one per entry of ``armature``, gaits and blows on loads of 1-30 g·m²."""
    # steps of 0.25 ms: implicit damping acts like kd·step of extra armature, 0.1·0.25e-3 = 2.5e-5
    # kg·m² here
    count = len(armature)
    parts = []
    limit = np.full(count, 3.0)
    motors = IdealPd(
        np.full(count, 2.0), np.full(count, 0.1), limit, np.asarray(armature), np.zeros(count)
    )
    for segment in range(segments):
        rng = np.random.default_rng([seed, segment])
        target = np.stack([gait(rng, rows, PERIOD) for _ in range(count)], axis=1)
        external = np.stack([impacts(rng, rows, PERIOD) for _ in range(count)], axis=1)
        load = np.exp(rng.uniform(np.log(1e-3), np.log(3e-2), count))
        fine = Trial(
            target.repeat(FINE, axis=0), external.repeat(FINE, axis=0), load, PERIOD / FINE
        )
        response = run(motors, fine)
        mean_torque = response.joint_torque.reshape(rows, FINE, count).mean(axis=1)
        moved = (response.joint_pos[::FINE], response.joint_vel[::FINE], mean_torque)
        parts.append((target, *moved, external, np.broadcast_to(load, target.shape)))
    target, pos, vel, torque, external, load = map(np.concatenate, zip(*parts, strict=True))
    return log_of(
        np.arange(segments * rows) * PERIOD,
        target,
        pos,
        joint_vel=vel,
        joint_torque=torque,
        external_torque=external,
        load_inertia=load,
        segment=np.repeat(np.arange(segments), rows),
        joint_names=tuple(f"motor_{index}" for index in range(count)),
    )


def test_a_rollout_recovers_the_armature():
    armature = 0.006
    # One tap only: from two velocities a network reads the acceleration, and can trade armature for
    # torque. What remains is the explicit step of 2 ms, about kd·dt = 2e-4 kg·m² at most: 5 % and 3
    # %, ±0.1 % by seed.
    log = replace(bench_log(np.full(8, armature)), joint_torque=None)
    small = {
        "taps": (0,),
        "num_neurons": 16,
        "steps": 400,
        "batch": 64,
        "window": 20,
        "learning_rate": 5e-2,
    }
    preset = replace(PRESETS["one_network"], **small)
    found = identify(training_data(log, preset, "log"), preset, seed=0)
    assert found.model.armature(np.zeros((1, 0)))[0] == pytest.approx(armature, rel=0.1)


def test_same_seed_same_bytes():
    data = training_data(bench_log([0.002, 0.004], segments=2, rows=100), SMALL, "log")
    assert (
        len({leaves(identify(data, replace(SMALL, objective="torque"), 3)) for _ in range(2)}) == 1
    )


# Grey boxes.

MOTORS = replace(PRESETS["rollout"], warm_up=40, window=32)


def leaves(result) -> bytes:
    every = [*jax.tree.leaves(asdict(result.model)), result.mean, result.log_var, result.losses]
    return b"".join(np.asarray(leaf).tobytes() for leaf in every)


def test_motors_are_fitted_without_a_term_that_they_do_not_have(
    grey_box, decoder_data: Callable[..., TrainingData]
):
    data = decoder_data(
        grey_box(latents=2), np.array([[0.5, -1.0], [-0.5, 0.3]]), segments=4, rows=250
    )
    found = identify(data, MOTORS, 0, selectable_terms=("output_encoder",))
    assert found.recipe.terms == () and isinstance(found.model, GreyBox) and found.model.terms == ()
    assert found.recipe.num_latents == found.model.num_latents == found.mean.shape[1] == 14
    assert "output_encoder" in found.metrics.saved_loss
    assert np.all(np.isfinite(found.log_var))
    assert found.losses[-1] < 0.05
