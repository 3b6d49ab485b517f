"""Samples that are no motors are named, those of the shipped fleets are motors, and bands hold the motors."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.actuator import Actuator, Factors, with_factors
from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior, shipped_cards
from motorprior.bench.class_behaviour import class_behaviours
from motorprior.bench.dynamometer import Trial, run
from motorprior.robots.shipped import SHIPPED

# inertia of loads over the armature [-]; a response whose last quarter varies by more than this
# share of the step oscillates (servos hunt by 0.3); initial speed of a motor that is switched off
# [rad/s]
LOADS = (0.3, 3.0)
SETTLED = 0.35
COAST_VEL = 2.0


def trial(target: np.ndarray, load: np.ndarray, period: float, speed: float = 0.0) -> Trial:
    targets = np.tile(target[:, None], (1, len(load)))
    return Trial(targets, np.zeros_like(targets), load, period, joint_vel=np.full(len(load), speed))


def implausible(motors: Actuator, armature: np.ndarray, period: float) -> np.ndarray:
    """Which motors oscillate or diverge after a step, or gain energy when they are switched off, on any of LOADS."""
    found = np.zeros(motors.num_motors, dtype=bool)
    step = np.where(np.arange(round(1.6 / period)) * period < 0.1, 0.0, 0.2)
    one = np.ones(motors.num_motors)
    off = with_factors(motors, Factors(one, one, 1e-9 * one, one))
    for factor in LOADS:
        # a free joint bounces in backlash
        response = run(motors, trial(step, factor * armature, period)).encoder_pos
        found |= ~(np.ptp(response[-len(response) // 4 :], axis=0) < 0.2 * SETTLED)
        speed = np.abs(
            run(off, trial(0.0 * step, factor * armature, period, COAST_VEL)).joint_vel
        ).max(axis=0)
        found |= ~(speed <= 1.01 * COAST_VEL)
    return found


def test_a_motor_that_oscillates_is_found(grey_box: Callable[..., GreyBox]):
    def found(**constants: float) -> bool:
        motors = grey_box(latents=0, **constants).motors(np.zeros((1, 0)))
        return bool(implausible(motors, motors.constants()["armature"], motors.model.period)[0])

    assert not found()
    assert found(
        kd_over_kp=1e-4, coulomb=1e-4, stribeck_torque=1e-5, load_friction=1e-4, delay=0.03
    )


@pytest.mark.parametrize("name", [name for name, _ in SHIPPED[0].fleets])
def test_motors_of_the_shipped_fleets_are_motors(name: str):
    motors = load_fleet(name).sample(100, 0).actuator()
    assert implausible(motors, np.maximum(motors.armature, 1e-3), 0.002).sum() <= 3


@pytest.mark.parametrize("name", shipped_cards())
def test_samples_of_the_shipped_priors_are_motors(name: str):
    prior = mp.from_pretrained(name)
    for joint_class in prior.classes.names:
        motors = prior.sample((joint_class,) * 1000, 0)
        assert isinstance(motors, GreyBoxActuator)
        assert (
            implausible(motors, motors.constants()["armature"], motors.model.period).mean() <= 0.03
        ), joint_class


def test_bands_of_each_class_hold_its_motors(grey_box: Callable[..., GreyBox]):
    box = grey_box(spread=0.1)
    rng = np.random.default_rng(0)
    means = np.array([[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    names = ("hip", "calf") * 6
    z = means[[0, 1] * 6] + rng.standard_normal((12, 3))
    classes = ClassLatents(("hip", "calf"), names, means, np.full(3, 6.0))
    prior = MotorPrior(box, z, np.zeros_like(z), "rollout", "r", "m", {}, given_classes=classes)
    hip, calf = class_behaviours(prior)
    assert (hip.name, calf.name) == ("hip", "calf") and set(hip.sampled) == {
        "step",
        "chirp",
        "friction",
    }
    for found in (hip, calf):
        for name, values in found.sampled.items():
            assert (
                values.shape[1] == len(found.axes[name])
                and found.training_motors[name].shape[0] == 6
            )
            low, high = np.percentile(values, [5, 95], axis=0)
            inside = (low <= found.training_motors[name] + 1e-9) & (
                found.training_motors[name] <= high + 1e-9
            )
            assert inside.mean() > 0.7, name
    swapped = replace(prior, given_classes=replace(classes, mean=means[::-1].copy()))
    wrong = class_behaviours(swapped)[0]
    low, high = np.percentile(wrong.sampled["friction"], [5, 95], axis=0)
    assert not (
        (low <= wrong.training_motors["friction"]) & (wrong.training_motors["friction"] <= high)
    ).any()
