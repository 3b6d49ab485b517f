"""The virtual robot behaves as the firmware is known to."""

import os
import time
from itertools import pairwise

import numpy as np
import pytest

from motorprior.hardware.framing import command_frame, telemetry_reader
from motorprior.hardware.protocol import Command, Sizes, Telemetry
from motorprior.hardware.virtual.firmware import ERROR, HOLDING, HOMING, IDLE, POSITION, Firmware, FirmwareConfig
from motorprior.hardware.virtual.injected import CommandCutter, Fault, FaultySensors, NoisyLine, parse_fault
from motorprior.hardware.virtual.virtual_robot import VirtualRobot
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

SIZES = Sizes.of(PUPPER_V2)
NOMINAL = spec.JOINT_SIGNS * spec.NOMINAL_POSE


def started(body, **config) -> Firmware:
    return Firmware(PUPPER_V2, body, FirmwareConfig(**{"homes": False, **config}))


def heard(firmware: Firmware, milliseconds: int) -> list[Telemetry | str]:
    return telemetry_reader(SIZES).feed(firmware.advance(milliseconds))


def tell(firmware: Firmware, **command) -> None:
    """Gains first, in a command of their own, as a host must."""
    pos = command.pop("pos", None)
    if command:
        firmware.receive(command_frame(Command(**command), SIZES))
    if pos is not None:
        firmware.receive(command_frame(Command(pos=pos), SIZES))


@pytest.mark.parametrize("period", [10, 5])
def test_telemetry_comes_at_its_rate_on_the_robot_s_own_clock(still_body, period: int):
    frames = [m for m in heard(started(still_body, telemetry_period=period), 100) if isinstance(m, Telemetry)]
    assert [frame.ts for frame in frames] == list(range(period, 101, period))
    assert all(frame.cur is None for frame in frames)


def test_what_is_sent_does_not_depend_on_how_time_is_cut(still_body):
    whole = started(still_body).advance(200)
    again = started(type(still_body)())
    assert b"".join(again.advance(n) for n in (3, 50, 1, 96, 50)) == whole


def test_it_homes_by_itself_slowly_and_then_holds(still_body):
    still_body.pos = spec.JOINT_SIGNS * spec.CROUCH_POSE + 0.3
    firmware, modes = started(still_body, homes=True), []
    lines = [m for m in heard(firmware, 150) if isinstance(m, str)]
    assert firmware.mode == HOMING and lines == ["LED on", "Homing"]
    tell(firmware, pos=NOMINAL, kp=50.0, kd=5.0, max_current=7.0)
    assert firmware.mode == HOMING, "it takes no targets yet"
    assert still_body.drive.max_current == 6.0
    lines = [m for m in heard(firmware, 200) if isinstance(m, str)]
    assert firmware.mode == HOLDING and lines == ["Homed"], modes
    heard(firmware, 1000)
    np.testing.assert_allclose(still_body.pos, spec.JOINT_SIGNS * spec.CROUCH_POSE, atol=1e-3)


def test_the_current_law_with_the_gains_that_were_sent(still_body):
    firmware = started(still_body, with_currents=True)
    tell(firmware, pos=NOMINAL + 0.02, kp=30.0, kd=0.5, max_current=2.0)
    (frame,) = (m for m in heard(firmware, 10) if isinstance(m, Telemetry))
    assert frame.cur is not None
    np.testing.assert_allclose(frame.cur, 30.0 * (NOMINAL + 0.02 - frame.pos) - 0.5 * frame.vel, atol=1e-5)
    tell(firmware, pos=NOMINAL + 3.0)
    (frame,) = (m for m in heard(firmware, 10) if isinstance(m, Telemetry))
    assert frame.cur is not None and np.abs(frame.cur).max() == 2.0
    tell(firmware, activations=np.eye(12)[4])
    heard(firmware, 10)
    assert np.flatnonzero(still_body.drive.kp).tolist() == [4]


def test_beside_a_position_no_other_key_is_read(still_body):
    firmware = started(still_body)
    firmware.receive(command_frame(Command(pos=NOMINAL, kp=1.0, idle=True), SIZES))
    heard(firmware, 10)
    assert firmware.mode == POSITION and np.all(still_body.drive.kp == spec.WIRE_KP)


def test_it_holds_its_last_target_for_ever_when_the_host_is_gone(still_body):
    firmware = started(still_body)
    tell(firmware, pos=NOMINAL, kp=50.0, kd=5.0, max_current=7.0)
    heard(firmware, 20_000)
    assert firmware.mode == POSITION and np.all(still_body.drive.kp == 50.0)


def test_idle_takes_the_current_until_the_next_target(still_body):
    firmware = started(still_body)
    tell(firmware, pos=NOMINAL)
    tell(firmware, idle=True)
    heard(firmware, 10)
    assert firmware.mode == IDLE and not still_body.drive.kp.any() and not still_body.drive.kd.any()
    tell(firmware, pos=NOMINAL)
    assert firmware.mode == POSITION


@pytest.mark.parametrize("sick", ["angle", "current"])
def test_beyond_its_bounds_it_gives_up_and_says_so_every_millisecond(still_body, sick: str):
    def sensed(sensors):
        if still_body.drive is not None:
            (sensors.pos if sick == "angle" else sensors.current)[3] = 11.0
        return sensors

    firmware = Firmware(PUPPER_V2, still_body, FirmwareConfig(homes=False), sensed=sensed)
    heard(firmware, 10)
    assert firmware.mode == ERROR
    assert heard(firmware, 100).count("ERROR") >= 90
    assert not still_body.drive.kp.any()
    tell(firmware, pos=NOMINAL)
    assert firmware.mode == ERROR, "until it is switched off"


def test_an_imu_that_is_not_read_is_all_zeros(still_body):
    for with_imu in (False, True):
        (frame,) = (m for m in heard(started(still_body, with_imu=with_imu), 10) if isinstance(m, Telemetry))
        assert (frame.roll != 0.0) == with_imu


def test_zero_makes_the_present_pose_zero(still_body):
    firmware = started(still_body)
    heard(firmware, 10)
    tell(firmware, zero=True)
    (frame,) = (m for m in heard(firmware, 10) if isinstance(m, Telemetry))
    np.testing.assert_allclose(frame.pos, 0.0, atol=1e-6)


def test_a_line_does_what_it_is_told():
    rng = np.random.default_rng
    drop, corrupt = NoisyLine(drop=0.3, rng=rng(0)), NoisyLine(corrupt=1.0, rng=rng(0))
    twice, slow = NoisyLine(duplicate=1.0, rng=rng(0)), NoisyLine(delay=0.5, rng=rng(0))
    for _ in range(1000):
        drop.put(b"x", 0.0)
        corrupt.put(b"abc", 0.0)
    assert 600 < len(drop.take(0.0)) < 800
    pieces = corrupt.take(0.0)
    assert len(pieces) == 3000 and all(
        sum(a != b for a, b in zip(pieces[n : n + 3], b"abc", strict=True)) == 1 for n in range(0, 3000, 3)
    )
    twice.put(b"ab", 0.0)
    slow.put(b"ab", 1.0)
    assert twice.take(0.0) == b"abab"
    assert (slow.due(), slow.take(1.49), slow.take(1.5), slow.take(9.0)) == (1.5, b"", b"ab", b"")


def test_a_command_is_cut_out_of_whatever_chunks_it_came_in():
    frames = [command_frame(Command(pos=NOMINAL + 0.01 * n), SIZES) for n in range(20)]
    stream, cutter, rng = b"".join(frames), CommandCutter(), np.random.default_rng(0)
    cuts = [0, *sorted(rng.integers(0, len(stream), 30)), len(stream)]
    assert [piece for a, b in pairwise(cuts) for piece in cutter.cut(stream[a:b])] == frames


def test_bytes_that_are_no_command_are_passed_on_as_they_are():
    frame, cutter = command_frame(Command(idle=True), SIZES), CommandCutter()
    junk = b"junk" + frame + b"\x00\x00" + frame + b"\r\n"
    pieces = cutter.cut(junk)
    assert b"".join(pieces) == junk and pieces.count(frame) == 2


def test_noise_hits_every_command_by_itself_even_if_two_were_read_at_once(still_body):
    """The share of --drop is one of commands, not of what a busy robot happens to read."""
    line = NoisyLine(drop=0.5, rng=np.random.default_rng(0))
    pupper = VirtualRobot(PUPPER_V2, still_body, FirmwareConfig(homes=False), to_robot=line)
    host, arrived = os.open(pupper.port, os.O_WRONLY | os.O_NOCTTY), []
    pupper.started = pupper._switched_on = time.monotonic()
    for _ in range(100):
        before = len(pupper.events)
        os.write(host, 2 * command_frame(Command(pos=NOMINAL), SIZES))
        while pupper.received < 2 * (len(arrived) + 1) * len(command_frame(Command(pos=NOMINAL), SIZES)):
            pupper._turn()
        arrived.append(sum(what == "target" for _, what in pupper.events[before:]))
    os.close(host)
    pupper._unplug()
    assert 70 < sum(arrived) < 130 and 25 < arrived.count(1) < 75


def test_faults_begin_at_their_time(still_body):
    faulty = FaultySensors([Fault("frozen", 1.0, 2), Fault("jumping", 2.0, 4)])
    truth = still_body.sense()
    assert np.array_equal(faulty(truth, 0.9).pos, truth.pos)
    faulty(truth, 1.0)
    still_body.pos = still_body.pos + 0.1
    later = still_body.sense()
    assert faulty(later, 1.5).pos[2] == truth.pos[2] and faulty(later, 1.5).pos[3] == later.pos[3]
    assert abs(faulty(later, 2.0).pos[4] - faulty(later, 2.01).pos[4]) == pytest.approx(1.6)


@pytest.mark.parametrize(
    "text", ["", "frozen", "frozen:tail@1", "mute:FR_hip@1", "melted@1", "mute@soon", "mute@1.2.3"]
)
def test_a_fault_that_makes_no_sense_is_refused(text: str):
    from motorprior.exceptions import ConfigError

    with pytest.raises(ConfigError, match=r"^fault "):
        parse_fault(PUPPER_V2, text)


def test_a_fault_is_read():
    assert parse_fault(PUPPER_V2, "dead:RL_knee@2.5") == Fault("dead", 2.5, 11)
    assert parse_fault(PUPPER_V2, "mute@3") == Fault("mute", 3.0)
