"""Samples of shipped fleets and priors behave like motors; bands of a class hold its motors."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.actuator import Actuator, ConstantFactors, with_factors
from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior, shipped_cards
from motorprior.bench.class_behaviour import class_behaviours
from motorprior.bench.dynamometer import Trial, run
from motorprior.robots.shipped import SHIPPED

# inertia of the loads over the armature [-]
LOADS = (0.3, 3.0)
# height of a step of the target [rad]
STEP = 0.2
# A response oscillates if its last quarter varies by more than this share of the step.
# Servos hunt by 0.3.
MAX_SHARE_OF_STEP = 0.35
# initial speed of a motor that is switched off [rad/s]
COAST_VEL = 2.0


def trial(target: np.ndarray, load: np.ndarray, period: float, speed: float = 0.0) -> Trial:
    targets = np.tile(target[:, None], (1, len(load)))
    return Trial(targets, np.zeros_like(targets), load, period, joint_vel=np.full(len(load), speed))


def implausible(motors: Actuator, armature: np.ndarray, period: float) -> np.ndarray:
    """(M,) whether a motor is implausible with any of LOADS.

    It oscillates or diverges after a step, or gains speed while it is switched off.
    """
    is_implausible = np.zeros(motors.num_motors, dtype=bool)
    time = period * np.arange(round(1.6 / period))
    step = np.where(time < 0.1, 0.0, STEP)
    one = np.ones(motors.num_motors)
    off = with_factors(motors, ConstantFactors(one, one, 1e-9 * one, one))

    for factor in LOADS:
        load = factor * armature

        # the encoder, because a free joint bounces in its backlash
        response = run(motors, trial(step, load, period)).encoder_pos
        last_quarter = response[-len(response) // 4 :]
        is_implausible |= ~(np.ptp(last_quarter, axis=0) < MAX_SHARE_OF_STEP * STEP)

        coasting = run(off, trial(0.0 * step, load, period, COAST_VEL)).joint_vel
        max_speed = np.abs(coasting).max(axis=0)
        is_implausible |= ~(max_speed <= 1.01 * COAST_VEL)

    return is_implausible


def test_a_motor_without_damping_is_implausible(grey_box: Callable[..., GreyBox]):
    def oscillates(**constants: float) -> bool:
        motors = grey_box(latents=0, **constants).motors(np.zeros((1, 0)))
        armature = motors.constants()["armature"]
        return bool(implausible(motors, armature, motors.model.period)[0])

    assert not oscillates()
    assert oscillates(
        kd_over_kp=1e-4, coulomb=1e-4, stribeck_torque=1e-5, load_friction=1e-4, delay=0.03
    )


@pytest.mark.parametrize("name", [name for name, _ in SHIPPED[0].fleets])
def test_motors_of_the_shipped_fleets_are_plausible(name: str):
    motors = load_fleet(name).sample(100, 0).actuator()
    assert implausible(motors, np.maximum(motors.armature, 1e-3), 0.002).sum() <= 3


@pytest.mark.parametrize("name", shipped_cards())
def test_samples_of_the_shipped_priors_are_plausible(name: str):
    prior = mp.from_pretrained(name)
    for joint_class in prior.classes.names:
        motors = prior.sample((joint_class,) * 1000, 0)
        assert isinstance(motors, GreyBoxActuator)
        armature = motors.constants()["armature"]
        share = implausible(motors, armature, motors.model.period).mean()
        assert share <= 0.03, joint_class


@pytest.fixture
def classed_prior(grey_box: Callable[..., GreyBox]) -> MotorPrior:
    """Prior of six hips and six calves, far apart in the first latent."""
    box = grey_box(spread=0.1)
    rng = np.random.default_rng(0)
    means = np.array([[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    names = ("hip", "calf") * 6
    z = means[[0, 1] * 6] + rng.standard_normal((12, 3))
    classes = ClassLatents(("hip", "calf"), names, means, np.full(3, 6.0))
    return MotorPrior(box, z, np.zeros_like(z), "rollout", "r", "m", {}, given_classes=classes)


def test_bands_of_each_class_hold_its_motors(classed_prior: MotorPrior):
    hip, calf = class_behaviours(classed_prior)

    assert (hip.name, calf.name) == ("hip", "calf")
    assert set(hip.sampled) == {"step", "chirp", "friction"}
    for behaviour in (hip, calf):
        for name, samples in behaviour.sampled.items():
            motors = behaviour.training_motors[name]
            assert samples.shape[1] == len(behaviour.axes[name])
            assert motors.shape[0] == 6

            low, high = np.percentile(samples, [5, 95], axis=0)
            inside = (low <= motors + 1e-9) & (motors <= high + 1e-9)
            assert inside.mean() > 0.7, name


def test_bands_of_another_class_do_not_hold_the_motors(classed_prior: MotorPrior):
    classes = classed_prior.classes
    swapped = replace(classes, mean=classes.mean[::-1].copy())

    hip = class_behaviours(replace(classed_prior, given_classes=swapped))[0]

    motors = hip.training_motors["friction"]
    low, high = np.percentile(hip.sampled["friction"], [5, 95], axis=0)
    inside = (low <= motors) & (motors <= high)
    assert not inside.any()
