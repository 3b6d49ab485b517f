"""The virtual robot behaves like the firmware."""

import numpy as np
import pytest

from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.hardware.virtual_robot import (
    ERROR,
    HOLDING,
    HOMING,
    IDLE,
    POSITION,
    Drive,
    Firmware,
    FirmwareConfig,
    SensorReadings,
)
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

JOINTS = 12
NOMINAL = spec.JOINT_SIGNS * spec.NOMINAL_POSE


class StillBody:
    """Joints that follow their targets like a first-order low-pass of kd/kp; no ground, no weight."""

    def __init__(self):
        self.pos, self.vel, self.drive = NOMINAL, np.zeros(12), Drive(NOMINAL, np.zeros(12), np.zeros(12), 0.0)
        self.offset = self.extra_current = 0.0

    def advance(self, milliseconds: int, drive: Drive) -> None:
        self.drive, before = drive, self.pos
        rate = drive.kp / np.where(drive.kd > 0.0, drive.kd, 1.0)
        self.pos = before + (1.0 - np.exp(-1e-3 * milliseconds * rate)) * (drive.target - before)
        self.vel = (self.pos - before) / (1e-3 * max(1, milliseconds))

    def sense(self) -> SensorReadings:
        current = self.drive.current(self.pos, self.vel)
        attitude = np.full(3, 1e-3)
        return SensorReadings(self.pos + self.offset, self.vel, current + self.extra_current, attitude, np.zeros(3))


@pytest.fixture
def still_body() -> StillBody:
    return StillBody()


def started(body, **config) -> Firmware:
    return Firmware(PUPPER_V2, body, FirmwareConfig(**{"homes": False, **config}))


def received(firmware: Firmware, milliseconds: int) -> list[Telemetry | str]:
    return FrameReader(Telemetry, JOINTS).feed(firmware.advance(milliseconds))


def send(firmware: Firmware, **command) -> None:
    """Gains first, in a command of their own, as a host must."""
    pos = command.pop("pos", None)
    if command:
        firmware.receive(framed(Command(**command), JOINTS))
    if pos is not None:
        firmware.receive(framed(Command(pos=pos), JOINTS))


@pytest.mark.parametrize("period", [10, 5])
def test_telemetry_comes_at_its_rate_on_the_robot_s_own_clock(still_body, period: int):
    frames = [m for m in received(started(still_body, telemetry_period=period), 100) if isinstance(m, Telemetry)]
    assert [frame.ts for frame in frames] == list(range(period, 101, period))
    assert all(frame.cur is None for frame in frames)


def test_it_homes_by_itself_slowly_and_then_holds(still_body):
    still_body.pos = spec.JOINT_SIGNS * spec.CROUCH_POSE + 0.3
    firmware = started(still_body, homes=True)
    lines = [m for m in received(firmware, 150) if isinstance(m, str)]
    assert firmware.mode == HOMING and lines == ["LED on", "Homing"]
    send(firmware, pos=NOMINAL, kp=50.0, kd=5.0, max_current=7.0)
    assert firmware.mode == HOMING, "it takes no targets yet"
    assert still_body.drive.max_current == 6.0
    lines = [m for m in received(firmware, 200) if isinstance(m, str)]
    assert firmware.mode == HOLDING and lines == ["Homed"]
    received(firmware, 1000)
    np.testing.assert_allclose(still_body.pos, spec.JOINT_SIGNS * spec.CROUCH_POSE, atol=1e-3)


def test_the_current_law_with_the_gains_that_were_sent(still_body):
    firmware = started(still_body, with_currents=True)
    send(firmware, pos=NOMINAL + 0.02, kp=30.0, kd=0.5, max_current=2.0)
    (frame,) = (m for m in received(firmware, 10) if isinstance(m, Telemetry))
    assert frame.cur is not None
    np.testing.assert_allclose(frame.cur, 30.0 * (NOMINAL + 0.02 - frame.pos) - 0.5 * frame.vel, atol=1e-5)
    send(firmware, pos=NOMINAL + 3.0)
    (frame,) = (m for m in received(firmware, 10) if isinstance(m, Telemetry))
    assert frame.cur is not None and np.abs(frame.cur).max() == 2.0


def test_idle_takes_the_current_until_the_next_target(still_body):
    firmware = started(still_body)
    send(firmware, pos=NOMINAL)
    send(firmware, idle=True)
    received(firmware, 10)
    assert firmware.mode == IDLE and not still_body.drive.kp.any() and not still_body.drive.kd.any()
    send(firmware, pos=NOMINAL)
    assert firmware.mode == POSITION


@pytest.mark.parametrize("value", ["offset", "extra_current"])
def test_beyond_its_limits_it_removes_the_current_and_reports_every_millisecond(still_body, value: str):
    firmware = started(still_body)
    setattr(still_body, value, 11.0)
    received(firmware, 10)
    assert firmware.mode == ERROR
    assert received(firmware, 100).count("ERROR") >= 90
    assert not still_body.drive.kp.any()
    send(firmware, pos=NOMINAL)
    assert firmware.mode == ERROR, "until it is switched off"
