"""Replay the commands of a real robot's log on a simulated robot, to compare joint angles."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.actuator.fleet import Fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog, gain_texts
from motorprior.logs.operations import drop_repeats, excited_joints, resample
from motorprior.robots.robot import Robot
from motorprior.signals import rms, runs_of_true
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

COMMAND_PERIOD = 0.002  # [s] grid on which commands are held; the rows of logs are 1.5-10 ms apart
FALLEN_TILT = 0.8  # [rad] roll or pitch of a fallen robot
FALLEN_TIME = 0.2  # [s] minimum duration of this tilt
# a log is classified as suspended if error suspended / error standing is below this
SUSPENDED_ERROR_RATIO = 0.7
# [s] before the first command, from rest at the first measured angles, see `initial_targets`
_SETTLING_TIME = 1.0
_FALLEN = POSTURES.index("fallen")

MotorsT = TypeVar("MotorsT", TrueMotors, IdealPd)
PostureName: TypeAlias = Literal["auto", "standing", "suspended"]


def logged_constants(log: MotorLog) -> frozenset[str]:
    """Fleet constants among the logged gains; none if those are in firmware units."""
    if log.logged_kp is None or log.gain_unit != PHYSICAL_GAINS:
        return frozenset()
    return frozenset({"kp"} if log.logged_kd is None else {"kp", "kd_over_kp"})


def motors_with_logged_gains(motors: MotorsT, log: MotorLog) -> MotorsT:
    """These motors, one per joint, with the logged gains; unchanged if the log has none in N·m/rad.

    If only kp is logged, kd = logged kp · kd/kp of the motors.
    """
    gains = log.gains
    if gains is None or not logged_constants(log):
        return motors
    kp, kd = gains
    return replace(motors, kp=kp, kd=kp * motors.kd / motors.kp if log.logged_kd is None else kd)


def with_posture(log: MotorLog, name: str) -> MotorLog:
    """The log with one posture; rows of a standing robot with the tilt of a fall are fallen."""
    codes = np.full(log.num_rows, POSTURES.index(name))
    if log.base_orientation is not None and name == "standing":
        for segment in log.segment_slices():
            time = log.time[segment]
            tilt = np.abs(log.base_orientation[segment]).max(axis=1)
            for first, after in runs_of_true(tilt > FALLEN_TILT):
                if time[after - 1] - time[first] >= FALLEN_TIME:
                    codes[segment][first:after] = _FALLEN
    return replace(log, posture=codes)


class Replayer:
    """Replays one log on many sets of motors. Use one per thread.

    A log without postures counts as standing. The rows of a segment after a fall are not compared.
    LogError for the joints of another robot, no excited joint, gains that change, and a segment
    with two postures or without posture.
    """

    def __init__(self, log: MotorLog, robot: Robot):
        if log.joint_names != robot.joint_names:
            problem = f"joints {list(log.joint_names)} are not those of {robot.name}"
            raise LogError(problem, where=log.source, remedy=f"needs {robot.joint_names}")
        gains = [part.gains for part in log.segments()] if logged_constants(log) else []
        if gains and np.ptp(np.array(gains), axis=0).any():
            remedy = "split it into a log per set of gains"
            raise LogError("its segments have different gains", where=log.source, remedy=remedy)
        # The rows without repeated measurements, to compare with, and the indices of the compared
        # joints
        self.log = drop_repeats(log)
        self.excited = excited_joints(log)
        if not self.excited.size:
            raise LogError(
                "no joint is excited", where=log.source, remedy="record with a moving command"
            )
        self._robot = robot
        self._world = cache(
            lambda physics_dt, suspended: World(robot, physics_dt, suspended, COMMAND_PERIOD)
        )
        self._grids, self._segments = (
            list(resample(log, COMMAND_PERIOD).segments()),
            list(self.log.segments()),
        )
        self._suspended = [_is_suspended(segment, robot) for segment in self._segments]
        # (rows,) mask
        self.compared = np.concatenate([_before_fall(segment) for segment in self._segments])

    def joint_pos(self, actuator: Actuator) -> np.ndarray:
        """(rows, joints) simulated angles [rad] at the times of the log, within ±2π if the simulation diverges.

        They are at the rotor's encoder for motors with a rotor, else at the joint.
        """
        segments = zip(self._grids, self._segments, self._suspended, strict=True)
        return np.concatenate([self._segment(actuator, *segment) for segment in segments])

    def error(self, joint_pos: np.ndarray) -> np.ndarray:
        """(rows compared, excited joints) simulated minus measured [rad]."""
        return (joint_pos - self.log.joint_pos)[self.compared][:, self.excited]

    def rmse(self, joint_pos: np.ndarray) -> np.ndarray:
        """(joints,) RMSE [rad], start included; NaN for joints without excitation."""
        found = np.full(self.log.num_joints, np.nan)
        found[self.excited] = rms(self.error(joint_pos), axis=0)
        return found

    def _segment(
        self, actuator: Actuator, grid: MotorLog, part: MotorLog, suspended: bool
    ) -> np.ndarray:
        rest = initial_targets(part.joint_pos[0], grid.position_target[0], self._robot)
        lead_in = np.tile(rest, (round(_SETTLING_TIME / COMMAND_PERIOD), 1))
        world = self._world(self._robot.physics_step(actuator.kind.max_step), suspended)
        recorded = replay(
            world, actuator, grid.position_target, part.joint_pos[0], lead_in, tolerate_fault=True
        )
        measured = np.clip(
            np.nan_to_num(recorded.measured_joint_pos, nan=np.inf), -2 * np.pi, 2 * np.pi
        )
        return np.stack([np.interp(part.time, grid.time, column) for column in measured.T], axis=1)


def initial_targets(joint_pos: np.ndarray, targets: np.ndarray, robot: Robot) -> np.ndarray:
    """(joints,) targets before a segment [rad]: the first ones, or a free robot's nominal pose if that is nearer.

    Some logs start in the nominal pose and jump to the first targets, others held the first targets
    for long. All angles are (joints,) [rad].
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
    if part.posture is None or robot.base == "fixed":
        return False
    postures = [POSTURES[code] for code in np.unique(part.posture[_before_fall(part)])]
    if not postures:
        raise LogError(
            "a segment starts with a fallen robot", where=part.source, remedy="exclude the segment"
        )
    if "standing" in postures and len(postures) > 1:
        remedy = "split it at the change of posture"
        raise LogError(f"a segment with the postures {postures}", where=part.source, remedy=remedy)
    return "standing" not in postures


def replayers_of(
    logs: Mapping[str, MotorLog],
    robot: Robot,
    fleet: Fleet,
    posture: PostureName,
    note: Callable[[str], None],
) -> dict[str, Replayer]:
    """Every log with its posture, ready to replay; notes state posture and logged gains.

    The posture ``auto`` is the logged one. If there is none, it is the one in which the fleet's
    central motor has the lower replay error by a margin, or standing. ConfigError for a posture of
    a robot with a fixed base.
    """
    if posture != "auto" and robot.base == "fixed":
        problem = f"posture {posture!r}, but the base of {robot.name!r} is fixed"
        raise ConfigError(problem, remedy="leave it out", argument="posture")
    center = fleet.center(robot.num_joints)
    found = {}
    for name, log in logs.items():
        if posture == "auto":
            posed, evidence = with_found_posture(log, robot, center)
        else:
            posed = with_posture(log, posture)
            evidence = f"{posture}, as given"
        found[name] = Replayer(posed, robot)
        excluded = int((~found[name].compared).sum())
        note(
            f"log {name}: {evidence}"
            + (f"; {excluded} rows after a fall are excluded" if excluded else "")
        )
        if gains := " and ".join(gain_texts(log)):
            used = "motors use these instead of the fleet's"
            unused = "in firmware units: motors use the fleet's gains"
            note(
                f"log {name}: logged gains {gains}"
                + (f": {used}" if logged_constants(log) else f", {unused}")
            )
    return found


def with_found_posture(log: MotorLog, robot: Robot, motors: TrueMotors) -> tuple[MotorLog, str]:
    """The log with its posture, see `replayers_of`, and the evidence; ``motors`` are similar to those of the log."""
    if log.posture is not None:
        return log, f"{' and '.join(POSTURES[code] for code in np.unique(log.posture))}, as logged"
    if robot.base == "fixed":
        return with_posture(log, "fixed"), "fixed base"
    both = {name: Replayer(with_posture(log, name), robot) for name in ("standing", "suspended")}
    both["suspended"].compared = both["standing"].compared  # the same rows, up to a fall
    actuator = motors_with_logged_gains(motors, log).actuator()
    errors = {
        name: float(np.nanmean(each.rmse(each.joint_pos(actuator)))) for name, each in both.items()
    }
    name = (
        "suspended"
        if errors["suspended"] < SUSPENDED_ERROR_RATIO * errors["standing"]
        else "standing"
    )
    texts = ", ".join(f"{1e3 * error:.1f} mrad {name}" for name, error in errors.items())
    return with_posture(log, name), f"{name}, from replay errors: {texts}"
