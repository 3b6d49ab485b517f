"""Checks of a robot's telemetry before it is armed. Sends nothing."""

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
class Check:
    """One line of the doctor's report."""

    name: str
    finding: str  # the measured value
    ok: bool
    remedy: str = ""  # what to do if the check failed


def check_telemetry(link: RobotLink, seconds: float) -> list[Check]:
    """Check ``seconds`` [s] of telemetry; raises RobotFault if no frame comes."""
    started, before = time.monotonic(), link.stream.accepted
    ages, telemetry, max_age = [], [], 0.0
    while time.monotonic() < started + seconds:
        link.receive(time.monotonic() + 0.005)
        latest = link.stream.latest
        if latest is not None:
            max_age = max(max_age, time.monotonic() - latest.sampled)
            ages.append(latest.arrival - latest.sampled)
            telemetry.append(latest.telemetry)
    if not telemetry:
        received = f"{len(link.text)} lines of text" if link.text else "no frame"
        remedy = "check power, cable and the firmware's version"
        raise RobotFault("stale telemetry", f"{received} in {seconds:g} s", remedy=remedy)
    return [
        _frames(link, (link.stream.accepted - before) / seconds),
        Check("telemetry", f"{1e3 * np.median(ages):.1f} ms delay, {1e3 * max_age:.0f} ms maximum age",
              max_age < link.limits.telemetry_age, "close other programs, use another cable or port"),
        _imu(telemetry, link.limits),
        *_joints(link.robot, np.array([one.pos for one in telemetry])),
        *_electrical(telemetry[-1], link.limits),
        Check("text", link.text[-1] if link.text else "none", not any("ERROR" in line for line in link.text),
              "switch the robot off and on with its legs free"),
    ]  # fmt: skip


def _frames(link: RobotLink, rate: float) -> Check:
    stream, damaged, needed = link.stream, link.rejected + link.stream.impossible, 1.0 / link.robot.control_dt
    finding = f"{rate:.0f} per second, {damaged} damaged, {stream.repeated} repeated"
    ok = rate > 0.9 * needed and damaged <= 0.01 * stream.accepted + 1
    return Check("frames", finding, ok, f"the policy needs {needed:.0f} per second; use another cable or port")


def _imu(telemetry: list[Telemetry], limits: SafetyLimits) -> Check:
    frozen, last = FrozenImu(limits), telemetry[-1]
    finding = f"roll {last.roll:+.3f} rad, pitch {last.pitch:+.3f} rad"
    try:
        for one in telemetry:
            frozen.check(one, 1e-3 * one.ts)
    except RobotFault as fault:
        return Check("IMU", f"{finding}; {fault.problem}", False, fault.remedy or "")
    remedy = "flash a firmware that reads the IMU; without it a fall cannot be detected"
    return Check("IMU", finding, is_imu_alive(last), remedy)


def _joints(robot: Robot, poses: np.ndarray) -> list[Check]:
    checks = []
    for joint, angles in zip(robot.joints, poses.T, strict=True):
        low, high = angles.min(), angles.max()
        inside = joint.lower - 0.1 <= low and high <= joint.upper + 0.1
        limits = f"{joint.lower:+.2f} to {joint.upper:+.2f}"
        finding = f"{angles[-1]:+.3f} rad, was {low:+.3f} to {high:+.3f}; limits {limits}"
        remedy = "switch the robot on with its legs free so that it finds its end stops"
        checks.append(Check(f"joint {joint.name}", finding, bool(inside), remedy))
    return checks


def _electrical(telemetry: Telemetry, limits: SafetyLimits) -> list[Check]:
    checks = [Check("currents", "not sent", True)]
    if telemetry.cur is not None:
        current = float(np.abs(telemetry.cur).max())
        ok = current < limits.measured_current
        checks = [Check("currents", f"up to {current:.2f} A", ok, "look for a blocked joint")]
    if telemetry.temp is not None:
        hottest = float(telemetry.temp.max())
        checks.append(Check("temperature", f"up to {hottest:.0f} °C", hottest < limits.temperature, "let it cool down"))
    if telemetry.bat is not None:
        checks.append(Check("battery", f"{telemetry.bat:.1f} V", telemetry.bat > limits.battery, "charge it"))
    return checks
