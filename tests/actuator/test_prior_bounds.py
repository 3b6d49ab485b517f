"""A grey box within its bounds can be simulated, and each bound is one."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import PARAMETERS, parameters_of
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.prior_bounds import CENTRAL_MOTOR, check_central_motor
from motorprior.actuator.servo_terms import FAINT, SIGNED, TERMS
from motorprior.bench.dynamometer import Trial, run
from motorprior.exceptions import ArtifactError

PATH = Path("mine.safetensors")
SERVO = {
    "kp": 10.0, "kd_over_kp": 0.09, "velocity_filter": 0.003, "delay": 0.008, "torque_limit": 1.5, "armature": 0.5,
    "coulomb": 0.06, "stribeck_torque": 0.01, "viscous_damping": 0.004, "load_friction": 0.2, "gear_stiffness": 70.0,
    "backlash": 0.015, "gear_damping": 0.0001, "encoder_zero": 0.01, **FAINT,
}  # fmt: skip
"""Its rotor can have any armature within bounds, and its gear any damping."""
DT, SECONDS = 0.002, 4.0
LOADS = np.array([1e-4, 2e-3, 3e-2])
"""[kg·m²]"""
FARTHEST = 0.5 * SECONDS**2 * (CENTRAL_MOTOR["torque_limit"][1] + CENTRAL_MOTOR["integral_limit"][1])
"""Times the inertia: how far the largest torque moves a load that is at rest."""
EVERY = tuple(TERMS)
NAMES = parameters_of(EVERY)


def center_of(values: dict[str, float], names: tuple[str, ...] = NAMES) -> np.ndarray:
    """(P,) of `GearedMotor`."""
    return np.array([values[name] / SIGNED[name] if name in SIGNED else np.log(values[name]) for name in names])


def test_every_constant_has_bounds():
    assert tuple(CENTRAL_MOTOR) == tuple(SERVO) == NAMES
    check_central_motor(center_of(SERVO), NAMES, PATH)
    check_central_motor(center_of(SERVO, PARAMETERS), PARAMETERS, PATH)


@pytest.mark.parametrize("name", NAMES)
def test_a_constant_beyond_its_bounds_is_refused_by_name_and_value(name: str):
    least, most = CENTRAL_MOTOR[name]
    inward, outward = (0.999, 1.001) if least < 0 else (1.001, 0.999)
    for value in (inward * least, 0.999 * most):
        check_central_motor(center_of(SERVO | {name: value}), NAMES, PATH)
    for value in (outward * least, 1.001 * most):
        words = f"mine.safetensors: motor_center: {name} = {value:.6g} is not a finite number from"
        with pytest.raises(ArtifactError, match=re.escape(words)) as error:
            check_central_motor(center_of(SERVO | {name: value}), NAMES, PATH)
        assert error.value.remedy


@pytest.mark.parametrize("unit", [1.0, 16.0, 40_000.0])
def test_the_bounds_of_a_multiple_of_stated_gains_are_those_of_the_gain(unit: float):
    gains = np.array([[unit, unit], [unit, unit]])
    check_central_motor(center_of(SERVO | {"kp": 10.0 / unit}), NAMES, PATH, gains)
    with pytest.raises(ArtifactError, match="motor_center: kp = 1e-05"):
        check_central_motor(center_of(SERVO | {"kp": 1e-5 / unit}), NAMES, PATH, gains)
    check_central_motor(center_of(SERVO | {"kp": 10.0 / unit}), NAMES, PATH, gains * [[1.0], [0.0]])


def corner(rng: np.random.Generator, names: tuple[str, ...]) -> np.ndarray:
    """(P,) every constant at one of its bounds or anywhere between them."""
    low, high = (center_of({name: bounds[side] for name, bounds in CENTRAL_MOTOR.items()}, names) for side in (0, 1))
    low, high = low + 1e-9, high - 1e-9  # exp(log(x)) is x but for its last bit
    where = np.choose(rng.integers(3, size=len(low)), [np.zeros(len(low)), np.ones(len(low)), rng.random(len(low))])
    return low + where * (high - low)


@pytest.mark.parametrize("terms", [(), EVERY], ids=["none", "all"])
def test_a_central_motor_within_bounds_can_be_simulated(
    grey_network: Callable[..., LatentNetwork], terms: tuple[str, ...]
):
    network, names, rng = grey_network(), parameters_of(terms), np.random.default_rng(0)
    target = np.tile(0.3 * np.sign(np.sin(6 * np.arange(0, SECONDS, DT)))[:, None], (1, 3))
    trial = Trial(target, np.zeros_like(target), LOADS, DT)
    for _ in range(150):
        center = corner(rng, names)
        check_central_motor(center, names, PATH)
        motor = GearedMotor(center, np.zeros((3, len(names))), terms)
        found = run(LatentActuator(replace(network, motor=motor), np.zeros((3, 3))), trial)
        farthest = np.abs(found.joint_pos).max(axis=0)
        assert np.all(farthest <= FARTHEST / LOADS), dict(zip(names, center.tolist(), strict=True))
