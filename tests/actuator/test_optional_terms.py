"""Each optional term equals its formula, has no effect where absent, and is compiled as written."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy_arithmetic import NUMPY

from motorprior.actuator.geared_motor_step import MotorState, StepConstants, step, step_constants
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.optional_terms import (
    TERMS,
    OperatingConditions,
    at_angle,
    at_operating_conditions,
)

Networks = Callable[..., GreyBox]
H = 0.002
EVERY = tuple(TERMS)
CASES = pytest.mark.parametrize("terms", [("dead_zone",), ("profile", "heat"), EVERY], ids=len)
MOTORS = 11  # eight lanes and three alone
STRONG = {
    "asymmetry": 0.3,
    "dead_zone": 0.02,
    "friction_slope": 0.5,
    "heat_loss": 0.3,
    "output_damping": 0.02,
    "temperature_loss": 0.3,
}


def drawn_states(
    motors: GreyBoxActuator, terms: tuple[str, ...], rng: np.random.Generator
) -> dict[str, Any]:
    """Random states of motors: rotor, joint, delayed target, and the states of these terms."""
    n = motors.num_motors
    constants = motors.model.constants(motors.z)
    q = rng.uniform(-0.3, 0.3, n)
    moving = np.arange(n) % 3 > 0
    names = "dq", "rotor_vel", "filtered_vel", "joint_vel", "vel_change", "expected_change"
    velocities = {name: 4.0 * rng.standard_normal(n) * moving for name in names}
    drawn = velocities | {
        "q": q,
        "target": rng.uniform(-0.4, 0.4, n),
        "rotor_pos": q + 0.02 * rng.standard_normal(n),
        "damping": 0.1 * rng.random(n),
    }
    if terms:
        yielding = constants["coulomb"] / constants.get("bristle_stiffness", 1e9)
        reference = drawn["target"]
        if "profile" in terms:
            reference = reference + 0.1 * rng.standard_normal(n)
        drawn |= {
            "reference": reference,
            "reference_vel": rng.standard_normal(n) * ("profile" in terms),
            "integral": 0.1 * rng.standard_normal(n) * ("integral" in terms),
            "current": 0.5 * rng.standard_normal(n) * ("current" in terms),
            "bristle": yielding * rng.uniform(-1.0, 1.0, n) * ("presliding" in terms),
        }

    return drawn


def stepped(constants: StepConstants, drawn: dict[str, Any], terms: tuple[str, ...]):
    """State, torque and damping after a step of the formula in numpy."""
    state = MotorState(**{name: drawn[name] for name in MotorState._fields if name in drawn})
    return step(constants, state, drawn["target"], drawn["q"], drawn["dq"], H, NUMPY, terms)


@CASES
def test_the_compiled_step_is_the_formula(grey_box: Networks, terms: tuple[str, ...]):
    rng = np.random.default_rng(5)
    box = grey_box(spread=0.3, terms=terms, **STRONG)
    motors = GreyBoxActuator(
        box, rng.standard_normal((MOTORS, 3)), OperatingConditions(rng.random(MOTORS), 0.8, 20.0)
    )
    drawn = drawn_states(motors, terms, rng)
    values = motors.constants()
    alone = stepped(step_constants(values, H, terms), drawn, terms)
    with_all_terms = stepped(step_constants(values, H, terms), drawn, EVERY)

    arrays = motors.arrays(H)
    torque = np.zeros(MOTORS)
    reset_actuator(arrays, drawn["target"].copy(), drawn["q"].copy())

    for row, name in enumerate(MotorState._fields):
        arrays.memory[row] = drawn[name]

    step_actuator(arrays, H, drawn["target"].copy(), drawn["q"].copy(), drawn["dq"].copy(), torque)
    compiled = (*arrays.memory[: len(MotorState._fields)], torque, arrays.damping)
    names = (*MotorState._fields, "torque", "damping")
    formula = (*with_all_terms[0], *with_all_terms[1:])
    formula_alone = (*alone[0], *alone[1:])

    for name, kernel, full, only in zip(names, compiled, formula, formula_alone, strict=True):
        scale = max(np.abs(full).max(), 1e-3)
        np.testing.assert_allclose(kernel, full, atol=1e-12 * scale, err_msg=name)

        # states of absent terms are not defined
        is_state_of_a_term = name in (
            "current",
            "bristle",
            "reference",
            "reference_vel",
            "integral",
        )
        if terms == EVERY or not is_state_of_a_term:
            np.testing.assert_allclose(full, only, atol=2e-6 * scale, err_msg=name)


# Closed forms.

ARMATURE = 0.002  # [kg·m²]


def law(motor: dict[str, float], terms: tuple[str, ...], **more: Any):
    """Step constants of one motor: those of SERVO with some constants replaced."""
    values = {name: np.array([float(value)]) for name, value in (SERVO | motor | more).items()}
    return step_constants(values, H, terms)


SERVO = {
    "kp": 10.0, "kd_over_kp": 0.0, "velocity_filter": 1e-6, "delay": 1e-6, "torque_limit": 100.0,
    "armature": ARMATURE, "coulomb": 0.0, "stribeck_torque": 0.0, "viscous_damping": 0.0,
    "load_friction": 0.0, "gear_stiffness": 70.0, "backlash": 10.0, "gear_damping": 0.0,
    "encoder_zero": 0.0,
}  # fmt: skip
"""A rotor that never touches its gear, in SI units."""


def at(**changes: float) -> MotorState:
    """State of one motor at rest, with some entries changed."""
    values = dict.fromkeys(MotorState._fields, 0.0) | changes
    return MotorState(**{name: np.array([value]) for name, value in values.items()})


def rotor_accelerations(
    p: StepConstants, state: MotorState, target: float, steps: int, terms: tuple[str, ...]
):
    """(steps,) accelerations [rad/s²] of a rotor that is put back after each step."""
    accelerations = []
    for _ in range(steps):
        moved = step(p, state, np.array([target]), np.zeros(1), np.zeros(1), H, NUMPY, terms)[0]
        accelerations.append(float((moved.rotor_vel - state.rotor_vel)[0] / H))
        state = moved._replace(
            rotor_pos=state.rotor_pos, rotor_vel=state.rotor_vel, filtered_vel=state.filtered_vel
        )

    return np.array(accelerations)


def test_a_profile_keeps_within_speed_and_acceleration_and_lands_without_overshoot():
    rng = np.random.default_rng(0)
    count = 400
    speeds = np.exp(rng.uniform(-1, 3, count))
    accelerations = np.exp(rng.uniform(1, 7, count))
    limits = {"profile_speed": speeds, "profile_acceleration": accelerations}
    values = {name: np.full(count, value) for name, value in SERVO.items()} | limits
    p = step_constants(values, H, ("profile",))
    target, begin = rng.uniform(-2, 2, (2, count))
    at_rest = MotorState(**dict.fromkeys(MotorState._fields, np.zeros(count)))
    state = at_rest._replace(reference=begin)
    references = [begin]
    still = np.zeros(count)

    for _ in range(20_000):
        state = step(p, state, target, still, still, H, NUMPY, ("profile",))[0]
        state = state._replace(rotor_pos=still, rotor_vel=still, filtered_vel=still)
        references.append(state.reference)

    moved = np.array(references)
    speed = np.diff(moved, axis=0, prepend=begin[None]) / H

    assert np.all(np.abs(speed) <= speeds * (1 + 1e-9))
    assert np.all(np.abs(np.diff(speed, axis=0)) <= accelerations * H * (1 + 1e-9) + 1e-9)

    # whole steps overshoot by at most an eighth of the travel of one step's acceleration
    travel = (moved - begin) * np.sign(target - begin)
    beyond = accelerations * H * H / 8 + 1e-9

    assert np.all(travel <= np.abs(target - begin) + beyond)
    assert np.all(np.diff(travel, axis=0) >= -beyond)
    np.testing.assert_allclose(moved[-1], target, atol=1e-6)


def test_a_dead_zone_is_taken_from_the_error_on_both_sides():
    p = law({}, ("dead_zone",), dead_zone=0.05)
    kp = SERVO["kp"]
    # The law is implicit: it counts half a step of its own motion where it is active, which acts
    # like armature.
    effective_armature = ARMATURE + 0.25 * H * H * kp

    for target, error in ((0.04, 0.0), (-0.05, 0.0), (0.15, 0.1), (-0.25, -0.2)):
        acceleration = rotor_accelerations(p, at(), target, 1, ("dead_zone",))[0]
        expected = kp * error / effective_armature
        assert acceleration == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_an_integral_grows_at_its_rate_and_is_clamped():
    p = law({"kp": 0.01}, ("integral",), integral_rate=20.0, integral_limit=0.003)
    torque = ARMATURE * rotor_accelerations(p, at(), 0.1, 400, ("integral",))
    grown = 0.01 * 0.1 * (1 + np.minimum(20.0 * H * np.arange(1, 401), 3.0))

    np.testing.assert_allclose(torque, grown, rtol=1e-4)

    down = ARMATURE * rotor_accelerations(p, at(integral=0.003), -0.1, 400, ("integral",))

    assert down[-1] == pytest.approx(-0.01 * 0.1 - 0.003, rel=1e-4)


def test_a_voltage_leaves_no_torque_at_the_no_load_speed_and_all_of_it_at_rest():
    p = law({"kp": 1e3}, ("torque_speed",), stall_torque=2.0, no_load_speed=20.0)

    def torque_at(velocity: float, target: float) -> float:
        state = at(rotor_vel=velocity)
        return ARMATURE * rotor_accelerations(p, state, target, 1, ("torque_speed",))[0]

    for velocity, torque in ((0.0, 2.0), (10.0, 1.0), (20.0, 0.0), (30.0, 0.0), (-10.0, 3.0)):
        assert torque_at(velocity, 1.0) == pytest.approx(torque, rel=1e-9, abs=1e-9)
        assert torque_at(-velocity, -1.0) == pytest.approx(-torque, rel=1e-9, abs=1e-9)


def presliding_motor() -> StepConstants:
    """A rotor on a bristle of 8 N·m/rad with 0.1 N·m of friction and 0.05 N·m·s/rad of damping."""
    motor = {"kp": 1e-3, "coulomb": 0.1, "viscous_damping": 0.05}
    return law(motor, ("presliding",), bristle_stiffness=8.0)


def presliding_step(p: StepConstants, state: MotorState, target: np.ndarray) -> MotorState:
    """The state one step later, with a joint that follows the rotor."""
    return step(p, state, target, state.rotor_pos, np.zeros(1), H, NUMPY, ("presliding",))[0]


@pytest.mark.parametrize("torque", [0.03, 0.08, -0.08])
def test_a_rotor_yields_by_torque_over_stiffness_before_it_breaks_away(torque: float):
    p = presliding_motor()
    state = at()

    # the torque grows so slowly that the rotor does not swing
    for share in np.minimum(1.0, np.arange(4000) / 3000):
        target = np.array([1e3 * share * torque])  # torque over kp
        state = presliding_step(p, state, target)

    assert state.rotor_pos[0] == pytest.approx(torque / 8.0, rel=1e-3)
    assert abs(state.rotor_vel[0]) < 1e-6


def test_a_rotor_that_broke_away_slides_at_its_friction():
    p = presliding_motor()
    state = at()

    for _ in range(2000):
        target = np.array([200.0]) + state.rotor_pos  # 0.2 N·m over kp, from where the rotor is
        state = presliding_step(p, state, target)

    assert state.rotor_vel[0] == pytest.approx((0.2 - 0.1) / 0.05, rel=1e-3)
    assert state.bristle[0] == pytest.approx(0.1 / 8.0, rel=1e-9)


@pytest.mark.parametrize(("supply_share", "scale_of_law"), [(1.0, 0.8), (0.0, 1.0), (20.0, 0.1)])
def test_the_supply_scales_speed_and_torque_and_by_its_share_the_law(
    supply_share: float, scale_of_law: float
):
    of_law = ("kp", "torque_limit", "integral_limit")
    of_supply = ("stall_torque", "no_load_speed")
    nominal = dict.fromkeys((*of_law, *of_supply, "coulomb"), 2.0)

    values = at_operating_conditions(
        OperatingConditions(supply=0.8), nominal | {"supply_share": supply_share}
    )

    for name in of_law:
        assert values[name] == pytest.approx(2.0 * scale_of_law)
    for name in of_supply:
        assert values[name] == pytest.approx(2.0 * 0.8)
    assert values["coulomb"] == pytest.approx(2.0)


def test_angle_friction_is_linear_in_the_angle_down_to_a_tenth():
    constants = step_constants_of_slope(-0.5)
    angles = np.array([-1.0, 0.0, 1.0, 5.0])

    factors = at_angle(constants, 2.0, angles, NUMPY) / 2.0

    np.testing.assert_allclose(factors, [1.5, 1.0, 0.5, 0.1])


def step_constants_of_slope(slope: float) -> StepConstants:
    """Constants with this friction slope; the others are missing."""
    missing = dict.fromkeys(StepConstants._fields)
    return StepConstants(**(missing | {"friction_slope": slope}))
