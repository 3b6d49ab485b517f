"""Constants of simulated drives in MIT mode and under velocity and torque control.

    python benchmarks/command_modes.py --out runs/command_modes

They are fitted to the logs of the drives. Every drive swings a pendulum. Its truth is a rigid rotor
with Coulomb and viscous friction, whose control law gets whole command frames after a delay,
integrated in steps of PHYSICS_DT. In MIT mode a frame has position target, velocity target, gravity
compensation as feed-forward torque, and gains that ramp up at the start. With --firmware-gains,
gains are logged in units of a firmware, so that kp and kd must be found, too, and a heavy load
hides a small armature. Under velocity control a frame has the velocity target of a host that
follows a motion; kp is 0. Under torque control a frame has a torque alone. Angles have noise of
NOISE. figures.json has for MODE mit, torque and velocity

    MODE/replay               median of the replay errors of the drives [rad]
    MODE/replay_max           the largest [rad]
    MODE/CONSTANT             largest |fitted/true - 1| of kp, kd, armature, coulomb [-]
    MODE/within/CONSTANT      share of the drives within 10 % [-]
    MODE/delay                largest error of the delay [s]
    MODE/within/delay         share of the drives within 0.5 ms [-]
    MODE/coverage90           share of true delay, armature, Coulomb and viscous friction inside the
                              90 % intervals of `MotorPrior.intervals` [-]
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import motorprior as mp
from figures import PROGRESS, report, run_benchmark
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.compiled import njit
from motorprior.evaluation.errors import replay_errors
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.signals import rms
from motorprior.stage import FIGURES

PHYSICS_DT = 1e-4  # [s]
PERIOD = 0.002  # of commands and of the fit [s]
NOISE = 1e-4  # standard deviation of the readings [rad]
FIRMWARE_UNIT = 2.0  # N·m/rad per unit of the logged gains
RAMP = 1.5  # duration of the ramp of the gains [s]
MAX_DEVIATION = 0.1  # relative deviation of a constant that counts as found
MAX_DELAY_ERROR = 5e-4  # [s]
GRAVITY = 9.81  # [m/s²]
# lower and upper bounds of the constants, whose logarithms are uniformly distributed
RANGES = {
    "kp": (15.0, 80.0),
    "kd_over_kp": (0.02, 0.06),
    "delay": (0.002, 0.008),
    "armature": (0.006, 0.03),
    "coulomb": (0.1, 0.5),
    "viscous_damping": (0.02, 0.1),
}
LENGTH = 0.25  # of the pendulum [m]
MASSES = (0.5, 1.5)  # [kg]
COMPARED = {
    "mit": ("kp", "kd", "armature", "coulomb"),
    "torque": ("armature", "coulomb"),
    "velocity": ("kd", "armature", "coulomb"),
}
HOST_GAIN = 5.0  # velocity target per error of the angle, under velocity control [1/s]
COVERED = ("delay", "armature", "coulomb", "viscous_damping")
Constants = dict[str, np.ndarray]  # (drives,) by name


@dataclass(frozen=True)
class Settings:
    """Fit the constants of simulated drives."""

    out: Path  # run folder
    mit: int = 20  # drives in MIT mode
    torque: int = 10  # drives under torque control
    velocity: int = 10  # drives under velocity control
    seconds: float = 20.0  # duration of the log of each drive [s]
    preset: str = "quick"  # recipe of the fits
    firmware_gains: bool = False  # whether gains are logged in units of a firmware
    seed: int = 0


def figures(settings: Settings) -> dict[str, float]:
    """The figures of both modes, by their keys."""
    results = {}
    for mode in COMPARED:
        count = getattr(settings, mode)
        if not count:
            continue
        rng = np.random.default_rng([settings.seed, len(mode)])
        constants = drawn_constants(rng, count)
        log = recorded(rng, constants, mode, settings.seconds, settings.firmware_gains)
        out = settings.out / mode
        prior = mp.fit_prior(log, settings.preset, settings.seed, out=out, progress=PROGRESS)
        errors = {
            f"{mode}/{name}": value for name, value in errors_of(prior, log, constants).items()
        }
        report(errors, out / FIGURES)
        results |= errors
    return results


def errors_of(prior: mp.MotorPrior, log: MotorLog, constants: Constants) -> dict[str, float]:
    """The figures of one mode."""
    motors = prior.training_motors(np.arange(log.num_joints))
    assert isinstance(motors, GreyBoxActuator)
    fitted = motors.constants()
    fitted["kd"] = fitted["kp"] * fitted["kd_over_kp"]
    errors = rms(replay_errors(motors, log, {})[0], axis=0)
    values = {"replay": float(np.median(errors)), "replay_max": float(errors.max())}

    for name in COMPARED[log.command_mode]:
        deviation = np.abs(fitted[name] / constants[name] - 1.0)
        values[name] = float(deviation.max())
        values[f"within/{name}"] = float(np.mean(deviation <= MAX_DEVIATION))
    delay_error = np.abs(fitted["delay"] - constants["delay"])
    values["delay"] = float(delay_error.max())
    values["within/delay"] = float(np.mean(delay_error <= MAX_DELAY_ERROR))

    intervals = prior.intervals()
    is_inside = []
    for name in COVERED:
        low, high = intervals[name]
        is_inside.append((low <= constants[name]) & (constants[name] <= high))
    return values | {"coverage90": float(np.mean(is_inside))}


def drawn_constants(rng: np.random.Generator, count: int) -> Constants:
    """Constants of the drives."""
    constants = {}
    for name, (low, high) in RANGES.items():
        constants[name] = np.exp(rng.uniform(np.log(low), np.log(high), count))
    constants["kd"] = constants["kp"] * constants["kd_over_kp"]
    constants["mass"] = rng.uniform(*MASSES, count)
    return constants


def recorded(
    rng: np.random.Generator,
    constants: Constants,
    mode: str,
    seconds: float,
    firmware_gains: bool = False,
) -> MotorLog:
    """The log of the drives, each with the load of its pendulum."""
    count = len(constants["mass"])
    time = PERIOD * np.arange(round(seconds / PERIOD))
    shape = (len(time), count)
    inertia = constants["mass"] * LENGTH**2
    weight = constants["mass"] * GRAVITY * LENGTH
    target, velocity = motion(rng, time, count)

    zeros = np.zeros(shape)
    ones = np.ones(shape)
    ramp = np.broadcast_to(np.clip(time / RAMP, 0.05, 1.0)[:, None], shape)
    kp_factor, kd_factor = {
        "mit": (ramp, ramp),
        "velocity": (zeros, ones),
        "torque": (zeros, zeros),
    }[mode]
    feedforward = {
        "mit": weight * np.sin(target),
        "velocity": zeros,
        "torque": 0.8 * weight * target,
    }[mode]
    host_gain = HOST_GAIN if mode == "velocity" else 0.0

    names = ("kp", "kd", "delay", "armature", "coulomb", "viscous_damping")
    table = np.stack([constants[name] for name in names] + [inertia, weight])
    angle = np.zeros(shape)
    integrate(table, target, velocity, feedforward, kp_factor, kd_factor, host_gain, angle)

    unit = FIRMWARE_UNIT if firmware_gains else 1.0
    channels: dict[str, Any] = {}
    if mode == "mit":
        channels |= {"position_target": target, "logged_kp": kp_factor * constants["kp"] / unit}
    if mode != "torque":
        channels |= {
            "velocity_target": velocity,
            "logged_kd": kd_factor * constants["kd"] / unit,
            "gain_unit": "firmware" if firmware_gains else "N·m/rad",
        }
    if mode != "velocity":
        channels["torque_feedforward"] = feedforward

    reading = angle + NOISE * rng.standard_normal(shape)
    channels.setdefault("position_target", reading)
    log = MotorLog(
        time=time,
        joint_pos=reading,
        joint_names=tuple(f"drive_{drive}" for drive in range(count)),
        robot="bench",
        motor="simulated drive",
        source=f"drives in mode {mode}",
        command_mode=mode,
        load_inertia=np.broadcast_to(inertia, shape),
        external_torque=-weight * np.sin(reading),
        load_stiffness=-weight * np.cos(reading),
        **channels,
    )
    return checked(log)


def motion(rng: np.random.Generator, time: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows, count) sums of sines up to 2.5 Hz within 0.9 rad, and their velocities [rad/s]."""
    frequency = np.exp(rng.uniform(np.log(0.1), np.log(2.5), (6, 1, count)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 1, count))
    angle = 2.0 * np.pi * frequency * time[:, None] + phase
    size = np.minimum(1.0, 0.5 / frequency)
    target = (size * np.sin(angle)).sum(axis=0)
    velocity = (2.0 * np.pi * frequency * size * np.cos(angle)).sum(axis=0)
    scale = 0.9 / np.abs(target).max(axis=0)
    return scale * target, scale * velocity


@njit(cache=True, nogil=True)
def integrate(table, target, velocity, feedforward, kp_factor, kd_factor, host_gain, angle):
    """Write (rows, count) angles [rad] of drives with constants ``table`` (8, count).

    A host adds ``host_gain`` [1/s] times the error of the angle to the velocity targets.
    """
    substeps = round(PERIOD / PHYSICS_DT)
    for drive in range(target.shape[1]):
        kp, kd, delay, armature, coulomb, viscous, load, weight = table[:, drive]
        inertia = armature + load
        lag = delay / PERIOD
        q = target[0, drive] * (kp_factor[0, drive] > 0.0)
        dq = 0.0
        for row in range(target.shape[0]):
            angle[row, drive] = q
            velocity[row, drive] += host_gain * (target[row, drive] - q)
            for substep in range(substeps):
                sent = max(0, int(np.floor(row + substep / substeps - lag + 1e-9)))
                torque = kp_factor[sent, drive] * kp * (target[sent, drive] - q)
                torque += kd_factor[sent, drive] * kd * (velocity[sent, drive] - dq)
                torque += feedforward[sent, drive] - weight * np.sin(q) - viscous * dq
                free = dq + PHYSICS_DT * torque / inertia
                slowed = max(0.0, abs(free) - PHYSICS_DT * coulomb / inertia)
                dq = np.copysign(slowed, free)
                q += PHYSICS_DT * dq


if __name__ == "__main__":
    run_benchmark(Settings, figures, __doc__)
