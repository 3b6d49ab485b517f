"""A new actuator is one file, such as this one: it walks and runs on the bench unchanged."""

from dataclasses import dataclass

import numpy as np
from numba import njit, typeof
from policies import random_policy

from motorprior.actuator.actuator import (
    ConstantFactors,
    empty_arrays,
    require_step,
    require_unchanged,
)
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.kernels import ActuatorKind
from motorprior.bench.dynamometer import Trial, run
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator

KP = 9.0
KD = 0.8
ENCODER_ZERO = 0.01  # [rad]


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    arrays.memory[0, :] = 0.0


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    for motor in range(torque.shape[0]):
        torque[motor] = arrays.parameters[0, motor] * (position_target[motor] - joint_pos[motor])
        arrays.memory[0, motor] += physics_dt


@njit(cache=True, nogil=True)
def _read_encoders(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    for motor in range(out.shape[0]):
        out[motor] = joint_pos[motor] + ENCODER_ZERO


SPRING = ActuatorKind(
    "spring",
    "spring",
    reset=_reset,
    step=_step,
    read_encoders=_read_encoders,
    bench_step=0.0005,
    max_step=0.004,
)


@dataclass(frozen=True)
class Spring:
    """A torque proportional to the error, without a limit; the engine damps the joint."""

    num_motors: int

    @property
    def kind(self) -> ActuatorKind:
        return SPRING

    @property
    def armature(self) -> np.ndarray:
        return np.full(self.num_motors, 0.002)

    @property
    def damping(self) -> np.ndarray:
        return np.full(self.num_motors, KD)

    def with_factors(self, factors: ConstantFactors) -> "Spring":
        require_unchanged(SPRING, factors, *ConstantFactors._fields)
        return self

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        require_step(physics_dt, SPRING.max_step)
        return empty_arrays(SPRING, np.full((1, self.num_motors), KP), 1, 1, self.damping)


def same_pd(n: int) -> IdealPd:
    return IdealPd.uniform(n, KP, KD, torque_limit=1e9, armature=0.002)


def test_arrays_of_a_new_actuator_have_the_type_of_the_compiled_code():
    assert typeof(Spring(12).arrays(0.002)) == typeof(same_pd(12).arrays(0.002))


def test_a_new_actuator_walks_in_the_compiled_rollout():
    policy = random_policy(0.05, seed=1)
    walk = WalkConfig(50)
    pd_walker = WalkSimulator(Scene(PUPPER_V2, lambda rng: same_pd(12), walk))
    spring_walker = WalkSimulator(Scene(PUPPER_V2, lambda rng: Spring(12), walk))

    pd_episode = pd_walker.run(policy, seed=3, trace=True)
    episode = spring_walker.run(policy, seed=3, trace=True)

    assert episode.steps == pd_episode.steps == 50
    assert episode.fault == 0
    # the encoders differ; the first command is the same
    np.testing.assert_allclose(episode.trace[:2], pd_episode.trace[:2], atol=0.02)
    assert np.any(episode.trace[-1] != pd_episode.trace[-1])


def test_a_new_actuator_runs_on_the_dynamometer_at_its_time_step_with_its_encoder():
    rng = np.random.default_rng(0)
    targets = np.repeat(rng.uniform(-0.3, 0.3, (5, 4)), 20, axis=0)
    trial = Trial(targets, np.zeros_like(targets), np.full(4, 0.003), 0.002)
    # the same trial at the step of the spring, a quarter of 2 ms
    fine_targets = targets.repeat(4, axis=0)
    fine_trial = Trial(fine_targets, np.zeros((400, 4)), trial.load_inertia, 0.0005)

    pd_answer = run(same_pd(4), fine_trial)
    answer = run(Spring(4), trial)

    np.testing.assert_allclose(answer.joint_pos, pd_answer.joint_pos[::4], atol=1e-9)
    np.testing.assert_allclose(answer.encoder_pos, answer.joint_pos + ENCODER_ZERO)
