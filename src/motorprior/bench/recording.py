"""Bench recordings: motors of a fleet on the virtual dynamometer, as one motor log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.actuator.fleet import Fleet
from motorprior.bench.dynamometer import BENCH, Response, Trial, run
from motorprior.exceptions import ConfigError
from motorprior.excitation.hand_made import zero_order_hold
from motorprior.excitation.registry import excitation_of
from motorprior.logs.bench_names import bench_names
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

# (low, high) load inertia of the robot for which the schedules are written [kg·m²]
REFERENCE_LOAD = (1e-4, 3e-2)
# tags of random streams
MOTORS_STREAM = 11
EXCITATION_STREAM = 13
INSTRUMENTS_STREAM = 47
MAX_DEVIATION = 1.5  # position error [rad] above which an external torque is halved
MAX_HALVINGS = 4
MAX_SPEED = 1e3  # joint speed [rad/s] above which a simulation has diverged


@dataclass(frozen=True)
class BenchSchedule:
    """Excitations and loads of a bench."""

    period: float  # sample period of the log [s]
    segment_steps: int  # samples per contiguous recording
    load_inertia: tuple[float, float]  # (low, high) of the log-uniform load inertia [kg·m²]
    excitations: tuple[str, ...]  # names or files, see `excitation_of`, cycled over the segments
    # number of samples for which a target is held, in the segments with held targets
    hold_steps: int
    torque_factor: float = 1.0  # factor on the external torques [-]

    def for_robot(self, robot: Robot) -> "BenchSchedule":
        """The schedule scaled to ``robot``.

        Unscaled it is for REFERENCE_LOAD and a reference torque of 1 N·m.
        """
        low, high = self.load_inertia
        robot_low, robot_high = robot.load_inertia
        reference_low, reference_high = REFERENCE_LOAD
        return replace(
            self,
            load_inertia=(robot_low / reference_low * low, robot_high / reference_high * high),
            torque_factor=robot.reference_torque,
        )


# The loads range from a bare shank to a standing robot. Half of the targets are held at 100 Hz.
_ROLLOUT = BenchSchedule(
    period=0.002,
    segment_steps=1000,
    load_inertia=(1e-4, 3e-2),
    excitations=("sine", "steps", "gait", "impacts", "creep"),
    hold_steps=5,
)
BENCH_SCHEDULES = {
    "paper": BenchSchedule(
        period=0.01,
        segment_steps=2500,
        load_inertia=(0.002, 0.002),
        excitations=("sine",),
        hold_steps=1,
    ),
    "rollout": _ROLLOUT,
    # segments of 1 s, so that a few seconds contain many loads
    "adapt": replace(_ROLLOUT, segment_steps=500),
    # excitation and load of paper at the rate of rollout
    "narrow": replace(_ROLLOUT, load_inertia=(0.002, 0.002), excitations=("sine",)),
}


def bench_schedule(name: str) -> BenchSchedule:
    """The schedule of that preset; raises `ConfigError` if there is none."""
    if name not in BENCH_SCHEDULES:
        raise ConfigError(
            f"no bench preset {name!r}", remedy=f"use one of {', '.join(BENCH_SCHEDULES)}"
        )
    return BENCH_SCHEDULES[name]


def training_motors(fleet: Fleet, motors: int, seed: int) -> TrueMotors:
    """The motors of a bench with this seed; held-out motors use another random stream."""
    return fleet.sample(motors, np.random.default_rng([seed, MOTORS_STREAM]))


def bench_trial(
    rng: np.random.Generator,
    excitation_name: str,
    steps: int,
    motors: int,
    schedule: BenchSchedule,
    hold: bool,
) -> Trial:
    """A trial of one excitation for ``motors`` motors, with a signal and a load per motor."""
    excitation = excitation_of(excitation_name)
    targets, external, inertia = excitation.streams(
        rng, steps, schedule.period, bench_names(motors), schedule.torque_factor
    )
    if hold:
        targets = zero_order_hold(targets, schedule.hold_steps)
    if inertia is None:
        low, high = np.log(schedule.load_inertia)
        inertia = np.exp(rng.uniform(low, high, motors))
    return Trial(targets, external, inertia, schedule.period)


def record(
    motors: TrueMotors, schedule: BenchSchedule, steps: int, seed: int, fleet: Fleet
) -> MotorLog:
    """Record ``steps`` samples of every motor; the same seed gives the same log.

    At the start of every segment of ``schedule.segment_steps`` samples the motors are static. They
    are as warm as after continuous operation since the start of the log. An external torque that
    causes a position error above MAX_DEVIATION is halved, up to MAX_HALVINGS times. Raises
    ConfigError if a simulation diverges, since the gear is too stiff for the load.
    """
    recordings = []
    segment_starts = range(0, steps - 1, schedule.segment_steps)
    segment_bounds = pairwise([*segment_starts, steps])
    for segment, (first, last) in enumerate(segment_bounds):
        trial = _segment_trial(segment, last - first, len(motors), schedule, seed)
        actuator = motors.after(first * schedule.period).actuator()
        trial, response = _with_limited_torques(motors, actuator, trial)

        instruments = np.random.default_rng([seed, segment, INSTRUMENTS_STREAM])
        pos, vel, torque = motors.logged(
            instruments,
            schedule.period,
            response.joint_pos,
            response.joint_vel,
            response.joint_torque,
        )
        logged_response = replace(response, joint_pos=pos, joint_vel=vel, joint_torque=torque)
        recordings.append((trial, logged_response))
    return as_log(recordings, fleet.motor, f"virtual dynamometer, fleet {fleet.name}, seed {seed}")


def _segment_trial(
    segment: int, steps: int, motors: int, schedule: BenchSchedule, seed: int
) -> Trial:
    """The trial of one segment."""
    rng = np.random.default_rng([seed, segment, EXCITATION_STREAM])
    cycle, position = divmod(segment, len(schedule.excitations))
    # Held and free targets alternate within a cycle. The next cycle holds the targets of the other
    # excitations.
    is_held_segment = (cycle + position) % 2 == 0
    hold = schedule.hold_steps > 1 and is_held_segment
    return bench_trial(rng, schedule.excitations[position], steps, motors, schedule, hold)


def _with_limited_torques(
    motors: TrueMotors, actuator: Actuator, trial: Trial
) -> tuple[Trial, Response]:
    """The trial and its response, with external torques halved as long as joints deviate far."""
    # A joint far from its command contributes little to identification, and real benches have end
    # stops.
    response = _checked_run(motors, actuator, trial)
    for _ in range(MAX_HALVINGS):
        error = np.abs(response.joint_pos - trial.position_target).max(axis=0)
        too_large = (error > MAX_DEVIATION) & trial.external_torque.any(axis=0)
        if not too_large.any():
            break
        external_torque = np.where(too_large, 0.5, 1.0) * trial.external_torque
        trial = replace(trial, external_torque=external_torque)
        response = _checked_run(motors, actuator, trial)
    return trial, response


def _checked_run(motors: TrueMotors, actuator: Actuator, trial: Trial) -> Response:
    """The response; raises ConfigError if a motor diverges."""
    response = run(actuator, trial)
    is_stable = (np.abs(response.joint_vel) < MAX_SPEED).all(axis=0)
    diverged = np.flatnonzero(~is_stable)  # includes NaN
    if diverged.size:
        motor = int(diverged[0])
        load = f"{trial.load_inertia[motor]:.2g} kg·m²"
        stiffness = f"{motors.gear_stiffness[motor]:.3g} N·m/rad"
        damping = f"{motors.gear_damping[motor]:.2g} N·m·s/rad"
        raise ConfigError(
            f"motor {motor} diverges on a load of {load}: its gear, {stiffness} and {damping}, "
            "is too stiff or too damped",
            remedy="give the fleet a softer, less damped gear, or the robot file larger "
            "load_inertia = [min, max]",
            argument="fleet",
        )
    return response


def as_log(recordings: Sequence[tuple[Trial, Response]], motor: str, source: str) -> MotorLog:
    """The log of a bench with a segment per trial."""
    trials = [trial for trial, _ in recordings]
    responses = [response for _, response in recordings]
    lengths = [len(trial.position_target) for trial in trials]
    target = np.concatenate([trial.position_target for trial in trials])
    return MotorLog(
        time=np.arange(sum(lengths)) * trials[0].dt,
        position_target=target,
        joint_pos=np.concatenate([response.joint_pos for response in responses]),
        joint_vel=np.concatenate([response.joint_vel for response in responses]),
        joint_torque=np.concatenate([response.joint_torque for response in responses]),
        load_inertia=np.repeat([trial.load_inertia for trial in trials], lengths, axis=0),
        external_torque=np.concatenate([trial.external_torque for trial in trials]),
        segment=np.repeat(np.arange(len(trials)), lengths),
        joint_names=bench_names(target.shape[1]),
        robot=BENCH,
        motor=motor,
        source=source,
    )
