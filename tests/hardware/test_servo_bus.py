"""Virtual servos of both makers, with rustypot as the client, in simulated time."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import ClassVar

import numpy as np
import pytest
from servo_bench import TestBus, feetech_arm, xl330_pendulum

from motorprior.exceptions import RobotFault
from motorprior.hardware.buses.bus import MonotonicClock, NoAnswer
from motorprior.hardware.buses.dynamixel import DYNAMIXEL_XL330

BUSES = [feetech_arm, xl330_pendulum]


@pytest.fixture
def opened() -> Iterator[Callable[[Callable], TestBus]]:
    with ExitStack() as stack:
        yield lambda make: stack.enter_context(make())


@pytest.mark.parametrize("make", BUSES)
def test_a_scan_states_what_the_servos_are(opened: Callable, make: Callable):
    bench = opened(make)
    infos = bench.client.scan([*bench.chain.ids, 99])

    assert [info.id for info in infos] == list(bench.chain.ids)
    for info, servo in zip(infos, bench.virtual.servos, strict=True):
        assert info.model.replace("-", "") == bench.chain.model.replace("-", "")
        assert info.gains[0] == servo.get("p_gain")
        assert info.voltage == pytest.approx(servo.supply)
        assert info.torque_limit == 1.0
        assert not info.torque_on


@pytest.mark.parametrize("make", BUSES)
def test_readings_have_signs_and_units_of_the_motion(opened: Callable, make: Callable):
    bench = opened(make)
    client = bench.client
    client.ids = bench.chain.ids
    start = client.read()
    client.write_goals(start.counts)
    client.set_torque(True)
    goal = start.counts.copy()
    goal[0] -= 200

    client.write_goals(goal)
    bench.virtual.wait_until(bench.virtual.clock() + 0.06)
    moving = client.read()

    assert moving.speed[0] < -0.5
    assert moving.load[0] < 0.0

    bench.virtual.wait_until(bench.virtual.clock() + 1.5)
    static = client.read()

    # within the sag of a proportional control under gravity
    assert abs(static.counts[0] - goal[0]) < 120
    assert abs(static.speed[0]) < 0.2
    assert bench.eeprom_writes == 0


@pytest.mark.parametrize("make", BUSES)
def test_a_negative_position_is_read_and_written(opened: Callable, make: Callable):
    bench = opened(make)
    servo = bench.virtual.servos[0]
    bench.client.ids = bench.chain.ids[:1]

    servo.stale = True
    servo.set("position", -300)
    bench.client.write_goals(np.array([-301.0]))

    assert bench.client.read().counts.tolist() == [-300]
    assert servo.get("goal_position") == -301


@pytest.mark.parametrize("make", BUSES)
def test_profile_and_torque_limit_are_in_the_ram(opened: Callable, make: Callable):
    bench = opened(make)
    client = bench.client
    client.ids = bench.chain.ids
    ones = np.ones(len(client.ids))

    client.set_torque_limit(0.4 * ones)
    client.set_profile(3.0 * ones, 20.0 * ones)

    for info in client.scan(client.ids):
        assert info.torque_limit == pytest.approx(0.4, abs=0.01)
        assert info.profile_speed == pytest.approx(3.0, abs=0.03)
        assert info.profile_acceleration == pytest.approx(20.0, abs=0.5)
    assert bench.eeprom_writes == 0


@pytest.mark.parametrize("make", BUSES)
def test_the_frame_of_the_watchdog_switches_all_torques_off_and_restores_the_registers(
    opened: Callable, make: Callable
):
    bench = opened(make)
    client = bench.client
    client.ids = bench.chain.ids
    before = client.scan(client.ids)
    ones = np.ones(len(client.ids))
    client.set_torque_limit(0.4 * ones)
    client.set_profile(3.0 * ones, 20.0 * ones)
    client.set_torque(True)
    client.set_bus_watchdog(0.5 * ones)
    assert all(info.torque_on for info in client.scan(client.ids))

    bench.write(client.release_frame(before))

    after = client.scan(client.ids)
    assert not any(info.torque_on for info in after)
    for name in ("torque_limit", "profile_speed", "profile_acceleration"):
        assert [getattr(info, name) for info in after] == [getattr(info, name) for info in before]
    if "bus_watchdog" in bench.virtual.servos[0].table.registers:
        assert bench.virtual.servos[0].get("bus_watchdog") == 0
    assert bench.eeprom_writes == 0


@pytest.mark.parametrize("make", BUSES)
@pytest.mark.parametrize("fault", ["lost", "damaged"])
def test_a_lost_or_damaged_answer_is_no_answer(opened: Callable, make: Callable, fault: str):
    bench = opened(make)
    bench.client.ids = bench.chain.ids
    bench.client.read()

    setattr(bench.virtual, fault, 1.0)
    with pytest.raises(NoAnswer):
        bench.client.read()

    setattr(bench.virtual, fault, 0.0)
    assert bench.client.read().counts.shape == (len(bench.chain.ids),)


@pytest.mark.parametrize("make", BUSES)
def test_a_condition_is_reported_and_switches_the_torque_off(opened: Callable, make: Callable):
    bench = opened(make)
    client = bench.client
    client.ids = bench.chain.ids
    client.set_torque(True)

    bench.virtual.servos[0].condition("overload", True)
    bits = client.read().conditions

    assert client.condition_names(int(bits[0])) == ("overload",)
    assert not bits[1:].any()
    assert not client.scan(client.ids[:1])[0].torque_on


class ServosAt57600:
    """A controller of rustypot at a port whose servos answer at the factory's baud rate only."""

    opened: ClassVar[list[int]] = []

    def __init__(self, port: str, baud_rate: int, timeout: float):
        self.opened.append(baud_rate)
        self.baud_rate = baud_rate

    def read_register(self, servo: int, name: str, tries: int) -> int:
        if self.baud_rate != 57_600 or servo != 7:
            raise RuntimeError("timeout")
        return 1200

    def set_fast_sync_read(self, on: bool) -> None:
        pass

    def close(self) -> None:
        pass


def test_servos_are_found_at_their_baud_rate(monkeypatch: pytest.MonkeyPatch):
    rustypot = pytest.importorskip("rustypot")
    for name in ("registers", "definition"):
        controller = rustypot.Xl330PyController
        monkeypatch.setattr(ServosAt57600, name, getattr(controller, name), raising=False)
    monkeypatch.setattr(ServosAt57600, "opened", [])
    monkeypatch.setattr(rustypot, "Xl330PyController", ServosAt57600)

    bus = DYNAMIXEL_XL330.open("/dev/ttyUSB0", MonotonicClock(), [6, 7])

    assert bus.baud_rate == 57_600
    assert ServosAt57600.opened == [1_000_000, 57_600]
    with pytest.raises(RobotFault, match=r"servo 3 at 1000000, 57600, .* bit/s"):
        DYNAMIXEL_XL330.open("/dev/ttyUSB0", MonotonicClock(), [3])
    with pytest.raises(RobotFault, match="servo 7 at 115200 bit/s"):
        DYNAMIXEL_XL330.open("/dev/ttyUSB0", MonotonicClock(), [7], 115_200)
