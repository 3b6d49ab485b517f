"""The interface of an export format, and the sample of motors that it writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from motorprior import __version__
from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_step import SIGNED, parameters_of
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import COLD
from motorprior.bench.dynamometer import Trial
from motorprior.exceptions import ConfigError

Constants: TypeAlias = Mapping[str, np.ndarray]  # (n,) or (K, J) by name, in SI units at the output shaft
# (constants (n,), trial) -> (steps, n) joint angles [rad] of the exported motors
Replay: TypeAlias = Callable[[Constants, Trial], np.ndarray]
MIN_CONSTANT = 1e-9  # of a constant that is 0: decoders have its logarithm


@dataclass(frozen=True)
class MotorSample:
    """K robots of J sampled motors."""

    source: MotorPrior | MotorPosterior
    robots: tuple[GreyBoxActuator, ...]  # K
    joint_names: tuple[str, ...]  # J
    seed: int

    @property
    def prior(self) -> MotorPrior:
        """The prior of the motors."""
        return self.source.prior if isinstance(self.source, MotorPosterior) else self.source

    def constants(self) -> dict[str, np.ndarray]:
        """(K, J) constants by name, kd [N·m·s/rad] in place of kd_over_kp."""
        each = [with_kd(robot.constants()) for robot in self.robots]
        return {name: np.stack([values[name] for values in each]) for name in each[0]}

    def bank(self) -> GreyBoxActuator:
        """K·J motors, the K samples of a joint one after the other."""
        first, gains = self.robots[0], [robot.gains for robot in self.robots if robot.gains is not None]
        z = np.stack([robot.z for robot in self.robots], axis=1).reshape(-1, first.z.shape[1])
        return replace(first, z=z, gains=np.stack(gains, axis=2).reshape(2, -1) if gains else None)


@dataclass(frozen=True)
class Request:
    """What to write, and where."""

    sample: MotorSample
    constants: Constants  # (K, J) of the sample, and `carried`
    out: Path
    model: Path | None  # the user's MJCF
    losses: Mapping[str, float]  # `registry.losses` by load [rad]
    not_expressed: Mapping[str, float]  # median value by constant

    def motors(self) -> Iterator[tuple[int, str, dict[str, float]]]:
        """Sample, joint and constants of every motor."""
        for index in range(len(self.sample.robots)):
            for column, joint in enumerate(self.sample.joint_names):
                yield index, joint, one_motor(self.constants, (index, column))

    def provenance(self) -> dict[str, object]:
        """Origin and loss of the motors, for the files of every format."""
        prior, source = self.sample.prior, self.sample.source
        return {
            "version": __version__, "prior_sha256": prior.sha256(), "robot": prior.robot, "motor": prior.motor,
            "seed": self.sample.seed, "joint_names": list(self.sample.joint_names), "spread": prior.spread_notes(),
            "distribution": "posterior" if isinstance(source, MotorPosterior) else "prior",
            "loss_rad": dict(self.losses), "not_expressed": dict(self.not_expressed),
        }  # fmt: skip


@dataclass(frozen=True)
class Exporter:
    """A format."""

    name: str  # of the option --format
    drops: tuple[str, ...]  # constants that the format cannot express
    write: Callable[[Request], list[Path]]  # writes the files and returns them
    replay: Replay | None = None  # None: the format loses nothing; all others lack the optional terms
    needs_model: bool = False  # whether it changes the user's MJCF
    mujoco: int = 3  # major version that it needs


def sampled(
    source: MotorPrior | MotorPosterior, motors: int, seed: int, joint_names: tuple[str, ...], gains: np.ndarray | None
) -> MotorSample:
    """K robots of motors at these joints.

    Raises:
        ConfigError: motors without physical constants, or as `MotorPrior.sample` and `MotorPosterior.sample`.
    """
    rng = np.random.default_rng(seed)
    if isinstance(source, MotorPrior):
        draw = partial(source.sample, source.classes_at(joint_names))
    else:
        if set(joint_names) <= set(source.joint_names):
            source = source.take([source.joint_names.index(name) for name in joint_names])
        draw = partial(source.sample, len(joint_names))
    robots = tuple(draw(rng, gains) for _ in range(motors))
    boxes = tuple(robot for robot in robots if isinstance(robot, GreyBoxActuator))
    if len(boxes) < len(robots):
        remedy = "identify with preset rollout"
        raise ConfigError("the prior is a network without physical constants", remedy=remedy, argument="source")
    return MotorSample(source, boxes, joint_names, seed)


def with_kd(values: Constants) -> dict[str, np.ndarray]:
    """The constants with kd = kp·kd_over_kp [N·m·s/rad] in place of kd_over_kp."""
    others = {name: value for name, value in values.items() if name != "kd_over_kp"}
    return others | {"kd": values["kp"] * values["kd_over_kp"]}


def one_motor(values: Constants, index: int | tuple[int, int]) -> dict[str, float]:
    """The constants of one motor of (n,) or (K, J)."""
    return {name: float(value[index]) for name, value in values.items()}


def motors_of(values: Constants, terms: tuple[str, ...] = (), period: float = 0.002) -> GreyBoxActuator:
    """Motors with the constants (n,) by name, kd instead of kd_over_kp; largest physics step ``period`` [s].

    A constant that is 0 becomes MIN_CONSTANT.
    """
    values = {**values, "kd_over_kp": values["kd"] / values["kp"]}
    columns = [
        np.asarray(values[name]) / SIGNED[name] if name in SIGNED else np.log(np.maximum(values[name], MIN_CONSTANT))
        for name in parameters_of(terms)
    ]
    raw = np.stack(np.broadcast_arrays(*columns), axis=-1).reshape(-1, len(columns))
    center = raw.mean(axis=0)
    model = GreyBox(GearedMotor(center, np.eye(len(columns)), terms), period)
    return GreyBoxActuator(model, raw - center, COLD)


def described_loss(losses: Mapping[str, float], not_expressed: Mapping[str, float]) -> str:
    """For example "RMSE against the learned motors: leg 2.4 mrad; not expressed: backlash (median 0.01)"."""
    errors = ", ".join(f"{name} {1e3 * value:.1f} mrad" for name, value in losses.items())
    lost = ", ".join(f"{name} (median {value:.3g})" for name, value in not_expressed.items())
    return f"RMSE against the learned motors: {errors}; not expressed: {lost or 'nothing'}"
