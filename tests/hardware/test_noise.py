"""Noise on the line, in simulated time: minutes of walking in seconds, and the same ones every time."""

from pathlib import Path

import pytest

from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.safety_gate import Gains
from motorprior.logs.readers.robot_run import Mode
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from noise import noisy_walk
from simulated_port import SimulatedPort, on_its_clock


def test_with_three_percent_lost_and_three_damaged_it_walks_on(trot: Path):
    """A gain or current limit that is repeated while it walks, and damaged, ended such walks within a minute or two."""
    walk = noisy_walk(trot, 0.03, 60.0, 0)
    assert walk.fault is None
    assert walk.seconds == pytest.approx(60.0, abs=0.1) and walk.path > 10.0


class _Wiretap(SimulatedPort):
    """Stores the keys that were sent."""

    def __init__(self) -> None:
        super().__init__(PUPPER_V2, 0)
        self.keys: list[str] = []

    def send(self, command):
        self.keys += [name for name, value in vars(command).items() if value is not None]
        return super().send(command)


def test_gains_are_sent_with_the_first_targets_only():
    port = _Wiretap()
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        link.receive(0.1)
        link.arm(Gains.of(PUPPER_V2.require_wire()))
        for _ in range(50):
            link.send(spec.NOMINAL_POSE, Mode.RAMP)
            link.receive(port.now + 0.01)
        sent = list(port.keys)
    assert sent == 3 * ["kp", "kd", "max_current", "pos"] + 47 * ["pos"]
