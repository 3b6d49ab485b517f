"""The virtual robot behaves like the firmware."""

import numpy as np
import pytest

from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.hardware.virtual_robot import ERROR, IDLE, POSITION, Firmware, FirmwareConfig
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.wire import Drive, SensorReadings

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
        current = self.drive.current(self.pos, self.vel) + self.extra_current
        return SensorReadings(self.pos + self.offset, self.vel, current, np.full(3, 1e-3), np.zeros(3))


@pytest.fixture
def still_body() -> StillBody:
    return StillBody()


def started(body, **config) -> Firmware:
    return Firmware(PUPPER_V2, body, FirmwareConfig(**config))


def received(firmware: Firmware, milliseconds: int) -> tuple[list[Telemetry], list[str]]:
    messages = FrameReader(Telemetry, JOINTS).feed(firmware.advance(milliseconds))
    frames = [message for message in messages if isinstance(message, Telemetry)]
    return frames, [message for message in messages if isinstance(message, str)]


def send(firmware: Firmware, pos=None, **command) -> None:
    """Gains first, in a command of their own, as a host must."""
    for each in (command, {} if pos is None else {"pos": pos}):
        if each:
            firmware.receive(framed(Command(**each), JOINTS))


def test_it_holds_its_pose_and_sends_telemetry_in_its_own_time(still_body):
    frames, lines = received(started(still_body, telemetry_period=5), 150)
    assert [frame.ts for frame in frames] == list(range(5, 151, 5)) and frames[0].cur is None
    assert lines == ["LED on", "Holding"]
    np.testing.assert_array_equal(still_body.pos, NOMINAL)


def test_currents_follow_the_gains_that_were_sent_until_idle(still_body):
    firmware = started(still_body, with_currents=True)
    send(firmware, pos=NOMINAL + 0.02, kp=30.0, kd=0.5, max_current=2.0)
    ((frame,), _) = received(firmware, 10)
    assert frame.cur is not None and firmware.mode == POSITION
    np.testing.assert_allclose(frame.cur, 30.0 * (NOMINAL + 0.02 - frame.pos) - 0.5 * frame.vel, atol=1e-5)
    send(firmware, pos=NOMINAL + 3.0)
    ((frame,), _) = received(firmware, 10)
    assert frame.cur is not None and np.abs(frame.cur).max() == 2.0
    send(firmware, idle=True)
    received(firmware, 10)
    assert firmware.mode == IDLE and not still_body.drive.kp.any() and not still_body.drive.kd.any()


@pytest.mark.parametrize("value", ["offset", "extra_current"])
def test_beyond_its_limits_it_removes_the_current_and_reports_every_millisecond(still_body, value: str):
    firmware = started(still_body)
    setattr(still_body, value, 11.0)
    received(firmware, 10)
    assert firmware.mode == ERROR and received(firmware, 100)[1].count("ERROR") >= 90
    assert not still_body.drive.kp.any()
    send(firmware, pos=NOMINAL)
    assert firmware.mode == ERROR, "until it is switched off"
