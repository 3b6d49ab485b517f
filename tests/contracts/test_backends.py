"""What every backend promises; each new one joins the list."""

from dataclasses import astuple

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.physical import PhysicalActuator
from motorprior.backend import Backend
from motorprior.bench.fleet import load_fleet
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.mujoco_backend import MujocoBackend
from motorprior.simulation.world import WorldConfig


def mujoco(_: object) -> Backend:
    """Physical motors of the shipped fleet."""
    fleet = load_fleet("pupper_v2")
    return MujocoBackend(
        lambda rng: PhysicalActuator(fleet.sample(rng, spec.NUM_JOINTS)), WorldConfig(physics_dt=spec.TWIN_PHYSICS_DT)
    )


def mujoco_of_grey_boxes(grey_network) -> Backend:
    """Motors drawn around a small servo."""
    network = grey_network(spread=0.05)
    return MujocoBackend(lambda rng: LatentActuator(network, rng.standard_normal((spec.NUM_JOINTS, 3))))


BACKENDS = [mujoco, mujoco_of_grey_boxes]


@pytest.fixture(params=BACKENDS, ids=lambda make: make.__name__)
def backend(request: pytest.FixtureRequest, grey_network):
    made = request.param(grey_network)
    yield made
    made.close()


def walked(backend: Backend, seed: int, steps: int = 20) -> list[tuple]:
    """States of a small motion of all joints."""
    states = [astuple(backend.reset(seed))]
    for step in range(steps):
        states.append(astuple(backend.step(spec.NOMINAL_POSE + 0.1 * np.sin(0.3 * step))))
    return states


def test_a_state_has_the_stated_shapes_and_types(backend: Backend):
    for state in (backend.reset(0), backend.step(spec.NOMINAL_POSE)):
        shapes = [np.shape(value) for value in astuple(state)]
        assert shapes == [(3,), (4,), (3,), (3,), (12,), (), ()]
        assert state.fault == 0 and all(np.all(np.isfinite(value)) for value in astuple(state))
        assert np.linalg.norm(state.base_quat) == pytest.approx(1.0, abs=1e-9)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_motors(backend: Backend):
    first, again, other = (walked(backend, seed) for seed in (1, 1, 2))
    assert all(
        np.array_equal(a, b) for left, right in zip(first, again, strict=True) for a, b in zip(left, right, strict=True)
    )
    assert not np.array_equal(first[-1][4], other[-1][4])


def test_a_state_is_not_changed_by_later_steps(backend: Backend):
    state = backend.reset(0)
    kept = [np.array(value) for value in astuple(state)]
    backend.step(spec.NOMINAL_POSE + 0.3)
    assert all(np.array_equal(a, b) for a, b in zip(kept, astuple(state), strict=True))


def test_a_robot_told_to_stand_stands(backend: Backend):
    state = backend.reset(0)
    for _ in range(100):
        state = backend.step(spec.NOMINAL_POSE)
    # 1 s; motors give way under the weight: 2.135 kg over 8 leg joints is about 0.4 N·m each, over 8.8 N·m/rad.
    assert np.abs(state.measured_joint_pos - spec.NOMINAL_POSE).max() < 0.15
    assert 0.13 < state.base_pos[2] < 0.18 and np.abs(state.base_lin_vel).max() < 0.05
    assert state.torque_squared_sum > 0.0


def test_a_target_is_followed(backend: Backend):
    state = backend.reset(0)
    target = spec.NOMINAL_POSE + np.tile([0.0, 0.2, -0.4], 4)
    for _ in range(100):
        state = backend.step(target)
    assert np.abs(state.measured_joint_pos - target).max() < 0.15
