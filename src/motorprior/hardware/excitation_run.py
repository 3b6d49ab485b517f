"""Excite the motors of a robot that hangs or stands, and record their motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motorprior.hardware.control_loop import ControlLoop, Timing
from motorprior.hardware.motions import played
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Gains, StopRequest, look_and_confirm, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode

_STATUS_EVERY = 500


def excite(
    link: RobotLink,
    targets: np.ndarray,
    gains: Gains,
    stop: StopRequest,
    *,
    hung: bool,
    need_imu: bool,
    confirm: Callable[[], None] = lambda: None,
    status: Callable[[str], None] = lambda _: None,
    timing: Timing | None = None,
) -> Timing:
    """Check, arm, ramp to the nominal pose, send the targets (steps, joints) [rad], and release the motors.

    Args:
        link: idle; it has the recorder, and the limits that the gate keeps.
        targets: from `excitation_targets`.
        gains: to send.
        stop: ends it early.
        hung: the robot hangs in the air: it need not crouch.
        need_imu: refuse a robot whose IMU is not read.
        confirm: the arm step; raises if the user does not want to.
        status: gets a line every five seconds.
        timing: filled with the excitation's, also if a fault ends it.

    Raises:
        RobotFault: why it ended early; the robot is idle and the recording is kept.
    """
    look_and_confirm(link, confirm, need_imu)
    timing, done, period = timing or Timing(), 0, link.robot.control_dt

    def count(_: Measurement) -> None:
        nonlocal done
        done += 1
        if done % _STATUS_EVERY == 0:
            status(f"{done * period:6.1f} of {len(targets) * period:g} s recorded")

    def work(loop: ControlLoop) -> None:
        loop.play(played(targets), Mode.EXCITE, count, timing)

    run_armed(link, gains, stop, work, crouch=not hung)
    return timing
