"""Safety gate and fault detection, without a clock: every command is within its limits, none passes after a fault."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import Electrical, FrozenImu, Pace, Tilt, Tracking
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.safety_gate import SafetyGate
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

LIMITS = PUPPER_V2.require_wire().safety
target = st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=12, max_size=12).map(np.array)


def armed(**settings: float) -> SafetyGate:
    gate = SafetyGate(PUPPER_V2, LIMITS, **{"kp": 50.0, "kd": 5.0, "max_current": 7.0, **settings})
    gate.start_at(spec.NOMINAL_POSE, 0.0)
    return gate


def telemetry(**values) -> Telemetry:
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    return Telemetry(**{**zeros, "pos": np.zeros(12), "vel": np.zeros(12), **values})


@given(steps=st.lists(st.tuples(target, st.floats(-1.0, 1.0)), max_size=20), speed=st.floats(0.1, 100.0))
@settings(max_examples=300, deadline=None)
def test_what_passes_is_inside_every_bound(steps: list[tuple[np.ndarray, float]], speed: float):
    gate, now, last = SafetyGate(PUPPER_V2, replace(LIMITS, target_speed=speed), 50.0, 5.0, 7.0), 0.0, spec.NOMINAL_POSE
    gate.start_at(last, now)
    for wanted, pause in steps:
        now += pause
        try:
            command = gate.limited(wanted, now)
        except RobotFault:
            assert not np.all(np.isfinite(wanted))
            with pytest.raises(RobotFault):
                gate.limited(spec.NOMINAL_POSE, now)
            return
        assert command.pos is not None
        sent = spec.JOINT_SIGNS * command.pos
        assert np.all(sent >= spec.JOINT_LOWER) and np.all(sent <= spec.JOINT_UPPER)
        assert np.abs(sent - last).max() <= speed * 2 * spec.CONTROL_DT + 1e-12
        law = gate.gains()
        assert (law.pos, law.kp, law.kd, law.max_current) == (None, 50.0, 5.0, 7.0)
        last = sent


def test_clipped_targets_are_counted():
    gate = armed()
    gate.limited(spec.NOMINAL_POSE + 0.1, 0.0)
    assert (gate.position_clips, gate.slew_clips) == (0, 12), "no time has passed"
    gate.limited(np.full(12, 9.0), 0.01)
    assert gate.position_clips == 12


@pytest.mark.parametrize(
    "gains", [{"kp": 61.0}, {"kd": 6.1}, {"max_current": 7.1}, {"kp": float("nan")}, {"kd": -1.0}, {"max_current": 0.0}]
)
def test_gains_beyond_the_limits_are_refused(gains: dict[str, float]):
    with pytest.raises(RobotFault, match="gains"):
        armed(**gains)


def test_the_first_fault_latches():
    gate = armed()
    gate.latch(RobotFault("fall", "down"))
    gate.latch(RobotFault("current", "later"))
    for action in (
        lambda: gate.limited(spec.NOMINAL_POSE, 1.0),
        gate.gains,
        lambda: gate.start_at(spec.NOMINAL_POSE, 1.0),
    ):
        with pytest.raises(RobotFault, match="fall"):
            action()
    gate.allow_crouch()
    with pytest.raises(RobotFault, match="fall"):
        gate.limited(spec.CROUCH_POSE, 1.0)  # no way down after a fall
    assert gate.idle().idle


def test_a_fault_that_leaves_time_lets_a_slow_crouch_pass():
    gate = armed()
    gate.latch(RobotFault("battery", "empty", safe_state="crouch"))
    gate.allow_crouch()
    gate.slow = True
    command = gate.limited(spec.CROUCH_POSE, 0.01)
    moved = np.abs(spec.JOINT_SIGNS * command.pos - spec.NOMINAL_POSE).max()
    assert moved == pytest.approx(LIMITS.slow_speed * 0.01)


def test_one_tilted_frame_is_no_fall():
    tilt = Tilt(LIMITS)
    for time, roll in ((0.0, 0.0), (0.01, 1.0), (0.02, 0.0), (0.03, 1.0), (0.04, 1.0)):
        tilt.check(telemetry(roll=roll), time)
    with pytest.raises(RobotFault, match="fall"):
        for time in (0.05, 0.06):
            tilt.check(telemetry(pitch=-1.0), time)


def test_a_joint_that_follows_with_the_lag_of_its_gains_is_well():
    """First-order lag kd/kp, and 0.2 rad of sag: a real motor."""
    tracking, joint = Tracking(PUPPER_V2, LIMITS), np.zeros(12)
    for step in range(500):
        wanted = 0.8 * np.sin(2 * np.pi * 1.5 * 0.01 * step) * np.ones(12)
        joint = joint + (1 - np.exp(-0.1)) * (wanted - joint)
        tracking.check(joint + 0.2, wanted, 0.01 * step)


@pytest.mark.parametrize(("kp", "kd"), [(10.0, 6.0), (60.0, 1.0)])
def test_the_lag_is_that_of_the_gains_that_were_sent(kp: float, kd: float):
    """A soft joint that follows in its own time is well; a stiff one that follows like a soft one is not."""

    def follows(lag: float) -> bool:
        tracking, joint = Tracking(PUPPER_V2, LIMITS), np.zeros(12)
        tracking.begin(kd / kp)
        try:
            for step in range(300):
                joint = joint + (1 - np.exp(-0.01 / lag)) * (1.3 - joint)
                tracking.check(joint, np.full(12, 1.3), 0.01 * step)
        except RobotFault:
            return False
        return True

    assert follows(kd / kp)
    assert not follows(36.0 * kd / kp)


@pytest.mark.parametrize(("motion", "kind"), [(0.0, "stuck"), (0.01, "tracking")])
def test_a_joint_that_does_not_follow_is_named(motion: float, kind: str):
    tracking, joint = Tracking(PUPPER_V2, LIMITS), np.zeros(12)
    with pytest.raises(RobotFault, match=rf"{kind}.*FL_hip") as caught:
        for step in range(200):
            joint[4] = motion * np.sin(3.0 * step)
            wanted = np.zeros(12)
            wanted[4] = 0.8
            tracking.check(joint, wanted, 0.01 * step)
    assert caught.value.safe_state == "idle"


def alive(step: int) -> Telemetry:
    noise = 1e-3 * (1 + step % 7)
    return telemetry(roll=noise, pitch=noise, roll_rate=noise)


FROZEN = {"the same": telemetry(roll=0.01, pitch=0.02, roll_rate=0.1), "zeros": telemetry()}


@pytest.mark.parametrize("frozen", FROZEN.values(), ids=FROZEN)
def test_an_imu_that_was_alive_and_stops_is_a_fault(frozen: Telemetry):
    imu = FrozenImu(LIMITS)
    for step in range(100):
        imu.check(alive(step), 0.01 * step)
    with pytest.raises(RobotFault, match="frozen IMU") as caught:
        for step in range(100, 100 + round(100 * LIMITS.imu_time) + 2):
            imu.check(frozen, 0.01 * step)
    assert caught.value.safe_state == "crouch"


def test_some_late_steps_are_allowed_and_many_are_not():
    pace = Pace(LIMITS, 0.01)
    for step in range(2000):
        pace.check(0.02 if step % 20 == 0 else 0.0)
    with pytest.raises(RobotFault, match="slow host"):
        for _ in range(20):
            pace.check(0.02)
    with pytest.raises(RobotFault, match=f"{1e3 * (LIMITS.tick_delay + 0.01):.0f} ms late"):
        Pace(LIMITS, 0.01).check(LIMITS.tick_delay + 0.01)


def test_a_pause_that_the_robot_survives_is_no_fault_and_several_in_a_row_are():
    """Each of them is safe when the robot has come back to its gait."""
    pace = Pace(LIMITS, 0.01)
    for step in range(1000):
        pace.check(LIMITS.tick_delay if step % 100 == 0 else 0.0)
    with pytest.raises(RobotFault, match="in all"):
        for _ in range(LIMITS.late_ticks - 1):
            pace.check(0.5 * LIMITS.tick_delay)


@pytest.mark.parametrize(
    ("bad", "well", "kind", "duration"),
    [
        ({"cur": np.full(12, -9.5)}, {"cur": np.full(12, 8.0)}, "current", LIMITS.current_time),
        ({"temp": np.full(12, 95.0)}, {"temp": np.full(12, 40.0)}, "temperature", LIMITS.warning_time),
        ({"bat": 3.0}, {"bat": 22.0}, "battery", LIMITS.warning_time),
    ],
)
def test_one_damaged_frame_is_no_overcurrent_no_heat_and_no_flat_battery(
    bad: dict, well: dict, kind: str, duration: float
):
    electrical = Electrical(PUPPER_V2, LIMITS)
    for step in range(100):
        electrical.check(telemetry(**(bad if step % 3 == 0 else well)), 0.01 * step)
    with pytest.raises(RobotFault) as caught:
        for step in range(round(duration / 0.01) + 1):
            electrical.check(telemetry(**bad), 2.0 + 0.01 * step)
    assert caught.value.kind == kind
