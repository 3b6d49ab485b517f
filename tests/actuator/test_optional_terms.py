"""Each term of a servo does what its formula says, nothing where it is absent, and is compiled as it is written."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy_arithmetic import NUMPY

from motorprior.actuator.geared_motor_step import MotorState, StepConstants, step, step_constants
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.optional_terms import TERMS, OperatingConditions, at_conditions

Networks = Callable[..., GreyBox]
H = 0.002
EVERY = tuple(TERMS)
CASES = pytest.mark.parametrize("terms", [("dead_zone",), ("profile", "heat"), EVERY], ids=len)
MOTORS = 11  # eight lanes and three alone
STRONG = {
    "asymmetry": 0.3,
    "dead_zone": 0.02,
    "heat_loss": 0.3,
    "output_damping": 0.02,
    "temperature_loss": 0.3,
}


def drawn_states(
    motors: GreyBoxActuator, terms: tuple[str, ...], rng: np.random.Generator
) -> dict[str, Any]:
    """Random states of motors with these terms: rotor, joint, delayed target, and what the terms remember."""
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
        drawn |= {
            "reference": drawn["target"] + 0.1 * rng.standard_normal(n)
            if "profile" in terms
            else drawn["target"],
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
    every = stepped(step_constants(values, H, terms), drawn, EVERY)

    arrays = motors.arrays(H)
    torque = np.zeros(MOTORS)
    reset_actuator(arrays, drawn["target"].copy(), drawn["q"].copy())
    for row, name in enumerate(MotorState._fields):
        arrays.memory[row] = drawn[name]
    step_actuator(arrays, H, drawn["target"].copy(), drawn["q"].copy(), drawn["dq"].copy(), torque)
    compiled = (*arrays.memory[: len(MotorState._fields)], torque, arrays.damping)
    names = (*MotorState._fields, "torque", "damping")
    for name, found, formula, only in zip(
        names, compiled, (*every[0], *every[1:]), (*alone[0], *alone[1:]), strict=True
    ):
        scale = max(np.abs(formula).max(), 1e-3)
        np.testing.assert_allclose(found, formula, atol=1e-12 * scale, err_msg=name)
        remembered = name in ("current", "bristle", "reference", "reference_vel", "integral")
        if terms == EVERY or not remembered:  # what absent terms remember is nobody's
            np.testing.assert_allclose(formula, only, atol=2e-6 * scale, err_msg=name)


# Closed forms.


def law(motor: dict[str, float], terms: tuple[str, ...], **more: Any):
    """A motor of one kind: `StepConstants` from constants by name, those of SERVO if not given."""
    values = {name: np.array([float(value)]) for name, value in (SERVO | motor | more).items()}
    return step_constants(values, H, terms)


SERVO = {
    "kp": 10.0, "kd_over_kp": 0.0, "velocity_filter": 1e-6, "delay": 1e-6, "torque_limit": 100.0, "armature": 0.002,
    "coulomb": 0.0, "stribeck_torque": 0.0, "viscous_damping": 0.0, "load_friction": 0.0, "gear_stiffness": 70.0,
    "backlash": 10.0, "gear_damping": 0.0, "encoder_zero": 0.0,
}  # fmt: skip
"""A rotor that never touches its gear, in SI units."""


def at(**changes: float) -> MotorState:
    """A state at rest but for these."""
    values = dict.fromkeys(MotorState._fields, 0.0) | changes
    return MotorState(**{name: np.array([value]) for name, value in values.items()})


def rotor_accelerations(
    p: StepConstants, state: MotorState, target: float, steps: int, terms: tuple[str, ...]
):
    """(steps,) accelerations of the rotor, held in place: what its torque is, over the armature."""
    found = []
    for _ in range(steps):
        moved = step(p, state, np.array([target]), np.zeros(1), np.zeros(1), H, NUMPY, terms)[0]
        found.append(float((moved.rotor_vel - state.rotor_vel)[0] / H))
        state = moved._replace(
            rotor_pos=state.rotor_pos, rotor_vel=state.rotor_vel, filtered_vel=state.filtered_vel
        )
    return np.array(found)


def test_a_profile_keeps_within_speed_and_acceleration_and_lands_without_overshoot():
    rng = np.random.default_rng(0)
    count = 400
    speeds = np.exp(rng.uniform(-1, 3, count))
    accelerations = np.exp(rng.uniform(1, 7, count))
    limits = {"profile_speed": speeds, "profile_acceleration": accelerations}
    values = {name: np.full(count, value) for name, value in SERVO.items()} | limits
    p = step_constants(values, H, ("profile",))
    target, begin = rng.uniform(-2, 2, (2, count))
    state = MotorState(**dict.fromkeys(MotorState._fields, np.zeros(count)))._replace(
        reference=begin
    )
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
    # no further than whole steps make it: an eighth of what one step's acceleration moves
    travel = (moved - begin) * np.sign(target - begin)
    beyond = accelerations * H * H / 8 + 1e-9
    assert np.all(travel <= np.abs(target - begin) + beyond) and np.all(
        np.diff(travel, axis=0) >= -beyond
    )
    np.testing.assert_allclose(moved[-1], target, atol=1e-6)


def test_a_dead_zone_is_taken_from_the_error_on_both_sides():
    p = law({}, ("dead_zone",), dead_zone=0.05)
    for target, error in ((0.04, 0.0), (-0.05, 0.0), (0.15, 0.1), (-0.25, -0.2)):
        found = rotor_accelerations(p, at(), target, 1, ("dead_zone",))[0]
        # the law is implicit: half a step of its own motion is taken into account where it is live
        braked = 0.002 + 0.25 * H * H * 10.0
        assert found == pytest.approx(10.0 * error / braked, rel=1e-6, abs=1e-9)


def test_an_integral_grows_at_its_rate_and_is_clamped():
    p = law({"kp": 0.01}, ("integral",), integral_rate=20.0, integral_limit=0.003)
    found = 0.002 * rotor_accelerations(p, at(), 0.1, 400, ("integral",))
    grown = 0.01 * 0.1 * (1 + np.minimum(20.0 * H * np.arange(1, 401), 3.0))
    np.testing.assert_allclose(found, grown, rtol=1e-4)
    down = 0.002 * rotor_accelerations(p, at(integral=0.003), -0.1, 400, ("integral",))
    assert down[-1] == pytest.approx(-0.01 * 0.1 - 0.003, rel=1e-4)


def test_a_voltage_leaves_no_torque_at_the_no_load_speed_and_all_of_it_at_rest():
    p = law({"kp": 1e3}, ("torque_speed",), stall_torque=2.0, no_load_speed=20.0)
    for velocity, torque in ((0.0, 2.0), (10.0, 1.0), (20.0, 0.0), (30.0, 0.0), (-10.0, 3.0)):
        found = 0.002 * rotor_accelerations(p, at(rotor_vel=velocity), 1.0, 1, ("torque_speed",))[0]
        assert found == pytest.approx(torque, rel=1e-9, abs=1e-9)
        mirrored = (
            0.002 * rotor_accelerations(p, at(rotor_vel=-velocity), -1.0, 1, ("torque_speed",))[0]
        )
        assert mirrored == pytest.approx(-torque, rel=1e-9, abs=1e-9)


def test_a_rotor_yields_by_torque_over_stiffness_before_it_breaks_away_and_slides_at_its_friction():
    p = law(
        {"kp": 1e-3, "coulomb": 0.1, "viscous_damping": 0.05},
        ("presliding",),
        bristle_stiffness=8.0,
    )
    for torque in (0.03, 0.08, -0.08):
        state = at()
        for share in np.minimum(1.0, np.arange(4000) / 3000):  # so gently that it does not swing
            pull = np.array([1e3 * share * torque])
            state = step(p, state, pull, state.rotor_pos, np.zeros(1), H, NUMPY, ("presliding",))[0]
        assert state.rotor_pos[0] == pytest.approx(torque / 8.0, rel=1e-3)
        assert abs(state.rotor_vel[0]) < 1e-6
    state = at()
    for _ in range(2000):
        far = np.array([200.0]) + state.rotor_pos  # a torque of 0.2 wherever it is
        state = step(p, state, far, state.rotor_pos, np.zeros(1), H, NUMPY, ("presliding",))[0]
    assert state.rotor_vel[0] == pytest.approx((0.2 - 0.1) / 0.05, rel=1e-3)
    assert state.bristle[0] == pytest.approx(0.1 / 8.0, rel=1e-9)


@pytest.mark.parametrize(("share", "law"), [(1.0, 0.8), (0.0, 1.0), (20.0, 0.1)])
def test_a_voltage_limits_speed_and_torque_and_where_it_drives_the_motor_scales_the_law(
    share: float, law: float
):
    values = dict.fromkeys(
        ("kp", "torque_limit", "integral_limit", "stall_torque", "no_load_speed", "coulomb"), 2.0
    )
    found = at_conditions(OperatingConditions(supply=0.8), values | {"supply_share": share})
    assert [found[name] for name in ("kp", "torque_limit", "integral_limit")] == pytest.approx(
        [2.0 * law] * 3
    )
    assert [found[name] for name in ("stall_torque", "no_load_speed", "coulomb")] == pytest.approx(
        [1.6, 1.6, 2.0]
    )
