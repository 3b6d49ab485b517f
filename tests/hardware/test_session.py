"""Checks of a robot before it is armed, and the doctor's."""

import os
import pty
import select
import tty

import pytest
from robot_faults import FaultyPort

from motorprior.exceptions import RobotFault
from motorprior.hardware.commands import run_doctor
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Check, check_before_arming, check_telemetry
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import on_its_clock


def check(port: FaultyPort, need_imu: bool = True) -> None:
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        check_before_arming(link, need_imu)
        assert not any(what == "target" for _, what in port.events), "nothing was sent"


def get_up(port: FaultyPort) -> None:
    port.firmware._target = spec.JOINT_SIGNS * spec.NOMINAL_POSE


FAULTS = {
    "IMU": lambda port: port.inject("blind"),
    "fall": lambda port: port.inject("tilted"),
    "stale telemetry": lambda port: port.inject("mute"),
    "battery": lambda port: port.inject("flat"),
    "moving": get_up,
}


@pytest.mark.parametrize("kind", FAULTS)
def test_a_robot_with_a_fault_is_not_armed(kind: str):
    port = FaultyPort(PUPPER_V2)
    FAULTS[kind](port)
    with pytest.raises(RobotFault) as caught:
        check(port)
    assert caught.value.kind == kind
    if kind == "IMU":
        check(port, need_imu=False)


@pytest.mark.parametrize(("period", "ok"), [(15, False), (10, True), (5, True)])
def test_telemetry_slower_than_the_control_period_is_rejected(period: int, ok: bool):
    port = FaultyPort(PUPPER_V2, period=period)
    if ok:
        check(port)
        return
    with pytest.raises(RobotFault, match="PRINT_DELAY"):
        check(port)


def diagnosed(port: FaultyPort) -> dict[str, Check]:
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as link:
        return {check.name: check for check in check_telemetry(link, link.receive(port.now + 1.0))}


def test_the_doctor_finds_faults():
    healthy = diagnosed(FaultyPort(PUPPER_V2, currents=True))
    assert all(check.ok for check in healthy.values()) and len(healthy) == 21
    port = FaultyPort(PUPPER_V2, corrupt=0.2)
    for fault in ("blind", "flat", "hot_motor"):
        port.inject(fault, 4)
    faulty = diagnosed(port)
    bad = {name for name, check in faulty.items() if not check.ok}
    assert bad == {"IMU", "damaged frames", "temperature", "battery"}
    assert all(check.remedy for check in faulty.values() if not check.ok)


@pytest.mark.real_time
def test_an_unknown_device_is_sent_nothing():
    master, slave = pty.openpty()
    tty.setraw(slave)
    with pytest.raises(RobotFault, match="stale telemetry"):
        run_doctor(PUPPER_V2, os.ttyname(slave), 1.0, True, print)
    assert not select.select([master], [], [], 0.1)[0]
    os.close(master)
    os.close(slave)
