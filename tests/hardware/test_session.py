"""A robot is looked at before it is armed; pilots steer, doctors judge, excitations stay in bounds."""

import contextlib
import os
import pty
import select
import signal
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.commands import run_doctor, run_record
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.doctor import examine
from motorprior.hardware.excitations import excitation_targets, joints_of
from motorprior.hardware.motions import Walker, played, ramp
from motorprior.hardware.pilot import Pilot
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import StopRequest, first_look, look_and_confirm
from motorprior.hardware.settings import RecordSettings
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.terminal import careful
from motorprior.hardware.virtual.firmware import IDLE, FirmwareConfig
from motorprior.hardware.virtual.virtual_robot import VirtualRobot, in_thread
from motorprior.locomotion.policy import Policy
from motorprior.logs.robot_run import Mode
from motorprior.pipeline.twin_body import TwinBody, draw_motors
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@pytest.mark.parametrize(
    ("robot", "fault", "need_imu", "words"),
    [
        ({"imu": False}, None, True, "no IMU.*give without_imu"),
        ({}, "tilted", True, "fall"),
        ({}, "mute", True, "stale telemetry"),
        ({"imu": False}, None, False, None),
    ],
)
def test_a_robot_that_must_not_be_armed_is_refused(
    virtual: Callable, host: Callable, robot: dict, fault: str | None, need_imu: bool, words: str | None
):
    pupper = virtual(**robot)
    connected = host(pupper.port)
    if fault:
        pupper.break_down(fault)
    if words is None:
        first_look(connected, need_imu)
    else:
        with pytest.raises(RobotFault, match=words):
            first_look(connected, need_imu)
    assert pupper.received == 0


def test_a_robot_that_moves_by_itself_is_not_armed(virtual: Callable, host: Callable):
    """One that homes takes no targets meanwhile, and would jump to the first one afterwards."""
    pupper = virtual()
    robot = host(pupper.port)
    pupper.firmware._target = spec.JOINT_SIGNS * spec.NOMINAL_POSE  # it gets up
    with pytest.raises(RobotFault, match=r"moved .* this host sent nothing.*homed"):
        first_look(robot, True)
    assert pupper.received == 0


@pytest.fixture
def at_period() -> Iterator[Callable[[int], VirtualRobot]]:
    """A virtual Pupper whose firmware sends every so many milliseconds, which the command line does not offer."""
    ends = []

    def start(period: int) -> VirtualRobot:
        body = TwinBody(PUPPER_V2, draw_motors(PUPPER_V2, load_fleet("pupper_v2"), 0), False, 0)
        pupper = VirtualRobot(PUPPER_V2, body, FirmwareConfig(telemetry_period=period, homes=False))
        ends.append(in_thread(pupper))
        return pupper

    yield start
    for end in ends:
        end()


@pytest.mark.flaky(reruns=2)
@pytest.mark.parametrize(("period", "well"), [(20, False), (15, False), (10, True), (5, True)])
def test_telemetry_slower_than_the_control_period_is_refused(
    at_period: Callable, host: Callable, period: int, well: bool
):
    """By the robot's own clock: what waited in a buffer meanwhile makes no rate."""
    pupper = at_period(period)
    robot = host(pupper.port)
    time.sleep(0.3)
    if well:
        first_look(robot, True)
    else:
        with pytest.raises(RobotFault, match=r"80 per second are the least.*PRINT_DELAY"):
            first_look(robot, True)
    assert pupper.received == 0


def test_what_happened_while_the_policy_was_compiled_is_seen(virtual: Callable, host: Callable):
    pupper = virtual()

    def prepare(_: Measurement) -> None:
        pupper.break_down("tilted")
        time.sleep(0.2)

    with pytest.raises(RobotFault, match="fall"):
        look_and_confirm(host(pupper.port), lambda: None, True, prepare)
    assert pupper.received == 0


def test_noise_on_the_line_does_not_stop_a_walk(virtual: Callable, host: Callable, trot: Path):
    """1 % of the frames lost, 1 % damaged, 1 % twice, both ways."""
    pupper = virtual(drop=0.01, corrupt=0.01, duplicate=0.01, currents=True)
    policy = Policy.load(trot)
    run = walk(host(pupper.port), policy, gains_for(PUPPER_V2, policy), StopRequest(), seconds=1.5)
    assert run.stopped_by == "time" and len(run.timing.sent) > 100
    deadline = time.monotonic() + 2.0
    while pupper.firmware.mode != IDLE and time.monotonic() < deadline:
        time.sleep(0.01)
    assert pupper.firmware.mode == IDLE
    attitude = pupper.body.live.state().attitude  # pyright: ignore[reportAttributeAccessIssue]
    assert np.abs(attitude[:2]).max() < 0.3, "on its feet"


def test_a_port_has_one_user(virtual: Callable):
    pupper = virtual()
    link = SerialLink(PUPPER_V2, pupper.port)
    with pytest.raises(RobotFault, match=r"/dev/null .*no serial port"):
        SerialLink(PUPPER_V2, "/dev/null")
    with pytest.raises(RobotFault, match="close every other program"):
        SerialLink(PUPPER_V2, pupper.port)
    link.close()
    with pytest.raises(RobotFault, match="unplugged"):
        link.wait(time.monotonic())


def test_the_doctor_finds_what_is_wrong(virtual: Callable, host: Callable):
    healthy, sick = virtual(currents=True), virtual(imu=False, corrupt=0.2)
    well = {one.check: one for one in examine(host(healthy.port), 1.0)}
    assert all(one.well for one in well.values()), well
    assert "not sent" not in well["currents"].finding and len(well) == 17
    ill = {one.check: one for one in examine(host(sick.port), 1.0)}
    assert not ill["IMU"].well and not ill["frames"].well
    assert ill["currents"].finding == "not sent (position only)" and healthy.received == sick.received == 0


@pytest.mark.parametrize(("kind", "said"), [("numb", "have been the same for 0.3"), ("blind", "have been the same")])
def test_the_doctor_sees_an_imu_that_stopped(virtual: Callable, host: Callable, kind: str, said: str):
    """Other than zero is not alive: a frozen sensor repeats its last values."""
    pupper = virtual()
    robot = host(pupper.port)
    timer = threading.Timer(0.5, lambda: pupper.break_down(kind))
    timer.start()
    (imu,) = (one for one in examine(robot, 1.5) if one.check == "IMU")
    timer.join()
    assert not imu.well and said in imu.finding and imu.remedy


def test_the_doctor_takes_the_current_away_when_asked(virtual: Callable, when: Callable):
    pupper = virtual()
    found = run_doctor(PUPPER_V2, pupper.port, 1.0, idle=True)
    assert {one.check for one in found if not one.well} <= {f"joint {name}" for name in spec.JOINT_NAMES}, "it sank"
    when(pupper, IDLE)
    assert {what for _, what in pupper.events} == {IDLE}


def test_a_device_that_is_no_robot_is_sent_nothing():
    master, slave = pty.openpty()
    tty.setraw(slave)
    with pytest.raises(RobotFault, match="stale telemetry"):
        run_doctor(PUPPER_V2, os.ttyname(slave), 1.0, idle=True)
    assert not select.select([master], [], [], 0.1)[0]
    os.close(master)
    os.close(slave)


def test_signals_after_the_second_one_are_too_late_to_hinder():
    stop = StopRequest()
    stop.on_signal(signal.SIGINT, None)
    assert stop() and stop.reason == "SIGINT"
    with pytest.raises(RobotFault, match="second signal, SIGTERM"):
        stop.on_signal(signal.SIGTERM, None)
    stop.on_signal(signal.SIGINT, None)


def test_words_do_not_wait_for_a_terminal_that_takes_none():
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writer, 4096 * b"x"):
            pass
    os.set_blocking(writer, True)
    said = []
    with open(writer, "w") as pipe:
        say = careful(said.append, pipe)
        say("lost")
        os.read(reader, 65536)
        say("heard")
    say("to a closed file")
    os.close(reader)
    assert said == ["heard", "to a closed file"]


def test_nobody_at_the_terminal_is_refused_also_without_a_standard_input(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(ConfigError, match="no terminal to confirm at"):
        run_record(PUPPER_V2, "/dev/null", RecordSettings(), lambda _: None)


def test_silence_is_a_diagnosis(host: Callable):
    master, slave = pty.openpty()
    with pytest.raises(RobotFault, match="nothing that is a frame in 1 s"):
        examine(host(os.ttyname(slave)), 1.0)
    os.close(master)
    os.close(slave)


@given(
    kind=st.sampled_from(["sine", "chirp", "steps", "multisine", "gait"]),
    joint=st.sampled_from(["all", "FR", "knee", "RL_hip"]),
    seconds=st.floats(1.0, 20.0),
    amplitude=st.floats(0.05, 1.5),
    speed=st.floats(0.5, 20.0),
    seed=st.integers(0, 100),
)
@settings(max_examples=60, deadline=None)
def test_an_excitation_stays_within_amplitude_and_speed(kind, joint, seconds, amplitude, speed, seed):
    targets = excitation_targets(PUPPER_V2, kind, joints_of(PUPPER_V2, joint), seconds, amplitude, speed, seed)
    away = targets - spec.NOMINAL_POSE
    assert np.abs(away).max() <= amplitude + 1e-9
    assert np.all(targets >= spec.JOINT_LOWER) and np.all(targets <= spec.JOINT_UPPER)
    moving = set(np.flatnonzero(np.abs(away).max(axis=0)))
    assert moving <= set(joints_of(PUPPER_V2, joint)) and moving
    assert np.abs(away[0]).max() == 0.0 and np.abs(away[-1]).max() < 1e-9
    if kind != "steps":
        assert np.abs(np.diff(targets, axis=0)).max() <= speed * spec.CONTROL_DT + 1e-9


@pytest.mark.parametrize("joint", ["abduction", "FL_abduction"])
def test_an_excitation_that_would_move_nothing_is_refused(joint: str):
    with pytest.raises(ConfigError, match=r"gait does not move .*FL_abduction.*another joint"):
        excitation_targets(PUPPER_V2, "gait", joints_of(PUPPER_V2, joint), 2.0, 0.3, 8.0, 0)


def test_joints_are_found_by_any_of_their_names():
    assert joints_of(PUPPER_V2, "all") == tuple(range(12)) and joints_of(PUPPER_V2, "RL_knee") == (11,)
    assert joints_of(PUPPER_V2, "FL") == (3, 4, 5) and joints_of(PUPPER_V2, "hip") == (1, 4, 7, 10)
    with pytest.raises(ConfigError):
        joints_of(PUPPER_V2, "")


def test_a_ramp_begins_and_ends_softly_and_keeps_its_speed():
    start, goal = np.zeros(12), np.linspace(-1.0, 2.0, 12)
    motion, row = ramp(start, goal, 1.5, 0.01, hold=0.1), []
    while (target := motion(None)) is not None:  # pyright: ignore[reportArgumentType]
        row.append(target)
    speeds = np.abs(np.diff([start, *row], axis=0)) / 0.01
    assert speeds.max() <= 1.5 and speeds[0].max() < 0.05 and np.array_equal(row[-1], goal)
    assert len([target for target in row if np.array_equal(target, goal)]) >= 10


def test_keys_and_stick_move_the_throttle_and_stop():
    keys, typed = os.pipe()
    stick, pushed = os.pipe()
    pilot = Pilot(keys, stick, 1.0)
    assert pilot.throttle() == 1.0
    os.write(typed, b"sss")
    assert pilot.throttle() == pytest.approx(0.7)
    os.write(typed, b"\x1b[A")
    assert pilot.throttle() == pytest.approx(0.8)
    os.write(typed, b" ")
    assert pilot.throttle() == 0.0
    os.write(pushed, struct.pack("<IhBB", 0, -16384, 0x82, 1) + struct.pack("<IhBB", 1, -32767, 2, 1))
    assert pilot.throttle() == 1.0, "an event at the start says where the stick is, nobody pushed it"
    os.write(pushed, struct.pack("<IhBB", 2, 1, 1, 0))
    assert pilot.throttle() is None, "a button"
    os.write(typed, b"q")
    assert pilot.throttle() is None
    os.close(typed)
    assert pilot.throttle() is None, "a lost terminal"


def test_throttle_scales_the_stride_and_full_throttle_is_the_policy_itself(trot: Path):
    from motorprior.hardware.axes import backend_state
    from motorprior.hardware.protocol import Telemetry

    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    state = backend_state(PUPPER_V2, Telemetry(**zeros, pos=spec.NOMINAL_POSE, vel=np.zeros(12)), np.zeros(12))

    def stride(throttle: float) -> float:
        walker = Walker(PUPPER_V2, Policy.load(trot))
        walker.throttle = throttle
        return float(np.ptp([walker.step(state)[1] for _ in range(300)][100:]))

    assert stride(0.0) < 0.02 < stride(0.5) < stride(1.0)


def test_gains_of_a_policy_near_the_robot_s_are_the_robot_s(trot: Path):
    policy = Policy.load(trot)
    assert (gains_for(PUPPER_V2, policy).kp, gains_for(PUPPER_V2, policy).kd) == (50.0, 5.0)
    assert (gains_for(PUPPER_V2, policy, 22.0, 2.2).kp, gains_for(PUPPER_V2, policy, 22.0, 2.2).kd) == (22.0, 2.2)


@pytest.mark.flaky(reruns=2)
def test_a_soft_joint_may_take_its_time(still_body, host: Callable):
    """With 10 A/rad and 6 A·s/rad a joint needs 0.6 s, not 0.1 s: that is no fault."""
    pupper = VirtualRobot(PUPPER_V2, still_body, FirmwareConfig(homes=False, with_imu=False))
    end = in_thread(pupper)
    robot = host(pupper.port)
    robot.arm(10.0, 6.0, 7.0)
    ControlLoop(robot, robot.limits, spec.CONTROL_DT, lambda: False).play(
        played(np.tile(spec.NOMINAL_POSE - np.tile([0.0, 1.6, 0.0], 4), (150, 1))), Mode.EXCITE
    )
    robot.idle()
    end()


def test_gains_reach_the_robot_in_commands_of_their_own(virtual: Callable, host: Callable, stand_up: Callable):
    """Some firmwares read nothing but `pos` beside it."""
    pupper = virtual()
    pupper.firmware._gains = (1.0, 1.0, 1.0)
    robot = host(pupper.port)
    stand_up(robot)
    assert pupper.firmware.gains == (50.0, 5.0, 7.0)


def test_the_gains_come_with_each_of_the_first_targets(virtual: Callable, host: Callable):
    """One of them may get lost, and what a firmware holds by itself may be another current limit."""
    pupper, gains = virtual(), []
    robot = host(pupper.port)
    robot.arm(50.0, 5.0, 2.0)
    for _ in range(3):
        pupper.firmware._gains = (1.0, 1.0, 1.0)
        robot.send(spec.NOMINAL_POSE, Mode.RAMP)
        robot.receive(time.monotonic() + 0.03)
        gains.append(pupper.firmware._gains)
    assert gains == 3 * [(50.0, 5.0, 2.0)]
