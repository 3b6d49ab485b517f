"""The interface of an export format, and the sample of motors that it writes."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from motorprior import __version__
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial
from motorprior.bounds import generator_of
from motorprior.exceptions import ConfigError
from motorprior.exports.mjcf_document import Mjcf
from motorprior.robots.joint_classes import unknown_joint

UNSTABLE = 1.0  # error of a replay that has diverged [rad]
# (n,) or (K, J) by name, in SI units at the output shaft
ConstantArrays: TypeAlias = Mapping[str, np.ndarray]
# (constants (n,), trial) -> (steps, n) joint angles [rad] of the exported motors
ReplayFunction: TypeAlias = Callable[[ConstantArrays, Trial], np.ndarray]


@dataclass(frozen=True)
class Request:
    """K robots of J sampled motors to write."""

    source: MotorPrior | MotorPosterior
    joint_names: tuple[str, ...]  # J
    seed: int
    constants: ConstantArrays  # (K, J), see `replay.constants`
    out: Path
    model: Mjcf | None  # the user's
    losses: Mapping[str, float]  # see `replay.losses`, by load [rad]
    not_expressed: Mapping[str, float]  # median value by constant

    def motors(self) -> Iterator[tuple[int, str, dict[str, float]]]:
        """Robot, joint and constants of every motor."""
        for robot, column in np.ndindex(self.constants["kp"].shape):
            values = one_motor(self.constants, (robot, column))
            yield robot, self.joint_names[column], values

    def provenance(self) -> dict[str, object]:
        """Origin and loss of the motors, for the files of every format."""
        prior = prior_of(self.source)
        is_posterior = isinstance(self.source, MotorPosterior)
        return {
            "version": __version__,
            "prior_sha256": prior.sha256(),
            "robot": prior.robot,
            "motor": prior.motor,
            "seed": self.seed,
            "joint_names": list(self.joint_names),
            "spread": prior.spread_notes(),
            "distribution": "posterior" if is_posterior else "prior",
            "loss_rad": dict(self.losses),
            "not_expressed": dict(self.not_expressed),
        }


@dataclass(frozen=True)
class Exporter:
    """A format."""

    name: str  # value of the option --format
    not_expressed: tuple[str, ...]  # constants that the format cannot express
    write: Callable[[Request], list[Path]]  # writes the files and returns them
    # simulation of the written motors; None if the format loses nothing. All other formats lack the
    # optional terms.
    replay: ReplayFunction | None = None
    needs_model: bool = False  # whether it changes the user's MJCF
    min_mujoco: int = 3  # smallest major version of MuJoCo that the format needs
    # whether the format has motors that follow velocities or torques, see `command_frame`
    has_other_commands: bool = True
    # (constants, timestep [s]) -> whether a motor is written as a plain joint
    is_written_as_plain_joint: Callable[[ConstantArrays, float], np.ndarray] | None = None


def prior_of(source: MotorPrior | MotorPosterior) -> MotorPrior:
    """The prior itself, or the prior of a posterior."""
    if isinstance(source, MotorPosterior):
        return source.prior
    return source


def sampled(
    source: MotorPrior | MotorPosterior,
    motors: int,
    seed: int,
    joint_names: tuple[str, ...],
    gains: Any = None,
) -> GreyBoxActuator:
    """Motors at these J joints of K = ``motors`` robots, robot after robot.

    ``gains`` are kp and kd, (2,) or (2, J), see `export`. Raises ConfigError for motors without
    physical constants, or as `MotorPrior.sample` and `MotorPosterior.sample`.
    """
    rng = generator_of(seed)
    num_joints = len(joint_names)

    joints: Any = num_joints
    if isinstance(source, MotorPrior):
        joints = source.classes_named(joint_names)
    elif len(source.joint_names) > 1:
        for name in joint_names:
            if name not in source.joint_names:
                raise unknown_joint(name, source.joint_names, "joint of the posterior")
        source = source.take([source.joint_names.index(name) for name in joint_names])

    gains_of_joints = None
    if gains is not None:
        gains_of_joints = np.broadcast_to(np.reshape(gains, (2, -1)), (2, num_joints))

    robots = [source.sample(joints, rng, gains_of_joints) for _ in range(motors)]
    first = robots[0]
    if not isinstance(first, GreyBoxActuator):
        raise ConfigError(
            "the prior is a network without physical constants",
            remedy="identify with preset rollout",
            argument="source",
        )
    # all robots have the same gains
    gains_of_motors = None if first.gains is None else np.tile(first.gains, motors)
    latents = np.concatenate([robot.z for robot in robots])
    return replace(first, z=latents, gains=gains_of_motors)


def one_motor(values: ConstantArrays, index: int | tuple[int, int]) -> dict[str, float]:
    """The constants of one motor of (n,) or (K, J)."""
    return {name: float(array[index]) for name, array in values.items()}


def described_loss(losses: Mapping[str, float], not_expressed: Mapping[str, float]) -> str:
    """For example "RMSE against …: leg 2.4 mrad; not expressed: backlash (median 0.01)"."""
    errors = []
    for load, error in losses.items():
        errors.append(f"{load} {1e3 * error:.1f} mrad" if error < UNSTABLE else f"{load} unstable")

    missing = [f"{name} (median {value:.3g})" for name, value in not_expressed.items()]
    return (
        f"RMSE against the learned motors, at steps of at most 2 ms: {', '.join(errors)}; "
        f"not expressed: {', '.join(missing) or 'nothing'}"
    )
