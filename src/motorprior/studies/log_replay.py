"""Replay the commands of a real robot's log on a simulated robot, to compare joint angles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.bench.families import TrueMotors
from motorprior.exceptions import LogError
from motorprior.logs.doctor.excitation import excited_joints
from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog
from motorprior.logs.operations import drop_repeats, resample
from motorprior.logs.settings_text import gain_texts
from motorprior.robots.robot import Robot
from motorprior.signals import rms
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

COMMAND_PERIOD = 0.002  # [s] grid on which commands are held; the rows of logs are 1.5-10 ms apart
_SETTLING_TIME = 1.0  # [s] before the first command, from rest at the first measured angles, see `initial_targets`
_FALLEN = POSTURES.index("fallen")

Motors = TypeVar("Motors", TrueMotors, IdealPd)


def logged_constants(log: MotorLog) -> frozenset[str]:
    """Fleet constants among the logged gains; none if those are in firmware units."""
    if log.stated_kp is None or log.gain_unit != PHYSICAL_GAINS:
        return frozenset()
    return frozenset({"kp"} if log.stated_kd is None else {"kp", "kd_over_kp"})


def with_logged_gains(motors: Motors, log: MotorLog) -> Motors:
    """These motors, one per joint, with the logged gains; unchanged if the log has none in N·m/rad.

    If only kp is logged, kd = logged kp · kd/kp of the motors.
    """
    gains = log.gains
    if gains is None or not logged_constants(log):
        return motors
    kp, kd = gains
    return replace(motors, kp=kp, kd=kp * motors.kd / motors.kp if log.stated_kd is None else kd)


def logged_gains_note(log: MotorLog) -> str:
    """A note on the logged gains and their use in the simulation; empty if there are none."""
    gains = " and ".join(gain_texts(log))
    if not gains:
        return ""
    if not logged_constants(log):
        return f"logged gains {gains}, in firmware units: motors use the fleet's gains"
    return f"logged gains {gains}: motors use these instead of the fleet's"


@dataclass(frozen=True)
class LogReplay:
    """One log replayed on one set of motors.

    Attributes:
        joint_pos: (rows, joints) simulated angle [rad] at the times of the prepared log, at the rotor's encoder for
            motors with a rotor, else at the joint.
        rmse: (joints,) joint RMSE [rad], start included, up to a fall; NaN for joints without excitation.
    """

    joint_pos: np.ndarray
    rmse: np.ndarray


def prepare(log: MotorLog, robot: Robot, where: str) -> MotorLog:
    """Drop repeated measurements.

    Raises:
        LogError: not the joints of this robot, no excited joint, or changing gains.
    """
    if log.joint_names != robot.joint_names:
        problem = f"joints {list(log.joint_names)} are not those of {robot.name}"
        raise LogError(problem, where=where, remedy=f"needs {robot.joint_names}")
    if not excited_joints(log).size:
        raise LogError("no joint is excited", where=where, remedy="record with a moving command")
    gains = [part.gains for part in log.segments()] if logged_constants(log) else []
    if gains and np.ptp(np.array(gains), axis=0).any():
        raise LogError("its segments have different gains", where=where, remedy="split it into a log per set of gains")
    return drop_repeats(log)


class Replayer:
    """Replays one log on many sets of motors. Use one per thread.

    A log without postures counts as standing. The rows of a segment after a fall are not compared.

    Args:
        log: all rows, whose commands are replayed.
        robot: of the log.
        prepared: rows to compare with, see `prepare`.

    Attributes:
        compared: (rows,) mask of the compared rows of ``prepared``.
        excited: indices of the compared joints.
        prepared: rows to compare with.

    Raises:
        LogError: a segment with two postures, or one that starts with a fallen robot.
    """

    def __init__(self, log: MotorLog, robot: Robot, prepared: MotorLog):
        self._robot, self._grids = robot, list(resample(log, COMMAND_PERIOD).segments())
        self._segments = list(prepared.segments())
        self._suspended = [_is_suspended(segment, robot) for segment in self._segments]
        self._worlds: dict[tuple[float, bool], World] = {}
        self.compared = np.concatenate([_before_fall(segment) for segment in self._segments])
        self.excited, self.prepared = excited_joints(log), prepared

    def joint_pos(self, actuator: Actuator) -> np.ndarray:
        """(rows, joints) simulated angles [rad], within ±2π so that errors stay finite if the simulation diverges."""
        segments = zip(self._grids, self._segments, self._suspended, strict=True)
        return np.concatenate([self._segment(actuator, *segment) for segment in segments])

    def error(self, joint_pos: np.ndarray) -> np.ndarray:
        """(rows compared, excited joints) simulated minus measured [rad]."""
        return (joint_pos - self.prepared.joint_pos)[self.compared][:, self.excited]

    def run(self, actuator: Actuator) -> LogReplay:
        """The angles and their RMSE."""
        simulated = self.joint_pos(actuator)
        rmse = np.full(self.prepared.num_joints, np.nan)
        rmse[self.excited] = rms(self.error(simulated), axis=0)
        return LogReplay(simulated, rmse)

    def _segment(self, actuator: Actuator, grid: MotorLog, part: MotorLog, suspended: bool) -> np.ndarray:
        rest = initial_targets(part.joint_pos[0], grid.position_target[0], self._robot)
        lead_in = np.tile(rest, (round(_SETTLING_TIME / COMMAND_PERIOD), 1))
        world = self._world(self._robot.physics_step(actuator.kind.max_step), suspended)
        recorded = replay(world, actuator, grid.position_target, part.joint_pos[0], lead_in, tolerate_fault=True)
        measured = np.clip(np.nan_to_num(recorded.measured_joint_pos, nan=np.inf), -2 * np.pi, 2 * np.pi)
        return np.stack([np.interp(part.time, grid.time, column) for column in measured.T], axis=1)

    def _world(self, physics_dt: float, suspended: bool) -> World:
        if (physics_dt, suspended) not in self._worlds:
            self._worlds[physics_dt, suspended] = World(self._robot, physics_dt, suspended, COMMAND_PERIOD)
        return self._worlds[physics_dt, suspended]


def initial_targets(joint_pos: np.ndarray, targets: np.ndarray, robot: Robot) -> np.ndarray:
    """(joints,) targets before a segment [rad]: the first ones, or a free robot's nominal pose if that is nearer.

    Some logs start in the nominal pose and jump to the first targets, others held the first targets for long. All
    angles are (joints,) [rad].
    """
    pose = np.asarray(robot.nominal_pose)
    nominal = robot.base == "free" and rms(joint_pos - pose) <= rms(joint_pos - targets)
    return pose if nominal else targets


def _before_fall(part: MotorLog) -> np.ndarray:
    """(rows,) mask of the rows before the first fallen one of a segment."""
    if part.posture is None:
        return np.ones(part.num_rows, dtype=bool)
    return np.cumsum(part.posture == _FALLEN) == 0


def _is_suspended(part: MotorLog, robot: Robot) -> bool:
    """Whether the base of a free robot was suspended in this segment."""
    if part.posture is None or robot.base == "fixed":
        return False
    postures = [POSTURES[code] for code in np.unique(part.posture[_before_fall(part)])]
    if not postures:
        raise LogError("a segment starts with a fallen robot", where=part.source, remedy="exclude the segment")
    if "standing" in postures and len(postures) > 1:
        raise LogError(
            f"a segment with the postures {postures}", where=part.source, remedy="split it at the change of posture"
        )
    return "standing" not in postures
