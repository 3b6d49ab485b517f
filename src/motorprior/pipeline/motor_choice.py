"""Which motors a simulated robot walks on: one description, used by walk, transfer and speed."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import LONGEST_STEP, PhysicalActuator
from motorprior.artifacts import require_keys
from motorprior.bench.fleet import Fleet, load_fleet
from motorprior.bounds import require_number
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.pipeline.stage import digest, fleet_files
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.mujoco_backend import DrawMotors

_LARGEST = 1e9
LONGEST_DELAY = 1.0
"""[s]; a PD keeps every physics step's target for so long."""


def load_prior(path: Path, physics_dt: float = spec.PHYSICS_DT) -> MotorPrior:
    """A prior that this robot can be simulated with.

    Raises:
        ArtifactError: a file that is no prior.
        ConfigError: a prior of another robot, or one that does not fit ``physics_dt`` [s].
    """
    try:
        prior = MotorPrior.load(path)
        prior.require(spec.ROBOT_NAME, physics_dt)
        _require_all_motors(prior)
    except (ArtifactError, ConfigError) as error:
        remedy = error.remedy or "use a prior that `motorprior identify` wrote"
        raise type(error)(error.problem, where=path, remedy=remedy) from error
    return prior


def _require_all_motors(prior: MotorPrior) -> None:
    """Refuse a prior that does not hold one mean per motor of the bench it says it is from."""
    bench = prior.provenance.get("bench")
    said = bench.get("motors") if isinstance(bench, dict) else None
    if said is not None and said != len(prior.mean):
        raise ArtifactError(
            f"it has {len(prior.mean)} training motors, its bench {str(said)[:20]}", remedy="identify it anew"
        )


def load_robot_fleet(name_or_path: str) -> Fleet:
    """A fleet whose motors are those of this robot.

    Raises:
        ArtifactError: see `load_fleet`.
        ConfigError: a fleet of another robot.
    """
    fleet = load_fleet(name_or_path)
    if fleet.robot != spec.ROBOT_NAME:
        raise ConfigError(
            f"the fleet is of robot {fleet.robot!r}, not {spec.ROBOT_NAME!r}", where=name_or_path,
            remedy=f"use a fleet of {spec.ROBOT_NAME}",
        )  # fmt: skip
    return fleet


def nominal_pd(fleet: Fleet, num_motors: int) -> IdealPd:
    """The ideal PD: the gains and the torque limit of the fleet's central motor, nothing else."""
    center = fleet.center(1)
    return IdealPd.uniform(num_motors, center.kp[0], center.kd[0], center.torque_limit[0])


@dataclass(frozen=True)
class MotorChoice:
    """The motors of every episode."""

    actuator: Literal["prior", "pd", "fleet"] = "prior"
    """prior: samples of a learned prior; pd: an ideal PD; fleet: physical motors (the oracle)."""
    prior: Path | None = None
    """Prior file, for the actuator prior."""
    posterior: Path | None = None
    """Posterior of one motor or of the robot's twelve, written by `motorprior adapt`: walk on those motors only."""
    fleet: str = "pupper_v2"
    """Fleet of the physical motors, and of the PD's nominal gains."""
    kp: float | None = None
    """PD gain [N·m/rad]; the fleet's center if not given."""
    kd: float | None = None
    """PD gain [N·m·s/rad]; the fleet's center if not given."""
    torque_limit: float | None = None
    """PD torque limit [N·m]; the fleet's center if not given."""
    armature: float = 0.0
    """Reflected inertia of the PD's motors [kg·m²]."""
    delay: float = 0.0
    """Delay of the PD's target [s]."""

    @property
    def physics_dt(self) -> float:
        """The step these motors are simulated at [s]: the longest at which they are stable."""
        return LONGEST_STEP if self.actuator == "fleet" else spec.PHYSICS_DT

    def condition(self) -> str:
        """The name these motors have in a study: ideal_pd, tuned_pd, oracle, or the prior's preset."""
        if self.actuator == "fleet":
            return "oracle"
        if self.actuator == "pd":
            return "tuned_pd" if self.armature or self.delay else "ideal_pd"
        return MotorPrior.load(self.prior).preset if self.prior is not None else "prior"

    def inputs(self) -> list[Path]:
        """Files the choice depends on."""
        files = [self.prior, self.posterior] if self.actuator == "prior" else []
        return [file for file in files if file is not None] + fleet_files(self.fleet)

    def robot_gains(self) -> tuple[float, float]:
        """Kp [N·m/rad] and kd [N·m·s/rad] that the robot's own motors run with: the nominal ones of the fleet."""
        center = load_robot_fleet(self.fleet).center(1)
        return float(center.kp[0]), float(center.kd[0])

    def drawer(self) -> DrawMotors:
        """A function that draws twelve motors.

        Raises:
            ConfigError: a prior is missing, or one was given for nothing, or a PD constant is out of range.
            ArtifactError: a file cannot be read.
        """
        for name, file in (("prior", self.prior), ("posterior", self.posterior)):
            if self.actuator != "prior" and file is not None:
                raise ConfigError(
                    f"actuator {self.actuator} has no use for a {name}",
                    where=file,
                    remedy="leave one of them out",
                    argument="actuator",
                )
        if self.actuator == "fleet":
            fleet = load_robot_fleet(self.fleet)
            return lambda rng: PhysicalActuator(fleet.sample(rng, spec.NUM_JOINTS))
        if self.actuator == "pd":
            return self._pd()
        if self.prior is None:
            raise ConfigError(
                "actuator prior needs the file of a prior", remedy="identify one, or use another actuator",
                argument="actuator",
            )  # fmt: skip
        prior = load_prior(self.prior, self.physics_dt)
        if self.posterior is None:
            return lambda rng: prior.sample(rng, spec.NUM_JOINTS)
        posterior = _load_posterior(self.posterior, self.prior, prior)
        return lambda rng: posterior.sample(prior, rng, spec.NUM_JOINTS)

    def _pd(self) -> DrawMotors:
        center = load_robot_fleet(self.fleet).center(1)
        kp = float(center.kp[0]) if self.kp is None else self.kp
        kd = float(center.kd[0]) if self.kd is None else self.kd
        limit = float(center.torque_limit[0]) if self.torque_limit is None else self.torque_limit
        for name, value in (("kp", kp), ("kd", kd), ("torque_limit", limit), ("armature", self.armature)):
            require_number(name, value)
        require_number("delay", self.delay, most=LONGEST_DELAY)
        model = IdealPd.uniform(spec.NUM_JOINTS, kp, kd, limit, self.armature, self.delay)
        return lambda rng: model

    def as_json(self, folder: Path) -> dict[str, Any]:
        """For the provenance of a policy in ``folder``; prior and posterior by digest and by two paths."""
        values = asdict(self) | dict.fromkeys(_FILE_KEYS)
        for name, file in (("prior", self.prior), ("posterior", self.posterior)):
            if file is not None:
                values[name] = str(file.resolve())
                values[f"{name}_beside"] = os.path.relpath(file.resolve(), folder.resolve())
                values[f"{name}_sha256"] = digest(file)
        return values


def _load_posterior(path: Path, prior_path: Path, prior: MotorPrior) -> MotorPosterior:
    """A posterior of that very prior, of one motor or of the robot's.

    Raises:
        ArtifactError: a file that is no posterior.
        ConfigError: of another prior, or of another number of motors.
    """
    posterior = MotorPosterior.load(path)
    if posterior.prior_sha256 != digest(prior_path):
        raise ConfigError(f"it is no posterior of {prior_path}", where=path, remedy="adapt that prior to the log anew")
    posterior.sample(prior, np.random.default_rng(0), spec.NUM_JOINTS)
    return _in_the_robots_order(posterior, path)


def _in_the_robots_order(posterior: MotorPosterior, path: Path) -> MotorPosterior:
    """Motors that have the names of the robot's joints, in the robot's order; motors of a bench as they are.

    Raises:
        ConfigError: some names are of the robot's joints and others are not.
    """
    names = posterior.joint_names
    strange = sorted(set(names) - set(spec.JOINT_NAMES))
    if len(names) == 1 or len(strange) == len(names):
        return posterior
    if strange:
        raise ConfigError(
            f"joints {strange} are not {spec.ROBOT_NAME}'s", where=path, remedy=f"name them {list(spec.JOINT_NAMES)}"
        )
    order = [names.index(name) for name in spec.JOINT_NAMES]
    return replace(
        posterior, mean=posterior.mean[order], covariance=posterior.covariance[order], joint_names=spec.JOINT_NAMES,
        surprise=tuple(posterior.surprise[index] for index in order),
    )  # fmt: skip


_FILE_KEYS = tuple(f"{name}{ending}" for name in ("prior", "posterior") for ending in ("", "_beside", "_sha256"))
"""The absolute path; the path from the policy's folder, which is tried first, so that both can be moved; the digest."""
_NUMBERS = {"kp": True, "kd": True, "torque_limit": True, "armature": False, "delay": False}
"""Numbers of a choice, and whether they may be left out."""


def choice_from_json(data: Any, policy: Path) -> MotorChoice:
    """Read what `MotorChoice.as_json` wrote.

    Args:
        data: the provenance of the motors.
        policy: the file it stands in.

    Raises:
        ArtifactError: unknown or missing keys, or a value of another type.
        ConfigError: the prior is gone or is not the one the policy was trained on.
    """
    if not isinstance(data, dict):
        raise ArtifactError("it does not say which motors it walked on", where=policy, remedy="train it anew")
    fields = set(MotorChoice.__dataclass_fields__)
    require_keys(data, {*fields, *_FILE_KEYS}, policy)
    for name in sorted(data):
        if not _has_type(name, data[name]):
            problem = f"{name} = {str(data[name])[:40]} of its motors makes no sense"
            raise ArtifactError(problem, where=policy, remedy="train it anew")
    values: dict[str, Any] = {name: data[name] for name in fields}
    for name in ("prior", "posterior"):
        values[name] = None if data[name] is None else _find(name, data, policy)
    return MotorChoice(**values)


def _has_type(name: str, value: Any) -> bool:
    if name in _NUMBERS:
        if value is None:
            return _NUMBERS[name]
        return type(value) in (int, float) and abs(value) < _LARGEST and isfinite(value)
    if name in _FILE_KEYS:
        return value is None or isinstance(value, str)
    return isinstance(value, str) and (name != "actuator" or value in ("prior", "pd", "fleet"))


def _find(name: str, data: dict[str, Any], policy: Path) -> Path:
    beside = [policy.parent / data[f"{name}_beside"]] if data[f"{name}_beside"] is not None else []
    for path in (*beside, Path(data[name])):
        if path.is_file() and digest(path) == data[f"{name}_sha256"]:
            return path
    raise ConfigError(
        f"the {name} it was trained on, {data[name]}, is gone or has changed", where=policy,
        remedy="put it back, or train the policy anew",
    )  # fmt: skip
