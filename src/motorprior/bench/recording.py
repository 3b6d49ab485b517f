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


@dataclass(frozen=True)
class BenchPreset:
    """Excitations and loads of a bench."""

    period: float  # sample period of the log [s]
    segment_steps: int  # samples per contiguous recording
    load_inertia: tuple[float, float]  # (low, high) of the log-uniform load inertia [kg·m²]
    kinds: tuple[str, ...]  # names in `excitation.EXCITATIONS` or files, cycled over the segments
    hold_steps: int  # samples for which targets are held in every second segment
    torque_factor: float = 1.0  # factor on the external torques [-]

    def for_robot(self, robot: Robot) -> "BenchPreset":
        """The preset scaled to ``robot``; unscaled it is for REFERENCE_LOAD and a reference torque of 1 N·m."""
        low, high = (
            own / reference
            for own, reference in zip(robot.load_inertia, REFERENCE_LOAD, strict=True)
        )
        loads = low * self.load_inertia[0], high * self.load_inertia[1]
        return replace(self, load_inertia=loads, torque_factor=robot.reference_torque)


REFERENCE_LOAD = (1e-4, 3e-2)  # load inertia of the robot for which the presets are written [kg·m²]
# tags of random streams
MOTORS_STREAM = 11
EXCITATION_STREAM = 13
INSTRUMENTS_STREAM = 47
MAX_DEVIATION = 1.5  # position error [rad] above which an external torque is halved
MAX_HALVINGS = 4
MAX_SPEED = 1e3  # joint speed [rad/s] above which a simulation has diverged
# rollout: loads from a bare shank to a standing robot; half of the commands are held at 100 Hz
# adapt: the same in segments of 1 s, so that a few seconds contain many loads
# narrow: excitation and load of paper at the rate of rollout
_ROLLOUT = BenchPreset(0.002, 1000, (1e-4, 3e-2), ("sine", "steps", "gait", "impacts", "creep"), 5)
BENCH_PRESETS = {
    "paper": BenchPreset(0.01, 2500, (0.002, 0.002), ("sine",), 1),
    "rollout": _ROLLOUT,
    "adapt": replace(_ROLLOUT, segment_steps=500),
    "narrow": replace(_ROLLOUT, load_inertia=(0.002, 0.002), kinds=("sine",)),
}


def bench_preset(name: str) -> BenchPreset:
    """The preset of that name; raises `ConfigError` if there is none."""
    if name not in BENCH_PRESETS:
        raise ConfigError(
            f"no bench preset {name!r}", remedy=f"use one of {', '.join(BENCH_PRESETS)}"
        )
    return BENCH_PRESETS[name]


def training_motors(fleet: Fleet, motors: int, seed: int) -> TrueMotors:
    """The motors of a bench with this seed; held-out motors use another random stream."""
    return fleet.sample(motors, np.random.default_rng([seed, MOTORS_STREAM]))


def bench_trial(
    rng: np.random.Generator, kind: str, steps: int, motors: int, preset: BenchPreset, hold: bool
) -> Trial:
    """A trial of one excitation for ``motors`` motors, with a signal and a load per motor."""
    chosen = excitation_of(kind)
    targets, external, inertia = chosen.streams(
        rng, steps, preset.period, bench_names(motors), preset.torque_factor
    )
    if hold:
        targets = zero_order_hold(targets, preset.hold_steps)
    if inertia is None:
        low, high = np.log(preset.load_inertia)
        inertia = np.exp(rng.uniform(low, high, motors))
    return Trial(targets, external, inertia, preset.period)


def record(
    motors: TrueMotors, preset: BenchPreset, steps: int, seed: int, fleet: Fleet
) -> MotorLog:
    """Record ``steps`` samples of every motor.

    Deterministic. Every segment of ``preset.segment_steps`` samples starts with static motors that
    have been warming since the start of the log. An external torque that causes a position error
    above MAX_DEVIATION is halved, up to four times. Raises ConfigError if a simulation diverges,
    since the gear is too stiff for the load.
    """
    parts = []
    count = len(motors)
    bounds = [*range(0, steps - 1, preset.segment_steps), steps]
    for segment, (first, last) in enumerate(pairwise(bounds)):
        rng = np.random.default_rng([seed, segment, EXCITATION_STREAM])
        kind = preset.kinds[segment % len(preset.kinds)]
        round_, slot = divmod(segment, len(preset.kinds))
        hold = preset.hold_steps > 1 and (round_ + slot) % 2 == 0
        part = bench_trial(rng, kind, last - first, count, preset, hold)
        part, response = _with_limited_pushes(
            motors, motors.after(first * preset.period).actuator(), part
        )
        instruments = np.random.default_rng([seed, segment, INSTRUMENTS_STREAM])
        true = response.joint_pos, response.joint_vel, response.joint_torque
        pos, vel, torque = motors.logged(instruments, preset.period, *true)
        parts.append((part, replace(response, joint_pos=pos, joint_vel=vel, joint_torque=torque)))
    return as_log(parts, fleet.motor, f"virtual dynamometer, fleet {fleet.name}, seed {seed}")


def _with_limited_pushes(
    motors: TrueMotors, actuator: Actuator, part: Trial
) -> tuple[Trial, Response]:
    # a joint far from its command contributes little to identification, and real benches have end
    # stops
    response = _checked_run(motors, actuator, part)
    for _ in range(MAX_HALVINGS):
        error = np.abs(response.joint_pos - part.position_target).max(axis=0)
        too_large = (error > MAX_DEVIATION) & part.external_torque.any(axis=0)
        if not too_large.any():
            break
        part = replace(part, external_torque=np.where(too_large, 0.5, 1.0) * part.external_torque)
        response = _checked_run(motors, actuator, part)
    return part, response


def _checked_run(motors: TrueMotors, actuator: Actuator, part: Trial) -> Response:
    response = run(actuator, part)
    diverged = np.flatnonzero(~(np.abs(response.joint_vel) < MAX_SPEED).all(axis=0))  # includes NaN
    if diverged.size:
        motor = int(diverged[0])
        gear = f"{motors.gear_stiffness[motor]:.3g} N·m/rad and {motors.gear_damping[motor]:.2g} N·m·s/rad"
        problem = f"motor {motor} diverges on a load of {part.load_inertia[motor]:.2g} kg·m²: its gear, {gear}, is "
        remedy = "give the fleet a softer, less damped gear, or the robot file larger load_inertia = [min, max]"
        raise ConfigError(f"{problem}too stiff or too damped", remedy=remedy, argument="fleet")
    return response


def as_log(parts: Sequence[tuple[Trial, Response]], motor: str, source: str) -> MotorLog:
    """The log of a bench with a segment per trial."""
    target = np.concatenate([part.position_target for part, _ in parts])
    lengths = [len(part.position_target) for part, _ in parts]
    return MotorLog(
        time=np.arange(sum(lengths)) * parts[0][0].dt,
        position_target=target,
        joint_pos=np.concatenate([response.joint_pos for _, response in parts]),
        joint_vel=np.concatenate([response.joint_vel for _, response in parts]),
        joint_torque=np.concatenate([response.joint_torque for _, response in parts]),
        load_inertia=np.repeat([part.load_inertia for part, _ in parts], lengths, axis=0),
        external_torque=np.concatenate([part.external_torque for part, _ in parts]),
        segment=np.repeat(np.arange(len(parts)), lengths),
        joint_names=bench_names(target.shape[1]),
        robot=BENCH,
        motor=motor,
        source=source,
    )
