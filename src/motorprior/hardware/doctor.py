"""Checks of a robot's telemetry, for the doctor and before a robot is armed. They send nothing."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import Sensors
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.robots.robot import Robot

# Per control period on the robot's clock, so that neither buffered frames nor a busy host have an influence; the rest
# may be lost.
_MIN_FRAMES = 0.8
_RANGE_SLACK = 0.1  # [rad] beyond the joint limits: the end stops are soft


@dataclass(frozen=True)
class Check:
    """A measured value, and what to do if it is not ``ok``."""

    name: str
    finding: str
    ok: bool
    remedy: str = ""


def require_ok(checks: Sequence[Check]) -> None:
    """Raise RobotFault for the first check that failed."""
    for check in checks:
        if not check.ok:
            raise RobotFault(check.name, check.finding, remedy=check.remedy)


def check_telemetry(link: RobotLink, seconds: float) -> list[Check]:
    """Check ``seconds`` [s] of telemetry; raises RobotFault if no frame comes."""
    started, before = time.monotonic(), link.stream.accepted
    ages, telemetry, max_age = [], list[Telemetry](), 0.0
    while time.monotonic() < started + seconds:
        link.receive(time.monotonic() + 0.005)
        if (latest := link.stream.latest) is not None:
            max_age = max(max_age, time.monotonic() - latest.sampled)
            ages.append(latest.arrival - latest.sampled)
            telemetry.append(latest.telemetry)
    if not telemetry:
        received = f"{len(link.text)} lines of text" if link.text else "no frame"
        remedy = "check power, cable and the firmware's version"
        raise RobotFault("stale telemetry", f"{received} in {seconds:g} s", remedy=remedy)
    damaged, stream = link.rejected + link.stream.impossible, link.stream
    return [
        frame_rate(link.robot, stream.accepted - before, telemetry),
        Check("damaged frames", f"{damaged}, {stream.repeated} repeated", damaged <= 0.01 * stream.accepted + 1,
              "use another cable or port"),
        Check("telemetry", f"{1e3 * np.median(ages):.1f} ms delay, {1e3 * max_age:.0f} ms maximum age",
              max_age < link.limits.telemetry_age, "close other programs, use another cable or port"),
        imu(telemetry[-1]),
        *joint_ranges(link.robot, telemetry),
        *_sensors(link, telemetry),
        Check("text", link.text[-1] if link.text else "none", not any("ERROR" in line for line in link.text),
              "switch the robot off and on with its legs free"),
    ]  # fmt: skip


def frame_rate(robot: Robot, frames: int, telemetry: Sequence[Telemetry]) -> Check:
    """Whether ``frames`` between the first and the last telemetry are enough for the control period."""
    seconds, needed = 1e-3 * (telemetry[-1].ts - telemetry[0].ts), 1.0 / robot.control_dt
    remedy = f"the policy needs {needed:.0f} per second: use another cable or port; PRINT_DELAY in the firmware's "
    remedy += "main.cpp is their period"
    enough = frames >= max(2.0, _MIN_FRAMES * needed * seconds)
    return Check("frames", f"{frames} in {seconds:.2f} s", enough, remedy)


def imu(telemetry: Telemetry) -> Check:
    """Whether the firmware reads the IMU."""
    finding = f"roll {telemetry.roll:+.3f} rad, pitch {telemetry.pitch:+.3f} rad"
    remedy = "flash a firmware that reads the IMU: without it a fall cannot be detected; or give --without-imu and "
    return Check("IMU", finding, telemetry.has_imu, remedy + "stay within reach of the robot")


def joint_ranges(robot: Robot, telemetry: Sequence[Telemetry]) -> list[Check]:
    """Whether the joints are within their limits."""
    checks, poses = [], np.array([one.pos for one in telemetry])
    for joint, angles in zip(robot.joints, poses.T, strict=True):
        low, high = angles.min(), angles.max()
        inside = joint.lower - _RANGE_SLACK <= low and high <= joint.upper + _RANGE_SLACK
        finding = f"{angles[-1]:+.3f} rad, was {low:+.3f} to {high:+.3f}; limits {joint.lower:+.2f} to "
        remedy = "switch the robot on with its legs free so that it finds its end stops"
        checks.append(Check(f"joint {joint.name}", f"{finding}{joint.upper:+.2f}", bool(inside), remedy))
    return checks


def _sensors(link: RobotLink, telemetry: Sequence[Telemetry]) -> list[Check]:
    """The faults that would end a motion, and the last readings."""
    sensors, last = Sensors(link.robot, link.limits), telemetry[-1]
    faults = {fault.kind: fault for one in telemetry for fault in sensors.faults(one, 1e-3 * one.ts)}
    readings = {
        "current": None if last.cur is None else f"up to {np.abs(last.cur).max():.2f} A",
        "temperature": None if last.temp is None else f"up to {last.temp.max():.0f} °C",
        "battery": None if last.bat is None else f"{last.bat:.1f} V",
        "frozen IMU": "no",
    }
    return [
        Check(kind, faults[kind].problem, False, faults[kind].remedy or "look for a blocked joint")
        if kind in faults
        else Check(kind, reading or "not sent", True)
        for kind, reading in readings.items()
    ]
