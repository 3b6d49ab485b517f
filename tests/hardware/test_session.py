"""A robot is looked at before it is armed; pilots steer, doctors judge, excitations stay in bounds."""

import os
import pty
import select
import struct
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
from motorprior.exceptions import RobotFault
from motorprior.hardware.commands import run_doctor
from motorprior.hardware.deploy import gains_for
from motorprior.hardware.doctor import examine
from motorprior.hardware.excitations import excitation_targets, joints_of
from motorprior.hardware.motions import Walker, ramp
from motorprior.hardware.pilot import Pilot
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.session import first_look
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.virtual.firmware import FirmwareConfig
from motorprior.hardware.virtual.virtual_robot import VirtualRobot, in_thread
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.virtual.twin_body import TwinBody, draw_motors
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

GAIT = PUPPER_V2.require_legs()


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


def test_the_doctor_finds_what_is_wrong(virtual: Callable, host: Callable):
    healthy, sick = virtual(currents=True), virtual(imu=False, corrupt=0.2)
    well = {one.check: one for one in examine(host(healthy.port), 1.0)}
    assert all(one.well for one in well.values()), well
    assert "not sent" not in well["currents"].finding and len(well) == 17
    ill = {one.check: one for one in examine(host(sick.port), 1.0)}
    assert not ill["IMU"].well and not ill["frames"].well
    assert ill["currents"].finding == "not sent (position only)" and healthy.received == sick.received == 0


def test_a_device_that_is_no_robot_is_sent_nothing():
    master, slave = pty.openpty()
    tty.setraw(slave)
    with pytest.raises(RobotFault, match="stale telemetry"):
        run_doctor(PUPPER_V2, os.ttyname(slave), 1.0, idle=True)
    assert not select.select([master], [], [], 0.1)[0]
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


def test_gains_of_a_policy_near_the_robot_s_are_the_robot_s(trot: Path):
    policy = Policy.load(trot)
    assert (gains_for(PUPPER_V2, policy).kp, gains_for(PUPPER_V2, policy).kd) == (50.0, 5.0)
    assert (gains_for(PUPPER_V2, policy, 22.0, 2.2).kp, gains_for(PUPPER_V2, policy, 22.0, 2.2).kd) == (22.0, 2.2)


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
