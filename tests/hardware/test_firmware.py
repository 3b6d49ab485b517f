"""The virtual robot behaves as the firmware is known to."""

from itertools import pairwise

import numpy as np
import pytest

from motorprior.hardware.framing import command_frame, telemetry_reader
from motorprior.hardware.protocol import Command, Sizes, Telemetry
from motorprior.hardware.virtual.firmware import ERROR, HOLDING, HOMING, IDLE, POSITION, Firmware, FirmwareConfig
from motorprior.hardware.virtual.injected import CommandCutter, Fault, FaultySensors
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


def test_a_command_is_cut_out_of_whatever_chunks_it_came_in():
    frames = [command_frame(Command(pos=NOMINAL + 0.01 * n), SIZES) for n in range(20)]
    stream, cutter, rng = b"".join(frames), CommandCutter(), np.random.default_rng(0)
    cuts = [0, *sorted(rng.integers(0, len(stream), 30)), len(stream)]
    assert [piece for a, b in pairwise(cuts) for piece in cutter.cut(stream[a:b])] == frames


def test_faults_begin_at_their_time(still_body):
    faulty = FaultySensors([Fault("frozen", 1.0, 2), Fault("jumping", 2.0, 4)])
    truth = still_body.sense()
    assert np.array_equal(faulty(truth, 0.9).pos, truth.pos)
    faulty(truth, 1.0)
    still_body.pos = still_body.pos + 0.1
    later = still_body.sense()
    assert faulty(later, 1.5).pos[2] == truth.pos[2] and faulty(later, 1.5).pos[3] == later.pos[3]
    assert abs(faulty(later, 2.0).pos[4] - faulty(later, 2.01).pos[4]) == pytest.approx(1.6)
