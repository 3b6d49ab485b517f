"""Diagnosis of a robot at a port, before it is armed. Sends nothing."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import FrozenImu, is_imu_alive
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.robots.robot import Robot
from motorprior.robots.wire import SafetyLimits


@dataclass(frozen=True)
class Diagnosis:
    """One line of a doctor's report.

    Attributes:
        check: name of the check.
        finding: the measured value.
        well: whether the check passed.
        remedy: what to do if it did not.
    """

    check: str
    finding: str
    well: bool
    remedy: str = ""


def examine(link: RobotLink, seconds: float) -> list[Diagnosis]:
    """Check the telemetry of some seconds.

    Args:
        link: idle.
        seconds: how long [s].

    Raises:
        RobotFault: the port is gone, or nothing came that can be read.
    """
    started, before = time.monotonic(), link.stream.accepted
    ages, heard, worst_age = [], [], 0.0
    while time.monotonic() < started + seconds:
        link.receive(time.monotonic() + 0.005)
        latest = link.stream.latest
        if latest is not None:
            worst_age = max(worst_age, time.monotonic() - latest.sampled)
            ages.append(latest.arrival - latest.sampled)
            heard.append(latest.telemetry)
    if not heard:
        text = f"{len(link.text)} lines of text" if link.text else "nothing that is a frame"
        raise RobotFault(
            "stale telemetry", f"{text} in {seconds:g} s", remedy="check power, cable and the firmware's version"
        )
    return [
        _frames(link, (link.stream.accepted - before) / seconds),
        Diagnosis("telemetry", f"{1e3 * np.median(ages):.1f} ms on the way, {1e3 * worst_age:.0f} ms old at most",
                  worst_age < link.limits.telemetry_age, "close other programs, use another cable or port"),
        _imu(heard, link.limits),
        *_joints(link.robot, np.array([telemetry.pos for telemetry in heard])),
        *_extras(link),
        Diagnosis("text", link.text[-1] if link.text else "none", not any("ERROR" in line for line in link.text),
                  "switch the robot off and on with its legs free"),
    ]  # fmt: skip


def _frames(link: RobotLink, rate: float) -> Diagnosis:
    stream, damaged, wanted = link.stream, link.rejected + link.stream.impossible, 1.0 / link.robot.control_dt
    return Diagnosis(
        "frames",
        f"{rate:.0f} per second, {damaged} damaged, {stream.repeated} repeated",
        rate > 0.9 * wanted and damaged <= 0.01 * stream.accepted + 1,
        f"the policy needs {wanted:.0f} per second; use another cable or port",
    )


def _imu(heard: list[Telemetry], limits: SafetyLimits) -> Diagnosis:
    """Alive, and not the same for longer than a walk would allow."""
    frozen, last = FrozenImu(limits), heard[-1]
    finding = f"roll {last.roll:+.3f} rad, pitch {last.pitch:+.3f} rad"
    try:
        for telemetry in heard:
            frozen.check(telemetry, 1e-3 * telemetry.ts)
    except RobotFault as fault:
        return Diagnosis("IMU", f"{finding}; {fault.problem}", False, fault.remedy or "")
    remedy = "flash a firmware that reads the IMU; without it a fall cannot be detected"
    return Diagnosis("IMU", finding, is_imu_alive(last), remedy)


def _joints(robot: Robot, poses: np.ndarray) -> list[Diagnosis]:
    """One line per joint: where it is, where it was, and its range."""
    found = []
    for joint, place in zip(robot.joints, poses.T, strict=True):
        low, high = place.min(), place.max()
        inside = joint.lower - 0.1 <= low and high <= joint.upper + 0.1
        span = f"{joint.lower:+.2f} to {joint.upper:+.2f}"
        finding = f"{place[-1]:+.3f} rad, was {low:+.3f} to {high:+.3f} of {span}"
        remedy = "switch the robot on with its legs free so that it finds its end stops"
        found.append(Diagnosis(f"joint {joint.name}", finding, bool(inside), remedy))
    return found


def _extras(link: RobotLink) -> list[Diagnosis]:
    assert link.stream.latest is not None
    telemetry, limits = link.stream.latest.telemetry, link.limits
    found = []
    if telemetry.cur is None:
        found.append(Diagnosis("currents", "not sent (position only)", True))
    else:
        most = float(np.abs(telemetry.cur).max())
        found.append(
            Diagnosis("currents", f"up to {most:.2f} A", most < limits.measured_current, "something is blocked")
        )
    if telemetry.temp is not None:
        hottest = float(telemetry.temp.max())
        found.append(
            Diagnosis("temperature", f"up to {hottest:.0f} °C", hottest < limits.temperature, "let it cool down")
        )
    if telemetry.bat is not None:
        found.append(Diagnosis("battery", f"{telemetry.bat:.1f} V", telemetry.bat > limits.battery, "charge it"))
    return found
