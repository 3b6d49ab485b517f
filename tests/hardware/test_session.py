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
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from policies import as_file_content, random_policy

from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.commands import run_doctor, run_record
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.doctor import examine
from motorprior.hardware.excitations import excitation_targets, joints_of
from motorprior.hardware.motions import Walker, played, ramp
from motorprior.hardware.pilot import ALONE, Pilot, pilot
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import StopRequest, first_look, look_and_confirm
from motorprior.hardware.settings import RecordSettings
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.terminal import careful
from motorprior.hardware.virtual.firmware import IDLE, FirmwareConfig
from motorprior.hardware.virtual.virtual_robot import VirtualRobot, in_thread
from motorprior.locomotion.policy import Policy
from motorprior.logs.formats.robot_run import Mode
from motorprior.pipeline.virtual.twin_body import TwinBody, draw_motors
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

GAIT = PUPPER_V2.require_legs()


def test_a_port_that_was_open_long_before_it_was_read_is_no_fault(virtual: Callable, host: Callable):
    """Its buffer has the robot's first frames, and nothing of what came later."""
    port = SerialLink(PUPPER_V2, virtual().port)
    time.sleep(2.5)
    with RobotLink(PUPPER_V2, port) as link:
        first_look(link, True)


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
    run = walk(host(pupper.port), policy, gains_for(PUPPER_V2, policy), StopRequest(), seconds=1.5, command=(0.2, 0.0))
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
    kind=st.sampled_from(["varied", "sine", "chirp", "steps", "multisine", "gait"]),
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
    smooth = targets[: len(targets) // 2] if kind == "varied" else targets
    if kind != "steps":
        assert np.abs(np.diff(smooth, axis=0)).max() <= speed * spec.CONTROL_DT + 1e-9


def test_a_slow_gait_is_the_same_gait():
    fast, slow = (
        excitation_targets(PUPPER_V2, "gait", range(12), 8.0, 0.4, speed, 0) - spec.NOMINAL_POSE for speed in (8.0, 2.0)
    )
    np.testing.assert_allclose(slow * np.abs(fast).max(), fast * np.abs(slow).max(), atol=1e-9)


def test_a_varied_excitation_moves_all_joints_and_then_one_after_the_other():
    targets = excitation_targets(PUPPER_V2, "varied", joints_of(PUPPER_V2, "all"), 24.0, 0.4, 40.0, 0)
    together, alone = np.split(np.abs(targets - spec.NOMINAL_POSE) > 0.0, 2)
    assert np.all(together[1:-1].sum(axis=1) == 12)
    assert alone.sum(axis=1).max() == 1
    order = [int(row.argmax()) for row in alone if row.any()]
    assert list(dict.fromkeys(order)) == list(range(12)) and order == sorted(order)
    jumps = np.abs(np.diff(targets[1200:], axis=0)).max(axis=0)
    assert np.all(jumps > 0.1), "every joint makes a step of its own"


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


STICK, TURN_STICK, BUTTON, AT_START = 1, 0, 1, 0x80


def event(value: int, kind: int, number: int) -> bytes:
    """Of a gamepad: time [ms], value, type, number."""
    return struct.pack("<IhBB", 0, value, kind, number)


@pytest.fixture
def steered() -> Iterator[tuple[Pilot, Callable[[bytes], int], Callable[[bytes], int], Callable[[], None]]]:
    """A pilot who stands, what types for him, what pushes his stick, and what takes his keyboard away."""
    keys, typed = os.pipe()
    stick, pushed = os.pipe()
    gone = []

    def hang_up() -> None:
        os.close(typed)
        gone.append(typed)

    yield (
        Pilot(keys, stick, GAIT, (0.0, 0.0)),
        partial(os.write, typed),
        partial(os.write, pushed),
        hang_up,
    )
    for file in {keys, typed, stick, pushed} - set(gone):
        os.close(file)


def test_keys_change_speed_and_turn_by_tenths_and_space_stands_still(steered):
    pilot, type_in, _, _ = steered
    assert pilot.command() == (0.0, 0.0)
    type_in(b"www")
    assert pilot.command() == pytest.approx((0.15, 0.0))
    type_in(b"\x1b[A\x1b[Dd\x1b[Da")
    assert pilot.command() == pytest.approx((0.2, 0.12)), "arrows are letters; left is positive"
    type_in(b"s\x1b[B\x1b[Cx")
    assert pilot.command() == pytest.approx((0.1, 0.06))
    type_in(b" ")
    assert pilot.command() == (0.0, 0.0)
    assert pilot.command() == (0.0, 0.0), "nobody typed: as before"


def test_keys_do_not_leave_what_the_robot_is_built_for(steered):
    pilot, type_in, _, _ = steered
    for keys, command in (
        (b"w" * 40, (0.5, 0.0)), (b"w" * 40 + b"a" * 40, (0.3, 0.6)),
        (b"s" * 40 + b"d" * 40, (-0.2, -0.6)), (b"w", (-0.15, -0.6)),
    ):  # fmt: skip
        type_in(keys)
        assert pilot.command() == pytest.approx(command)


def test_the_stick_gives_its_share_of_the_whole_range_but_less_speed_in_turns(steered):
    pilot, _, push, _ = steered
    push(event(-16384, 2 | AT_START, STICK))
    assert pilot.command() == (0.0, 0.0), "an event at the start says where the stick is, nobody pushed it"
    for stick, turn, command in (
        (-32767, 0, (0.5, 0.0)), (-32767, 32767, (0.3, -0.6)), (-32767, -16384, (0.4, 0.3)),
        (-16384, 32767, (0.25, -0.6)), (32767, -16384, (-0.2, 0.3)), (0, 0, (0.0, 0.0)),
    ):  # fmt: skip
        push(event(stick, 2, STICK) + event(turn, 2, TURN_STICK) + event(9999, 2, 5))
        assert pilot.command() == pytest.approx(command, abs=1e-4)


def test_q_a_button_and_a_lost_terminal_stop(steered):
    pilot, type_in, push, hang_up = steered
    push(event(0, 1, BUTTON))
    assert pilot.command() == (0.0, 0.0), "a button let go"
    push(event(1, 1, BUTTON))
    assert pilot.command() is None, "a button"
    type_in(b"wq")
    assert pilot.command() is None
    hang_up()
    assert pilot.command() is None, "a lost terminal"


@given(keys=st.binary(min_size=1, max_size=60), stick=st.integers(-32767, 32767), turn=st.integers(-32767, 32767))
@settings(max_examples=60, deadline=None)
def test_whatever_is_typed_and_pushed_the_command_stays_within_bounds(keys: bytes, stick: int, turn: int):
    ends = os.pipe(), os.pipe()
    pilot = Pilot(ends[0][0], ends[1][0], GAIT, (0.3, 0.0))
    os.write(ends[0][1], keys.lower().replace(b"q", b"w"))
    os.write(ends[1][1], event(stick, 2, STICK) + event(turn, 2, TURN_STICK))
    command = pilot.command()
    for file in (*ends[0], *ends[1]):
        os.close(file)
    assert command is not None
    assert GAIT.forward[0] <= command[0] <= GAIT.forward[1] and abs(command[1]) <= GAIT.yaw_rate


def test_a_walker_walks_as_it_is_told_winds_down_and_begins_again(trot: Path):
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    still = Measurement(Telemetry(**zeros, pos=spec.NOMINAL_POSE, vel=np.zeros(12)), 0.0, 0.0)

    def hips(walker: Walker, steps: int = 300) -> np.ndarray:
        return np.array([walker(still)[1] for _ in range(steps)][100:])

    walker = Walker(PUPPER_V2, Policy.load(trot))
    assert np.ptp(hips(walker)) == pytest.approx(0.0, abs=1e-9), "nobody said walk"
    strides = []
    for walker.forward in (0.1, 0.3, 0.5):
        strides.append(np.ptp(hips(walker)))
    assert 0.1 < strides[0] < strides[1] < strides[2]
    stop = walker.winding_down(1.0)
    targets = []
    while (target := stop(still)) is not None:
        targets.append(target)
    assert len(targets) == 100 and walker.forward == walker.yaw_rate == 0.0
    fresh = Walker(PUPPER_V2, Policy.load(trot))
    for _ in range(2):
        fresh.warm_up(still)
    standing = fresh(still)
    np.testing.assert_allclose(targets[-1], standing, atol=1e-6)
    assert np.abs(standing - spec.NOMINAL_POSE).max() < 0.1


def test_gains_of_a_policy_near_the_robot_s_are_the_robot_s(trot: Path):
    policy = Policy.load(trot)
    assert (gains_for(PUPPER_V2, policy).kp, gains_for(PUPPER_V2, policy).kd) == (50.0, 5.0)
    assert (gains_for(PUPPER_V2, policy, 22.0, 2.2).kp, gains_for(PUPPER_V2, policy, 22.0, 2.2).kd) == (22.0, 2.2)


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
        give_up = time.monotonic() + 2.0
        while pupper.firmware._gains == (1.0, 1.0, 1.0) and time.monotonic() < give_up:
            robot.receive(time.monotonic() + 0.01)
        gains.append(pupper.firmware._gains)
    assert gains == 3 * [(50.0, 5.0, 2.0)]


def test_what_the_gyroscope_says_at_rest_is_taken_off_and_a_motion_is_not():
    """Two robots that stand still: the one with a constant error of its gyroscope keeps its heading all the same."""
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    still = Telemetry(**zeros, pos=spec.NOMINAL_POSE, vel=np.zeros(12))
    turning = replace(still, yaw_rate=0.03, roll_rate=-0.02)
    walkers = [Walker(PUPPER_V2, as_file_content(random_policy(0.05, seed=1))) for _ in range(3)]
    walkers[1].rates_at_rest = np.array([-0.02, 0.0, 0.03])
    for walker, seen in zip(walkers, (still, turning, turning), strict=True):
        walker.forward = 0.2
        for _ in range(50):
            walker(Measurement(seen, 0.0, 0.0))
    right, mended, wrong = (walker.observation for walker in walkers)
    np.testing.assert_allclose(mended, right, atol=1e-12)
    assert not np.allclose(wrong, right, atol=1e-3)


def test_the_first_look_tells_the_gyroscopes_error(virtual: Callable, host: Callable, monkeypatch: pytest.MonkeyPatch):
    pupper, off = virtual(), np.array([0.02, -0.01, 0.03])
    sense = pupper.body.live.state

    def with_error():
        state = sense()
        return replace(state, rates=state.rates + off)

    monkeypatch.setattr(pupper.body.live, "state", with_error)
    robot = host(pupper.port)
    np.testing.assert_allclose(first_look(robot, True).rates, off, atol=0.01)
    off[0] = 0.5
    time.sleep(0.1)
    assert not first_look(robot, True).rates.any(), "it is being turned"


@pytest.mark.parametrize(("given", "begins"), [(None, 0.0), (0.2, 0.2)])
def test_a_robot_that_somebody_steers_stands_until_it_is_told(given: float | None, begins: float, monkeypatch):
    """Without a terminal it walks; a gamepad alone is somebody."""
    read, write = os.pipe()
    monkeypatch.setattr("motorprior.hardware.pilot.sys.stdin", None)
    monkeypatch.setattr("motorprior.hardware.pilot.GAMEPAD", "/nowhere")
    with pilot(GAIT, given, 0.1) as alone:
        assert alone.command() == (ALONE if given is None else given, 0.1)
    monkeypatch.setattr("motorprior.hardware.pilot.os.open", lambda *_: read)
    with pilot(GAIT, given, 0.1) as steered:
        assert steered.command() == (begins, 0.1)
    os.close(write)
