"""Every command that passes the safety gate is within its limits; none passes after a fault."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telemetry import telemetry

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.health import SensorFaults, SlowHost, TrackingFaults
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.robots.pupper_v2.robot import PUPPER_V2

LIMITS = PUPPER_V2.require_wire().safety
GAINS = Gains(50.0, 5.0, 7.0)
any_float = st.floats(allow_nan=True, allow_infinity=True)
any_target = st.lists(any_float, min_size=12, max_size=12).map(np.array)


def started(limits=LIMITS) -> SafetyGate:
    gate = SafetyGate(PUPPER_V2, limits)
    gate.arm(GAINS, PUPPER_V2.nominal_pose, 0.0)
    return gate


@given(
    steps=st.lists(st.tuples(any_target, st.floats(-1.0, 1.0)), max_size=20),
    speed=st.floats(0.1, 100.0),
)
@settings(max_examples=200, deadline=None)
def test_what_passes_is_within_every_limit(steps: list[tuple[np.ndarray, float]], speed: float):
    gate = started(replace(LIMITS, target_speed=speed))
    now = 0.0
    last = PUPPER_V2.nominal_pose

    for requested, pause in steps:
        now += pause
        try:
            command = gate.limited(requested, now)
        except RobotFault:
            assert not np.all(np.isfinite(requested))
            with pytest.raises(RobotFault):
                gate.limited(PUPPER_V2.nominal_pose, now)
            return

        assert command.pos is not None
        sent = PUPPER_V2.require_wire().joint_signs * command.pos
        assert np.all(sent >= PUPPER_V2.lower)
        assert np.all(sent <= PUPPER_V2.upper)
        assert np.abs(sent - last).max() <= speed * 2 * PUPPER_V2.control_dt + 1e-12
        last = sent


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("kp", 61.0),
        ("kd", 6.1),
        ("max_current", 7.1),
        ("kp", float("nan")),
        ("kd", -1.0),
        ("max_current", 0.0),
    ],
)
def test_a_gain_beyond_its_limits_is_rejected_with_its_name(name: str, value: float):
    gate = SafetyGate(PUPPER_V2, LIMITS)
    with pytest.raises(ConfigError, match=name):
        gate.arm(replace(GAINS, **{name: value}), PUPPER_V2.nominal_pose, 0.0)


CROUCH_POSE = PUPPER_V2.require_wire().crouch_pose


def test_after_a_fall_only_idle_passes():
    gate = started()
    gate.latch_fault(RobotFault("fall", "down"))
    gate.latch_fault(RobotFault("slow host", "later", safe_state="crouch"))
    gate.allow_crouch()  # without effect after a fall

    with pytest.raises(RobotFault) as refused:
        gate.limited(CROUCH_POSE, 1.0)
    assert refused.value.name == "fall"

    with pytest.raises(RobotFault) as refused:
        gate.arm(GAINS, PUPPER_V2.nominal_pose, 1.0)
    assert refused.value.name == "fall"

    assert gate.idle().idle


def test_after_a_fault_that_leaves_time_a_slow_crouch_passes():
    gate = started()
    gate.latch_fault(RobotFault("slow host", "late", safe_state="crouch"))
    gate.allow_crouch()
    gate.slow = True

    command = gate.limited(CROUCH_POSE, 0.01)

    assert command.pos is not None
    sent = PUPPER_V2.require_wire().joint_signs * command.pos
    moved = np.abs(sent - PUPPER_V2.nominal_pose).max()
    assert moved == pytest.approx(LIMITS.slow_speed * 0.01)


def follows(kp: float, kd: float, lag: float, sag: float = 0.0) -> bool:
    """Whether a joint with this lag [s] is no fault at these gains, in a step and then a sine."""
    tracking = TrackingFaults(PUPPER_V2.joint_names, LIMITS, lag=0.1)
    tracking.begin(kd / kp)
    joint = np.zeros(12)
    faults = []

    for step in range(500):
        position = 1.3 if step < 250 else 0.8 * np.sin(2 * np.pi * 1.5 * 0.01 * step)
        target = np.full(12, position)
        joint = joint + (1 - np.exp(-0.01 / lag)) * (target - joint)
        faults += tracking.faults(joint + sag, target, 0.01 * step)
    return not faults


@pytest.mark.parametrize(("kp", "kd"), [(10.0, 6.0), (50.0, 5.0), (60.0, 1.0)])
def test_a_joint_may_lag_by_the_damping_over_the_stiffness_that_were_sent(kp: float, kd: float):
    assert follows(kp, kd, kd / kp, sag=0.2)
    assert not follows(kp, kd, 36.0 * kd / kp)


@pytest.mark.parametrize(("motion", "fault_name"), [(0.0, "stuck"), (0.01, "tracking")])
def test_a_joint_that_does_not_follow_is_named(motion: float, fault_name: str):
    tracking = TrackingFaults(PUPPER_V2.joint_names, LIMITS, lag=0.1)
    joint = np.zeros(12)
    target = 0.8 * np.eye(12)[4]
    step = 0
    faults = []

    while not faults:
        joint[4] = motion * np.sin(3.0 * step)
        faults += tracking.faults(joint, target, 0.01 * step)
        step += 1

    assert step < 200  # 2 s
    assert faults[0].name == fault_name
    assert faults[0].safe_state == "idle"
    assert "FL_hip" in str(faults[0])


@pytest.mark.parametrize(
    ("late", "interval", "too_late", "count"),
    [
        (0.02, 20, 0.02, 20),
        (LIMITS.tick_delay, 100, 0.5 * LIMITS.tick_delay, LIMITS.late_ticks - 1),
    ],
)
def test_some_late_steps_are_allowed_and_many_in_a_row_are_a_fault(late, interval, too_late, count):
    slow_host = SlowHost(LIMITS, 0.01)
    for step in range(1000):
        slow_host.check(late if step % interval == 0 else 0.0)

    with pytest.raises(RobotFault) as refused:
        for _ in range(count):
            slow_host.check(too_late)

    assert refused.value.name == "slow host"


def test_one_step_later_than_the_tick_delay_is_a_fault():
    with pytest.raises(RobotFault) as refused:
        SlowHost(LIMITS, 0.01).check(LIMITS.tick_delay + 0.01)
    assert refused.value.name == "slow host"


@pytest.mark.parametrize(
    ("damage", "fault_name", "duration"),
    [
        ({"roll": 1.0}, "fall", LIMITS.tilt_time),
        ({"cur": np.full(12, -9.5)}, "current", LIMITS.current_time),
    ],
)
def test_one_damaged_frame_is_no_fault_and_several_in_a_row_are(
    damage: dict, fault_name: str, duration: float
):
    sensors = SensorFaults(PUPPER_V2, LIMITS)
    good = telemetry(cur=np.full(12, 8.0))
    damaged = replace(good, **damage)

    for step in range(100):
        frame = damaged if step % 3 == 0 else good
        assert not list(sensors.faults(frame, 0.01 * step))

    times = 1.0 + 0.01 * np.arange(round(duration / 0.01) + 1)
    faults = [list(sensors.faults(damaged, now)) for now in times]
    assert not faults[0]
    assert [fault.name for fault in faults[-1]] == [fault_name]
