"""Compiled free runs equal the rollout in JAX, and motors that made a log replay it."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.optional_terms import TERMS
from motorprior.identification.networks.network import import_parameters
from motorprior.identification.networks.objectives import rollout_objective
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.training_data.windows import (
    EXTERNAL,
    POS,
    SECONDS,
    STIFFNESS,
    TrainingData,
)

Networks = Callable[..., LatentNetwork]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["rollout"], taps=(0, 2, 5), own_latents=False, num_latents=3, warm_up=60, window=32)
SERVO = ("dead_zone", "integral", "torque_speed", "current", "asymmetry", "presliding", "output_damping", "heat")
CASES = pytest.mark.parametrize("terms", [(), SERVO, tuple(TERMS)], ids=len)
Z = np.array([[0.5, -1.0, 0.3], [0.0, 0.3, -0.8], [-1.2, 0.8, 0.1]])
MOTORS = np.arange(len(Z))


@CASES
def test_motors_that_made_a_log_replay_it(grey_network: Networks, decoder_data: Data, terms: tuple[str, ...]):
    network = grey_network(terms=terms, network=0.3)
    data = decoder_data(network, Z)
    runs = WindowRuns(data, PRESET)
    found = runs.residuals(network, Z, MOTORS)
    assert found.shape == (3, 6 * ((400 - 1 - 60) // 32), 3, 32) == (3, runs.windows, runs.channels, 32)
    # rows are float32, and what touches, sticks or slips within rounding is one step off: no window but a few
    assert np.mean(np.abs(found)) < 1e-3 and np.quantile(np.abs(found), 0.99) < 0.01
    others = runs.residuals(network, Z[[1, 2, 0]], MOTORS)
    assert np.mean(np.abs(others)) > 0.1


@CASES
def test_they_are_the_runs_of_the_rollout_objective(grey_network: Networks, decoder_data: Data, terms: tuple[str, ...]):
    """Of windows whose warm-up is all of the past: later ones begin as the observer of the whole segment has it."""
    network, count = grey_network(terms=terms, network=0.3), 4
    preset, data = replace(PRESET, terms=terms), decoder_data(network, Z, segments=count, rows=200)
    series = data.series.copy()
    series[..., SECONDS] = 3.0  # a rollout is as warm as its window, free runs are as warm as their segment
    data, z = replace(data, series=series), Z + 0.2
    runs = WindowRuns(data, preset)
    found = runs.residuals(network, z, MOTORS)[:, :: runs.windows // count, :, :-1]  # a rollout ends a row before
    scales = {name: getattr(network, name) for name in data.scales}
    objective = rollout_objective(preset, scales, data.measured, bounded=False)
    length = preset.history + preset.window
    windows = np.stack([series[:, part.start : part.start + length] for part in data.parts], axis=1).reshape(
        3 * count, length, -1
    )
    latents = jnp.asarray(np.repeat(z, count, axis=0), jnp.float32)
    theirs = np.asarray(objective.residuals(import_parameters(network), jnp.asarray(windows), latents))
    theirs = theirs.reshape(3, 31, 3, count).transpose(2, 3, 0, 1)
    apart = np.mean(np.abs(found - theirs), axis=(2, 3)) / np.mean(np.abs(theirs), axis=(2, 3))
    assert np.median(apart) < 1e-3 and np.quantile(apart, 0.8) < 0.05, apart


def test_windows_are_those_of_a_fit_and_do_not_cross_segments(grey_network: Networks, decoder_data: Data):
    network = grey_network()
    data = decoder_data(network, Z, segments=3, rows=200)
    # the middle segment is of another machine: neighbours must not see it
    broken = replace(data, series=data.series.copy())
    broken.series[:, 200:400] += 1.0
    before, after = (WindowRuns(one, PRESET).residuals(network, Z, MOTORS) for one in (data, broken))
    same = WindowRuns(data, PRESET).groups() != 1
    np.testing.assert_array_equal(before[:, same], after[:, same])
    short = replace(data, parts=(slice(0, 200), slice(200, 250), slice(250, 600)))
    runs = WindowRuns(short, PRESET)
    np.testing.assert_array_equal(runs.groups(), [0] * 4 + [1] * 9)  # a segment without a window counts for nothing


def test_lanes_do_not_affect_each_other(grey_network: Networks, decoder_data: Data):
    """Bytes of a motor's runs do not depend on how many are simulated together, or on how many threads."""
    network = grey_network(terms=("profile", "presliding"), network=0.3)
    runs, rng = WindowRuns(decoder_data(network, Z, segments=2, rows=200), PRESET), np.random.default_rng(0)
    z, motor = rng.standard_normal((600, 3)), rng.integers(0, 3, 600)
    many = runs.residuals(network, z, motor)
    for lane in (0, 255, 256, 599):
        np.testing.assert_array_equal(many[lane], runs.residuals(network, z[[lane]], motor[[lane]])[0])
    for threads in (1, 3):
        runs._threads = ThreadPoolExecutor(threads)
        np.testing.assert_array_equal(runs.residuals(network, z, motor), many)


def test_a_joint_off_the_recording_has_the_load_of_its_own_angle(grey_network: Networks, decoder_data: Data):
    """A spring on the joint, once as a torque over time, once as a stiffness about the recorded angle."""
    network, z = grey_network(), np.zeros((1, 3))
    data = decoder_data(network, z)
    sprung = data.series.copy()
    sprung[..., STIFFNESS] = -2.0
    sprung[..., EXTERNAL] += 2.0 * sprung[..., POS]
    same, other = (
        WindowRuns(replace(data, series=series), PRESET).residuals(network, where, np.array([0]))[:, :, 0]
        for series, where in ((sprung, z), (sprung, z + 1.0))
    )
    plain = WindowRuns(data, PRESET).residuals(network, z + 1.0, np.array([0]))[:, :, 0]
    assert np.abs(same).max() < 0.03
    assert np.sqrt(np.mean(other**2)) < 0.9 * np.sqrt(np.mean(plain**2))
