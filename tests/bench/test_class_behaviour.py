"""Samples that are no motors are named, those of the shipped fleets are motors, and bands hold the motors."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.joint_classes import JointClasses
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.class_behaviour import DRAWS, class_behaviours, faults
from motorprior.bench.fleet import load_fleet
from motorprior.robots.shipped import SHIPPED


def test_a_motor_settles_and_one_that_oscillates_is_named(grey_box: Callable[..., GreyBox]):
    def fault(**constants: float) -> str:
        return faults(grey_box(latents=0, **constants).motors(np.zeros((1, 0))))[0]

    assert fault() == ""
    assert "oscillates" in fault(kd_over_kp=1e-4, coulomb=1e-4, stribeck_torque=1e-5, load_friction=1e-4, delay=0.03)


@pytest.mark.parametrize("name", [name for name, _ in SHIPPED[0].fleets])
def test_motors_of_the_shipped_fleets_are_motors(name: str):
    assert faults(load_fleet(name).sample(100, 0).actuator()).count("") >= 97  # some servos hunt by more than SETTLED


def test_bands_of_each_class_hold_its_motors(grey_box: Callable[..., GreyBox]):
    box, rng = grey_box(spread=0.1), np.random.default_rng(0)
    means = np.array([[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    names = ("hip", "calf") * 6
    z = means[[0, 1] * 6] + rng.standard_normal((12, 3))
    classes = JointClasses(("hip", "calf"), names, means, np.full(3, 6.0))
    prior = MotorPrior(box, z, np.zeros_like(z), "rollout", "r", "m", {}, {}, stated_classes=classes)
    hip, calf = class_behaviours(prior)
    assert (hip.name, calf.name) == ("hip", "calf") and set(hip.sampled) == {"step", "chirp", "friction"}
    for found in (hip, calf):
        for name, values in found.sampled.items():
            assert values.shape == (DRAWS, len(found.axes[name])) and found.recorded[name].shape[0] == 6
            low, high = np.percentile(values, [5, 95], axis=0)
            inside = (low <= found.recorded[name] + 1e-9) & (found.recorded[name] <= high + 1e-9)
            assert inside.mean() > 0.7, name
    swapped = replace(prior, stated_classes=replace(classes, mean=means[::-1].copy()))
    wrong = class_behaviours(swapped)[0]
    low, high = np.percentile(wrong.sampled["friction"], [5, 95], axis=0)
    assert not ((low <= wrong.recorded["friction"]) & (wrong.recorded["friction"] <= high)).any()
