"""Virtual servo buses in simulated time, with their client, for tests."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from motorprior.commands.servo_bus import Bar, chain_of_one, open_virtual_bus
from motorprior.commands.virtual_robot import VirtualRobotSettings
from motorprior.hardware.buses.bus import ServoBus
from motorprior.hardware.buses.virtual_bus import VirtualBus
from motorprior.robots.servos import ServoChain
from motorprior.robots.so101.robot import SO101

BAR = Bar(0.1, 0.25)


@dataclass
class TestBus:
    """A virtual bus and its client."""

    __test__ = False  # not a test
    virtual: VirtualBus
    client: ServoBus
    chain: ServoChain

    @property
    def torque_limits(self) -> list[int]:
        """Values written to the torque limit of the first servo, without repetitions."""
        values = self.virtual.servos[0].history["torque_limit"]
        return [value for index, value in enumerate(values) if values[index - 1 : index] != [value]]

    @property
    def eeprom_writes(self) -> int:
        """Writes to the EEPROM of all servos."""
        return sum(servo.eeprom_writes for servo in self.virtual.servos)

    def write(self, frame: bytes) -> None:
        """Write a frame without answer to the port, as another process does."""
        port = os.open(self.virtual.port, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(port, frame)
            self.virtual.written()
        finally:
            os.close(port)


@contextmanager
def feetech_arm(seed: int = 0) -> Iterator[TestBus]:
    """An SO-101 with six Feetech STS3215."""
    pytest.importorskip("rustypot")
    chain = SO101.require_servos()
    with open_virtual_bus(chain, VirtualRobotSettings(seed=seed), SO101) as opened:
        assert isinstance(opened.clock, VirtualBus)
        yield TestBus(opened.clock, opened.bus, chain)


@contextmanager
def xl330_pendulum(seed: int = 0) -> Iterator[TestBus]:
    """A Dynamixel XL330-M288 with a pendulum."""
    pytest.importorskip("rustypot")
    chain = chain_of_one("XL330-M288", 7)
    with open_virtual_bus(chain, VirtualRobotSettings(seed=seed), None, BAR) as opened:
        assert isinstance(opened.clock, VirtualBus)
        yield TestBus(opened.clock, opened.bus, chain)
