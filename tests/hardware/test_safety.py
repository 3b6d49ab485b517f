"""Safety gate and fault detection, without a clock: every command is within its limits, none passes after a fault."""

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
target = st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=12, max_size=12).map(
    np.array
)


def started(limits=LIMITS) -> SafetyGate:
    gate = SafetyGate(PUPPER_V2, limits)
    gate.arm(GAINS, PUPPER_V2.nominal_pose, 0.0)
    return gate


@given(
    steps=st.lists(st.tuples(target, st.floats(-1.0, 1.0)), max_size=20),
    speed=st.floats(0.1, 100.0),
)
@settings(max_examples=200, deadline=None)
def test_what_passes_is_within_every_limit(steps: list[tuple[np.ndarray, float]], speed: float):
    gate = started(replace(LIMITS, target_speed=speed))
    now = 0.0
    last = PUPPER_V2.nominal_pose
    for wanted, pause in steps:
        now += pause
        try:
            command = gate.limited(wanted, now)
        except RobotFault:
            assert not np.all(np.isfinite(wanted))
            with pytest.raises(RobotFault):
                gate.limited(PUPPER_V2.nominal_pose, now)
            return
        assert command.pos is not None
        sent = PUPPER_V2.require_wire().joint_signs * command.pos
        assert np.all(sent >= PUPPER_V2.lower) and np.all(sent <= PUPPER_V2.upper)
        assert np.abs(sent - last).max() <= speed * 2 * PUPPER_V2.control_dt + 1e-12
        last = sent


@pytest.mark.parametrize(
    "gains",
    [
        {"kp": 61.0},
        {"kd": 6.1},
        {"max_current": 7.1},
        {"kp": float("nan")},
        {"kd": -1.0},
        {"max_current": 0.0},
    ],
)
def test_gains_beyond_the_limits_are_rejected(gains: dict[str, float]):
    with pytest.raises(ConfigError, match=next(iter(gains))):
        SafetyGate(PUPPER_V2, LIMITS).arm(replace(GAINS, **gains), PUPPER_V2.nominal_pose, 0.0)


def test_after_a_fault_only_idle_passes_or_a_slow_crouch():
    gate = started()
    gate.latch_fault(RobotFault("fall", "down"))
    gate.latch_fault(RobotFault("slow host", "later", safe_state="crouch"))
    gate.allow_crouch()  # not after a fall
    with pytest.raises(RobotFault, match="fall"):
        gate.limited(PUPPER_V2.require_wire().crouch_pose, 1.0)
    with pytest.raises(RobotFault, match="fall"):
        gate.arm(GAINS, PUPPER_V2.nominal_pose, 1.0)
    assert gate.idle().idle
    gate = started()  # a fault that leaves time lets a slow crouch pass
    gate.latch_fault(RobotFault("slow host", "late", safe_state="crouch"))
    gate.allow_crouch()
    gate.slow = True
    command = gate.limited(PUPPER_V2.require_wire().crouch_pose, 0.01)
    moved = np.abs(
        PUPPER_V2.require_wire().joint_signs * command.pos - PUPPER_V2.nominal_pose
    ).max()
    assert moved == pytest.approx(LIMITS.slow_speed * 0.01)


def follows(kp: float, kd: float, lag: float, sag: float = 0.0) -> bool:
    """Whether a joint with this lag [s] is no fault at these gains, at a step and then a sine."""
    tracking = TrackingFaults(PUPPER_V2, LIMITS)
    joint = np.zeros(12)
    faults = []
    tracking.begin(kd / kp)
    for step in range(500):
        wanted = np.full(12, 1.3 if step < 250 else 0.8 * np.sin(2 * np.pi * 1.5 * 0.01 * step))
        joint = joint + (1 - np.exp(-0.01 / lag)) * (wanted - joint)
        faults += tracking.faults(joint + sag, wanted, 0.01 * step)
    return not faults


@pytest.mark.parametrize(("kp", "kd"), [(10.0, 6.0), (50.0, 5.0), (60.0, 1.0)])
def test_the_expected_lag_is_that_of_the_gains_that_were_sent(kp: float, kd: float):
    assert follows(kp, kd, kd / kp, sag=0.2)
    assert not follows(kp, kd, 36.0 * kd / kp)


@pytest.mark.parametrize(("motion", "kind"), [(0.0, "stuck"), (0.01, "tracking")])
def test_a_joint_that_does_not_follow_is_named(motion: float, kind: str):
    tracking = TrackingFaults(PUPPER_V2, LIMITS)
    joint = np.zeros(12)
    wanted = 0.8 * np.eye(12)[4]
    step = 0
    faults = []
    while not faults:
        joint[4] = motion * np.sin(3.0 * step)
        faults += tracking.faults(joint, wanted, 0.01 * step)
        step += 1
    assert (
        step < 200
        and faults[0].name == kind
        and "FL_hip" in str(faults[0])
        and faults[0].safe_state == "idle"
    )


@pytest.mark.parametrize(
    ("late", "every", "too_late", "count"),
    [
        (0.02, 20, 0.02, 20),
        (LIMITS.tick_delay, 100, 0.5 * LIMITS.tick_delay, LIMITS.late_ticks - 1),
    ],
)
def test_some_late_steps_are_allowed_and_many_or_long_ones_are_not(late, every, too_late, count):
    slow_host = SlowHost(LIMITS, 0.01)
    for step in range(1000):
        slow_host.check(late if step % every == 0 else 0.0)
    with pytest.raises(RobotFault, match="slow host"):
        for _ in range(count):
            slow_host.check(too_late)
    with pytest.raises(RobotFault, match="slow host"):
        SlowHost(LIMITS, 0.01).check(LIMITS.tick_delay + 0.01)


@pytest.mark.parametrize(
    ("bad", "kind", "duration"),
    [
        ({"roll": 1.0}, "fall", LIMITS.tilt_time),
        ({"cur": np.full(12, -9.5)}, "current", LIMITS.current_time),
    ],
)
def test_one_damaged_frame_is_no_fault_and_several_in_a_row_are(
    bad: dict, kind: str, duration: float
):
    sensors = SensorFaults(PUPPER_V2, LIMITS)
    good = telemetry(cur=np.full(12, 8.0))
    for step in range(100):
        assert not list(
            sensors.faults(replace(good, **bad) if step % 3 == 0 else good, 0.01 * step)
        )
    times = 1.0 + 0.01 * np.arange(round(duration / 0.01) + 1)
    found = [list(sensors.faults(replace(good, **bad), now)) for now in times]
    assert not found[0] and [fault.name for fault in found[-1]] == [kind]
