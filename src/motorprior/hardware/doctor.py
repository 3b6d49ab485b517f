"""What a port says, before anybody arms what is behind it. Sends nothing."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.health import FrozenImu, is_imu_alive
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot import Robot
from motorprior.robots.pupper_v2 import spec


@dataclass(frozen=True)
class Diagnosis:
    """One line of a doctor's report.

    Attributes:
        check: what was looked at.
        finding: the figure.
        well: whether it is as it should be.
        remedy: what to do otherwise.
    """

    check: str
    finding: str
    well: bool
    remedy: str = ""


def examine(robot: Robot, seconds: float) -> list[Diagnosis]:
    """Listen for some seconds.

    Args:
        robot: idle.
        seconds: how long [s].

    Raises:
        RobotFault: the port is gone, or nothing came that can be read.
    """
    started, before = time.monotonic(), robot.stream.accepted
    ages, heard, worst_age = [], [], 0.0
    while time.monotonic() < started + seconds:
        robot.listen(time.monotonic() + 0.005)
        latest = robot.stream.latest
        if latest is not None:
            worst_age = max(worst_age, time.monotonic() - latest.sampled)
            ages.append(latest.arrival - latest.sampled)
            heard.append(latest.telemetry)
    if not heard:
        text = f"{len(robot.text)} lines of text" if robot.text else "nothing that is a frame"
        raise RobotFault(
            "stale telemetry", f"{text} in {seconds:g} s", remedy="check power, cable and the firmware's version"
        )
    return [
        _frames(robot, (robot.stream.accepted - before) / seconds),
        Diagnosis("telemetry", f"{1e3 * np.median(ages):.1f} ms on the way, {1e3 * worst_age:.0f} ms old at most",
                  worst_age < spec.SAFETY.telemetry_age, "close other programs, use another cable or port"),
        _imu(heard),
        *_joints(np.array([telemetry.pos for telemetry in heard])),
        *_extras(robot),
        Diagnosis("text", robot.text[-1] if robot.text else "none", not any("ERROR" in line for line in robot.text),
                  "switch the robot off and on with its legs free"),
    ]  # fmt: skip


def _frames(robot: Robot, rate: float) -> Diagnosis:
    stream, damaged = robot.stream, robot.rejected + robot.stream.impossible
    return Diagnosis(
        "frames",
        f"{rate:.0f} per second, {damaged} damaged, {stream.repeated} repeated",
        rate > 0.9 / spec.CONTROL_DT and damaged <= 0.01 * stream.accepted + 1,
        f"the policy needs {1 / spec.CONTROL_DT:.0f} per second; use another cable or port",
    )


def _imu(heard: list[Telemetry]) -> Diagnosis:
    """Alive, and not the same for longer than a walk would allow."""
    frozen, last = FrozenImu(spec.SAFETY), heard[-1]
    finding = f"roll {last.roll:+.3f} rad, pitch {last.pitch:+.3f} rad"
    try:
        for telemetry in heard:
            frozen.check(telemetry, 1e-3 * telemetry.ts)
    except RobotFault as fault:
        return Diagnosis("IMU", f"{finding}; {fault.problem}", False, fault.remedy or "")
    remedy = "flash a firmware that reads the IMU; without it a fall cannot be seen"
    return Diagnosis("IMU", finding, is_imu_alive(last), remedy)


def _joints(poses: np.ndarray) -> list[Diagnosis]:
    """One line per joint: where it is, where it was, and its range."""
    found = []
    for joint, name in enumerate(spec.JOINT_NAMES):
        low, high = poses[:, joint].min(), poses[:, joint].max()
        inside = spec.JOINT_LOWER[joint] - 0.1 <= low and high <= spec.JOINT_UPPER[joint] + 0.1
        span = f"{spec.JOINT_LOWER[joint]:+.2f} to {spec.JOINT_UPPER[joint]:+.2f}"
        finding = f"{poses[-1, joint]:+.3f} rad, was {low:+.3f} to {high:+.3f} of {span}"
        remedy = "switch the robot on with its legs free so that it finds its end stops"
        found.append(Diagnosis(f"joint {name}", finding, bool(inside), remedy))
    return found


def _extras(robot: Robot) -> list[Diagnosis]:
    assert robot.stream.latest is not None
    telemetry, limits = robot.stream.latest.telemetry, spec.SAFETY
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
