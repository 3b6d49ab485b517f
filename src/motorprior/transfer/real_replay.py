"""Replay of the commands in a real robot's log on a simulated robot, to compare joint angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.exceptions import LogError
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.motor_log import POSTURES, MotorLog, stated_gain_rows
from motorprior.logs.resampling import drop_repeats, resample
from motorprior.robots.robot import Robot
from motorprior.signals import rms
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.stated_gains import stated_constants

COMMAND_PERIOD = 0.002
"""Period of the grid on which commands are held [s]; the rows of the logs are 1.5-10 ms apart."""
_LEAD_IN = 1.0
"""Time before the first command [s], from rest at the first measured angles, see `held_before`."""
_FALLEN = POSTURES.index("fallen")


@dataclass(frozen=True)
class LogReplay:
    """One log replayed on one set of motors.

    Attributes:
        joint_pos: (rows, joints) simulated angle [rad] at the times of the prepared log: that of the encoder on the
            rotor for physical motors and grey boxes, that of the joint for models without a rotor.
        rmse: (joints,) joint RMSE [rad], start included, up to a fall; NaN for joints that were not excited.
    """

    joint_pos: np.ndarray
    rmse: np.ndarray


def prepare(log: MotorLog, robot: Robot, where: str) -> MotorLog:
    """Drop repeated measurements; refuse a log of another robot.

    Raises:
        LogError: not the joints of this robot, no joint was excited, or the gains change.
    """
    if log.joint_names != robot.joint_names:
        raise LogError(
            f"joints {list(log.joint_names)} are not those of {robot.name}",
            where=where,
            remedy=f"needs {robot.joint_names}",
        )
    if not excited_joints(log).size:
        raise LogError("no joint is excited", where=where, remedy="record with a moving command")
    gains = stated_gain_rows(log) if stated_constants(log) else None
    if gains is not None and np.ptp(gains, axis=1).any():
        raise LogError("its segments state different gains", where=where, remedy="give each a log of its own")
    return drop_repeats(log)


class Replayer:
    """One log, ready to be replayed on many sets of motors. Use one per thread.

    A log without postures is taken as of a standing robot. A replay cannot follow a fall: rows of a segment from the
    first fallen one on are not compared.

    Args:
        log: with every row, whose commands are replayed.
        robot: that it is of.
        prepared: the rows to compare with, see `prepare`.

    Attributes:
        compared: (rows,) which rows of ``prepared`` are compared.
        excited: indices of the joints that are.
        prepared: the rows to compare with.

    Raises:
        LogError: a segment in two postures, or one that begins with a fallen robot.
    """

    def __init__(self, log: MotorLog, robot: Robot, prepared: MotorLog):
        self._robot, self._grids = robot, list(resample(log, COMMAND_PERIOD).segments())
        self._parts = list(prepared.segments())
        self._hung = [_is_held(part, robot) for part in self._parts]
        self._worlds: dict[tuple[float, bool], World] = {}
        self.compared = np.concatenate([_before_a_fall(part) for part in self._parts])
        self.excited, self.prepared = excited_joints(log), prepared

    def joint_pos(self, actuator: Actuator) -> np.ndarray:
        """(rows, joints) simulated angles [rad], within ±2π so that errors stay finite if the simulation diverges."""
        segments = zip(self._grids, self._parts, self._hung, strict=True)
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

    def _segment(self, actuator: Actuator, grid: MotorLog, part: MotorLog, hung: bool) -> np.ndarray:
        rest = held_before(part.joint_pos[0], grid.position_target[0], self._robot)
        lead_in = np.tile(rest, (round(_LEAD_IN / COMMAND_PERIOD), 1))
        world = self._world(self._robot.physics_step(actuator.kind.longest_step), hung)
        recorded = replay(world, actuator, grid.position_target, part.joint_pos[0], lead_in, tolerate_fault=True)
        measured = np.clip(np.nan_to_num(recorded.measured_joint_pos, nan=np.inf), -2 * np.pi, 2 * np.pi)
        return np.stack([np.interp(part.time, grid.time, column) for column in measured.T], axis=1)

    def _world(self, physics_dt: float, hung: bool) -> World:
        if (physics_dt, hung) not in self._worlds:
            config = WorldConfig.of(self._robot, physics_dt=physics_dt, control_dt=COMMAND_PERIOD, hung=hung)
            self._worlds[physics_dt, hung] = World(config)
        return self._worlds[physics_dt, hung]


def held_before(joint_pos: np.ndarray, targets: np.ndarray, robot: Robot) -> np.ndarray:
    """(joints,) what a robot held before a segment: a fixed one the first targets, a free one what it is nearer to.

    Some logs of real robots begin in the nominal pose, with a jump to the first targets, others where the robot held
    the first targets for long.

    Args:
        joint_pos: (joints,) first measured angles [rad].
        targets: (joints,) first position targets [rad].
        robot: that it is of.
    """
    pose = np.asarray(robot.nominal_pose)
    nominal = robot.base == "free" and rms(joint_pos - pose) <= rms(joint_pos - targets)
    return pose if nominal else targets


def _before_a_fall(part: MotorLog) -> np.ndarray:
    """(rows,) whether a row comes before the first fallen one of its segment."""
    if part.posture is None:
        return np.ones(part.num_rows, dtype=bool)
    return np.cumsum(part.posture == _FALLEN) == 0


def _is_held(part: MotorLog, robot: Robot) -> bool:
    """Whether the base of a free robot was held in this segment."""
    if part.posture is None or robot.base == "fixed":
        return False
    seen = [POSTURES[code] for code in np.unique(part.posture[_before_a_fall(part)])]
    if not seen:
        raise LogError("it begins with a fallen robot", where=part.source, remedy="leave the segment out")
    if "standing" in seen and len(seen) > 1:
        raise LogError(f"a segment in the postures {seen}", where=part.source, remedy="give each its own segment")
    return "standing" not in seen
