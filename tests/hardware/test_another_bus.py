"""Another bus is one class and an entry of the registry: the command records its motors."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from motorprior.commands.record import Record, run_record
from motorprior.hardware.buses import registry
from motorprior.hardware.buses.bus import Clock, Readings, ServoInfo
from motorprior.logs.load_log import load_log

pytestmark = pytest.mark.real_time


class QuickBus:
    """A bus whose motor follows its goals with a lag of 20 ms; its client is this class."""

    counts = 65536
    load_unit = "1 N·m"
    current_unit = "1 A"

    def __init__(self, clock: Clock, ids: Sequence[int]):
        self.ids = tuple(ids)
        self.events: list[str] = []
        self._clock = clock
        self._goal = np.full(len(ids), 1000.0)
        self._pos = self._goal.copy()
        self._time = clock.clock()

    def scan(self, ids: Sequence[int]) -> list[ServoInfo]:
        return [
            ServoInfo(
                id=servo, model="quick", firmware="1", voltage=24.0, temperature=30.0,
                min_voltage=10.0, max_voltage=44.0, max_temperature=80.0, gains=(50, 0, 1),
                profile_speed=0.0, profile_acceleration=0.0, dead_zone=0.0, torque_limit=1.0,
                position_limits=(0, 0), offset=0, return_delay=0.0, torque_on=False, conditions=(),
            )
            for servo in ids
        ]  # fmt: skip

    def read(self) -> Readings:
        begin = self._clock.clock()
        change = (self._goal - self._pos) * (1.0 - np.exp((self._time - begin) / 0.02))
        speed = change / max(1e-6, begin - self._time) * 2.0 * np.pi / self.counts
        self._pos = self._pos + change
        self._time = begin
        time.sleep(0.002)
        zeros = np.zeros(len(self.ids))
        return Readings(
            begin=begin, end=self._clock.clock(), counts=np.rint(self._pos), speed=speed,
            load=zeros, current=zeros, voltage=24.0 + zeros, temperature=30.0 + zeros,
            conditions=np.zeros(len(self.ids), int),
        )  # fmt: skip

    def write_goals(self, counts: np.ndarray) -> None:
        self._goal = counts

    def set_torque(self, on: bool) -> None:
        self.events.append("torque on" if on else "torque off")

    def set_torque_limit(self, share: np.ndarray) -> None:
        self.events.append(f"limit {share[0]:g}")

    def set_profile(self, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self.events.append("profile")

    def set_bus_watchdog(self, seconds: np.ndarray) -> None:
        pass

    def release_frame(self, infos: Sequence[ServoInfo]) -> bytes:
        return b"off"

    def condition_names(self, bits: int) -> tuple[str, ...]:
        return ()

    def close(self) -> None:
        self.events.append("closed")


class QuickFamily:
    """Opens the bus."""

    def __init__(self) -> None:
        self.buses: list[QuickBus] = []

    def open(
        self,
        port: str,
        clock: Clock,
        ids: Sequence[int],
        baud_rate: int | None = None,
        timeout: float = 0.03,
    ) -> QuickBus:
        self.buses.append(QuickBus(clock, ids))
        return self.buses[-1]


def test_the_command_records_motors_of_another_bus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    family = QuickFamily()
    monkeypatch.setitem(registry.SERVOS, "QUICK", registry.ServoKind(family, "Quick 1"))
    port = tmp_path / "port"
    port.touch()  # gets the frames of the watchdog

    out = tmp_path / "run"
    run_record(
        Record(port=str(port), motor="QUICK", bar="0.1m,0.2kg", seconds=4.0, yes=True, out=out)
    )

    (bus,) = family.buses
    assert bus.events[:2] == ["limit 0.4", "torque on"]
    assert bus.events[2] == "limit 1"
    assert "torque off" in bus.events[3:]
    assert bus.events[-1] == "closed"

    log = load_log(out / "run.servolog")
    assert log.motor == "Quick 1"
    assert log.duration == pytest.approx(4.0, abs=0.3)
    lag = log.position_target - log.joint_pos
    assert 0.0 < np.abs(lag).max() < 0.5
