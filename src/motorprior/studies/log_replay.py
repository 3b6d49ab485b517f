"""Replay the commands of a real robot's log on a simulated robot, to compare joint angles."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.actuator.fleet import Fleet
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog, gain_texts
from motorprior.logs.operations import drop_repeats, excited_joints, resample
from motorprior.logs.read_log import LogFolder, read_log_folder
from motorprior.robots.robot import Robot
from motorprior.signals import rms, runs_of_true
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World

# grid on which commands are held [s]; the rows of logs are 1.5-10 ms apart
COMMAND_PERIOD = 0.002
FALLEN_TILT = 0.8  # roll or pitch of a fallen robot [rad]
FALLEN_TIME = 0.2  # minimum duration of this tilt [s]
# a log is classified as suspended if error suspended / error standing is below this
SUSPENDED_ERROR_RATIO = 0.7
# time before the first command [s], from rest at the first measured angles, see `initial_targets`
_SETTLING_TIME = 1.0
_FALLEN = POSTURES.index("fallen")

MotorsT = TypeVar("MotorsT", TrueMotors, IdealPd)
PostureName: TypeAlias = Literal["auto", "standing", "suspended"]


def read_logs(path: Path, robot: Robot) -> LogFolder:
    """A log, or all logs of a folder, in a format that needs no column map.

    LogError as `read_log_folder`.
    """
    try:
        return read_log_folder(path, robot)
    except LogError as error:
        if error.argument != "columns":
            raise
        remedy = "import the logs with `motorprior logs import --columns` (docs/your-motors.md)"
        remedy += ", and give the new files"
        raise LogError(error.problem, where=error.where, remedy=remedy) from error


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
    if log.logged_kd is None:
        kd = kp * motors.kd / motors.kp
    return replace(motors, kp=kp, kd=kd)


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
            problem = f"joints {list(log.joint_names)} are not the joints of {robot.name}"
            raise LogError(problem, where=log.source, remedy=f"needs {robot.joint_names}")
        if logged_constants(log):
            gains = np.array([segment.gains for segment in log.segments()])
            if np.ptp(gains, axis=0).any():
                remedy = "split it into a log per set of gains"
                problem = "its segments have different gains"
                raise LogError(problem, where=log.source, remedy=remedy)

        # measurements to compare with, without repeated ones, and indices of the compared joints
        self.log = drop_repeats(log)
        self.excited = excited_joints(log)
        if not self.excited.size:
            remedy = "record with a moving command"
            raise LogError("no joint is excited", where=log.source, remedy=remedy)

        self._robot = robot
        self._world = cache(
            lambda physics_dt, suspended: World(robot, physics_dt, suspended, COMMAND_PERIOD)
        )
        self._grids = list(resample(log, COMMAND_PERIOD).segments())
        self._segments = list(self.log.segments())
        self._suspended = [_is_suspended(segment, robot) for segment in self._segments]
        # (rows,) mask of the rows before a fall
        self.compared = np.concatenate([_before_fall(segment) for segment in self._segments])

    def joint_pos(self, actuator: Actuator) -> np.ndarray:
        """(rows, joints) simulated angles [rad] at the times of the log.

        They are at the rotor's encoder for motors with a rotor, otherwise at the joint, and within
        ±2π if the simulation diverges.
        """
        segments = zip(self._grids, self._segments, self._suspended, strict=True)
        return np.concatenate([self._replayed(actuator, *segment) for segment in segments])

    def error(self, joint_pos: np.ndarray) -> np.ndarray:
        """(rows compared, excited joints) replay error, simulated minus measured [rad]."""
        return (joint_pos - self.log.joint_pos)[self.compared][:, self.excited]

    def rmse(self, joint_pos: np.ndarray) -> np.ndarray:
        """(joints,) RMSE of the compared rows [rad]; NaN for joints without excitation."""
        rmse = np.full(self.log.num_joints, np.nan)
        rmse[self.excited] = rms(self.error(joint_pos), axis=0)
        return rmse

    def _replayed(
        self, actuator: Actuator, grid: MotorLog, segment: MotorLog, suspended: bool
    ) -> np.ndarray:
        """Simulated angles of a segment; ``grid`` has its commands on the simulation's grid."""
        start = segment.joint_pos[0]
        rest = initial_targets(start, grid.position_target[0], self._robot)
        lead_in = np.tile(rest, (round(_SETTLING_TIME / COMMAND_PERIOD), 1))
        world = self._world(self._robot.physics_step(actuator.kind.max_step), suspended)
        played = replay(world, actuator, grid.position_target, start, lead_in, tolerate_fault=True)

        angles = np.nan_to_num(played.measured_joint_pos, nan=np.inf)
        angles = np.clip(angles, -2 * np.pi, 2 * np.pi)
        columns = [np.interp(segment.time, grid.time, column) for column in angles.T]
        return np.stack(columns, axis=1)


def initial_targets(joint_pos: np.ndarray, targets: np.ndarray, robot: Robot) -> np.ndarray:
    """(joints,) targets before a segment [rad].

    They are the first targets, or a free robot's nominal pose if that is nearer to the measured
    angles ``joint_pos``. Some logs start in the nominal pose and jump to the first targets, others
    held the first targets for long. All angles are (joints,) [rad].
    """
    pose = np.asarray(robot.nominal_pose)
    starts_in_pose = rms(joint_pos - pose) <= rms(joint_pos - targets)
    return pose if robot.base == "free" and starts_in_pose else targets


def _before_fall(segment: MotorLog) -> np.ndarray:
    """(rows,) mask of the rows before the first fallen one of a segment."""
    if segment.posture is None:
        return np.ones(segment.num_rows, dtype=bool)
    return np.cumsum(segment.posture == _FALLEN) == 0


def _is_suspended(segment: MotorLog, robot: Robot) -> bool:
    if segment.posture is None or robot.base == "fixed":
        return False

    codes = np.unique(segment.posture[_before_fall(segment)])
    postures = [POSTURES[code] for code in codes]
    if not postures:
        problem = "a segment starts with a fallen robot"
        raise LogError(problem, where=segment.source, remedy="exclude the segment")
    if "standing" in postures and len(postures) > 1:
        problem = f"a segment with the postures {postures}"
        remedy = "split it at the change of posture"
        raise LogError(problem, where=segment.source, remedy=remedy)
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
    replayers = {}
    for name, log in logs.items():
        if posture == "auto":
            posed, evidence = with_inferred_posture(log, robot, center)
        else:
            posed = with_posture(log, posture)
            evidence = f"{posture}, as given"
        replayer = Replayer(posed, robot)
        replayers[name] = replayer

        excluded_rows = int((~replayer.compared).sum())
        if excluded_rows:
            evidence += f"; {excluded_rows} rows after a fall are excluded"
        note(f"log {name}: {evidence}")
        if gains := " and ".join(gain_texts(log)):
            use = ", in firmware units: motors use the fleet's gains"
            if logged_constants(log):
                use = ": motors use these instead of the fleet's"
            note(f"log {name}: logged gains {gains}{use}")
    return replayers


def with_inferred_posture(log: MotorLog, robot: Robot, motors: TrueMotors) -> tuple[MotorLog, str]:
    """The log with its posture, see `replayers_of`, and the evidence.

    ``motors`` are similar to the motors of the log.
    """
    if log.posture is not None:
        postures = [POSTURES[code] for code in np.unique(log.posture)]
        return log, f"{' and '.join(postures)}, as logged"
    if robot.base == "fixed":
        return with_posture(log, "fixed"), "fixed base"

    standing = Replayer(with_posture(log, "standing"), robot)
    suspended = Replayer(with_posture(log, "suspended"), robot)
    suspended.compared = standing.compared  # the same rows, up to a fall
    actuator = motors_with_logged_gains(motors, log).actuator()
    standing_error = float(np.nanmean(standing.rmse(standing.joint_pos(actuator))))
    suspended_error = float(np.nanmean(suspended.rmse(suspended.joint_pos(actuator))))

    is_suspended = suspended_error < SUSPENDED_ERROR_RATIO * standing_error
    name = "suspended" if is_suspended else "standing"
    errors = f"{1e3 * standing_error:.1f} mrad standing, {1e3 * suspended_error:.1f} mrad suspended"
    return with_posture(log, name), f"{name}, from replay errors: {errors}"
