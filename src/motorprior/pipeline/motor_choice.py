"""Which motors a simulated robot walks on: one description, used by walk, transfer and speed."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from motorprior.actuator.actuator import Actuator, require_motors
from motorprior.actuator.friction_pd import FRICTION_PD, FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import Fleet, load_fleet
from motorprior.bench.recording import bench_names
from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import MotorLog, stated_gains_of
from motorprior.pipeline.prior_file import load_prior, told_gains
from motorprior.pipeline.stage import fleet_files
from motorprior.robots.robot import Robot
from motorprior.simulation.mujoco_backend import DrawMotors

ActuatorName: TypeAlias = Literal["prior", "pd", "fleet"]
ACTUATORS: tuple[ActuatorName, ...] = get_args(ActuatorName)
"""What motors can be: samples of a learned prior, an ideal PD, or physical motors of a fleet."""
LONGEST_DELAY = 1.0
"""[s]; a PD keeps every physics step's target for so long."""

_OF_A_PD = ("kp", "kd", "torque_limit", "armature", "delay", "coulomb", "spread")
_OF_A_PRIOR, _OF_A_POSTERIOR = ("latent_spread",), ("limit_follows_gain",)
_OF_SOME = (*_OF_A_PD, *_OF_A_PRIOR, *_OF_A_POSTERIOR)
WIDEST, WIDEST_LATENT = 0.9, 10.0
_TRIED = 0
"""Seed of the draw that shows what a function draws."""
_LATE = 0.02
"""Delay that counts as the whole of a spread [s]: that of a PD may be fitted to 0, of which no share is a delay."""
_LARGEST_OF_A_PD = {"kp": 1e9, "kd": 1e9, "torque_limit": 1e9, "armature": 1e3}
"""[N·m/rad], [N·m·s/rad], [N·m], [kg·m²]: beyond any motor, and far from what overflows."""


def load_robot_fleet(robot: Robot, fleet: Fleet | str | Path | None = None) -> Fleet:
    """A fleet, or its name or path, whose motors are those of this robot; the one shipped for it if none is given.

    Raises:
        ArtifactError: see `load_fleet`.
        ConfigError: a fleet of another robot, or none is named and none is shipped.
    """
    chosen = robot.default_fleet if fleet is None else fleet
    found = chosen if isinstance(chosen, Fleet) else load_fleet(chosen)
    if found.robot != robot.name:
        raise ConfigError(
            f"the fleet is of robot {found.robot!r}, not {robot.name!r}",
            where=found.name if isinstance(chosen, Fleet) else chosen, remedy=f"use a fleet of {robot.name}",
        )  # fmt: skip
    return found


def described_pd(robot: Robot) -> IdealPd:
    """An ideal PD with the gains and torque limits of the robot's own description."""
    columns = [np.array([getattr(joint, name) for joint in robot.joints]) for name in ("kp", "kd", "torque_limit")]
    kp, kd, torque_limit = columns
    return IdealPd(kp, kd, torque_limit, armature=np.zeros(robot.num_joints), delay=np.zeros(robot.num_joints))


def nominal_pd(fleet: Fleet, num_motors: int) -> IdealPd:
    """The ideal PD: the gains and the torque limit of the fleet's central motor, nothing else."""
    center = fleet.center(1)
    return IdealPd.uniform(num_motors, center.kp[0], center.kd[0], center.torque_limit[0])


def gains_for(prior: MotorPrior, robot: Robot, log: MotorLog) -> np.ndarray | None:
    """Gains that the log states in the prior's unit; the robot's where it states none."""
    stated = stated_gains_of(log) if log.gain_unit == prior.network.gain_unit else None
    return told_gains(prior, robot) if stated is None else stated


MotorSource: TypeAlias = MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors
"""The motors of an episode: what they are drawn from, motors that are the same in every episode, or a function."""


def drawn_from(motors: MotorSource, robot: Robot) -> tuple[DrawMotors, float]:
    """A function that draws the motors of an episode, and the physics step [s] they are simulated at.

    Args:
        motors: a prior, a posterior or a fleet, which every episode draws from; motors, the same in every episode; or a
            function, which is tried once: of its motors the physics step is told.
        robot: that they drive.

    Raises:
        ConfigError: motors of another robot, of another number, or nothing of these.
    """
    count = robot.num_joints
    if isinstance(motors, MotorPrior):
        motors.require(robot.name, robot.physics_dt)
        return (lambda rng: motors.sample(count, rng, told_gains(motors, robot))), robot.physics_dt
    if isinstance(motors, MotorPosterior):
        motors.prior.require(robot.name, robot.physics_dt)
        ordered = _of_the_robot(motors, robot)
        return (lambda rng: ordered.sample(count, rng, told_gains(motors.prior, robot))), robot.physics_dt
    if isinstance(motors, Fleet):
        physics_dt = robot.physics_step(motors.kind.longest_step)
        return (lambda rng: motors.sample(count, rng, of_one_robot=True).actuator()), physics_dt
    draw = motors if callable(motors) else (lambda rng: motors)
    drawn = draw(np.random.default_rng(_TRIED))
    require_motors(drawn, count)
    return draw, robot.physics_step(drawn.kind.longest_step)


@dataclass(frozen=True)
class MotorChoice:
    """The motors of every episode."""

    actuator: ActuatorName = "prior"
    """prior: samples of a learned prior; pd: an ideal PD; fleet: physical motors (the oracle)."""
    prior: Path | None = None
    """Prior file, for the actuator prior."""
    posterior: Path | None = None
    """Posterior of one motor or of all the robot's, written by `motorprior adapt`: walk on those motors only."""
    fleet: str | None = None
    """Fleet of the physical motors, and of the PD's nominal gains: a name or a .toml file; the one shipped for the
    robot if not given. Where there is none, the PD's gains are those of the robot's description."""
    kp: float | None = None
    """PD gain [N·m/rad]; the nominal one if not given."""
    kd: float | None = None
    """PD gain [N·m·s/rad]; the nominal one if not given."""
    torque_limit: float | None = None
    """PD torque limit [N·m]; the nominal one if not given."""
    armature: float = 0.0
    """Reflected inertia of the PD's motors [kg·m²]."""
    delay: float = 0.0
    """Delay of the PD's target [s]."""
    coulomb: float = 0.0
    """Coulomb friction of the PD's motors [N·m], which must have armature."""
    spread: float = 0.0
    """Every constant of the PD is drawn anew for every motor and episode, uniformly within this share of itself; its
    delay within this share of 20 ms [-]."""
    latent_spread: float = 1.0
    """Factor on the standard deviation of z, for the actuator prior without a posterior: 0 is its mean motor [-]."""
    limit_follows_gain: bool = False
    """Each motor of a posterior has the prior's torque limit times its kp's share of the prior's central one: for a log
    that shows gains and no limit, of motors that give less torque per ampere."""
    name: str | None = None
    """What these motors are called in a study; by what they are if not given."""

    def physics_dt(self, robot: Robot) -> float:
        """The step [s] that these motors are simulated at, see `Robot.physics_step`."""
        if self.actuator != "fleet":
            return robot.physics_dt
        return robot.physics_step(load_robot_fleet(robot, self.fleet).kind.longest_step)

    def condition(self) -> str:
        """The name these motors have in a study: their own, else that of their model, or of the prior's preset."""
        if self.name is not None:
            return self.name
        if self.actuator == "fleet":
            return "oracle"
        if self.actuator == "pd":
            if self.spread:
                return "pd_randomised"
            if self.coulomb:
                return FRICTION_PD.name
            return "tuned_pd" if self.armature or self.delay else "ideal_pd"
        preset = MotorPrior.load(self.prior).preset if self.prior is not None else "prior"
        return preset if self.latent_spread == 1.0 else f"{preset}, z × {self.latent_spread:g}"

    def inputs(self, robot: Robot) -> list[Path]:
        """Files the choice depends on."""
        files = [self.prior, self.posterior] if self.actuator == "prior" else []
        fleet = fleet_files(robot, self.fleet) if self._has_fleet(robot) else []
        return [file for file in files if file is not None] + fleet

    def nominal(self, robot: Robot) -> IdealPd:
        """Gains that the robot's own motors run with: those of the fleet's center, or of the robot's description."""
        if not self._has_fleet(robot):
            return described_pd(robot)
        return nominal_pd(load_robot_fleet(robot, self.fleet), robot.num_joints)

    def _has_fleet(self, robot: Robot) -> bool:
        return self.fleet is not None or bool(robot.fleets) or self.actuator == "fleet"

    def drawer(self, robot: Robot) -> DrawMotors:
        """A function that draws the motors of an episode, one per joint.

        Raises:
            ConfigError: a prior is missing, or one was given for nothing, or a PD constant is out of range.
            ArtifactError: a file cannot be read.
        """
        for name, file in (("prior", self.prior), ("posterior", self.posterior)):
            if self.actuator != "prior" and file is not None:
                raise ConfigError(
                    f"actuator {self.actuator} has no use for a {name}", where=file, remedy="leave one of them out",
                    argument="actuator",
                )  # fmt: skip
        self._refuse_what_has_no_effect()
        if self.actuator == "fleet":
            return drawn_from(load_robot_fleet(robot, self.fleet), robot)[0]
        if self.actuator == "pd":
            return self._pd(robot)
        if self.prior is None:
            raise ConfigError(
                "actuator prior needs the file of a prior", remedy="identify one, or use another actuator",
                argument="actuator",
            )  # fmt: skip
        prior = load_prior(self.prior, robot)
        require_number("latent_spread", self.latent_spread, most=WIDEST_LATENT)
        gains, count = told_gains(prior, robot), robot.num_joints
        if self.posterior is None:
            return lambda rng: prior.sample(count, rng, gains, self.latent_spread)
        try:
            posterior = _of_the_robot(MotorPosterior.load(self.posterior, prior), robot)
            posterior.sample(count, 0, gains, self.limit_follows_gain)  # refuses now what it cannot do
        except ConfigError as error:
            raise ConfigError(error.problem, where=self.posterior, remedy=error.remedy) from error
        return lambda rng: posterior.sample(count, rng, gains, self.limit_follows_gain)

    def _refuse_what_has_no_effect(self) -> None:
        """Refuse numbers of a PD or a prior for motors that are none.

        Raises:
            ConfigError: names the number.
        """
        of_latents = _OF_A_PRIOR if self.posterior is None else _OF_A_POSTERIOR
        used = {"pd": _OF_A_PD, "prior": of_latents, "fleet": ()}[self.actuator]
        for field in fields(self):
            given = getattr(self, field.name)
            if field.name in _OF_SOME and field.name not in used and given != field.default:
                posterior = "" if self.actuator != "prior" else f" with{'' if self.posterior else 'out'} a posterior"
                raise ConfigError(
                    f"{field.name} {given:g} has no effect on actuator {self.actuator}{posterior}",
                    remedy="leave it out, or use another actuator", argument=field.name,
                )  # fmt: skip

    def _pd(self, robot: Robot) -> DrawMotors:
        nominal, changes = self.nominal(robot), {}
        for name, largest in _LARGEST_OF_A_PD.items():
            value = getattr(self, name)
            if value is not None:
                require_number(name, value, most=largest)
                changes[name] = np.full(robot.num_joints, float(value))
        require_number("delay", self.delay, most=LONGEST_DELAY)
        require_number("coulomb", self.coulomb, most=_LARGEST_OF_A_PD["torque_limit"])
        require_number("spread", self.spread, most=WIDEST)
        if self.coulomb and not self.armature:
            raise ConfigError(
                f"coulomb {self.coulomb:g} N·m without armature", argument="coulomb",
                remedy="give the PD's armature too: friction acts on the rotor",
            )  # fmt: skip
        model = replace(nominal, **changes, delay=np.full(robot.num_joints, float(self.delay)))
        coulomb = np.full(robot.num_joints, float(self.coulomb))
        return lambda rng: _spread_pd(model, coulomb, self.spread, rng)


def _spread_pd(model: IdealPd, coulomb: np.ndarray, spread: float, rng: np.random.Generator) -> Actuator:
    """The PD with every constant drawn, see `MotorChoice.spread`; without friction an ideal one."""
    if not spread:
        return FrictionPd(model, coulomb) if coulomb.any() else model

    def drawn(values: np.ndarray) -> np.ndarray:
        return values * rng.uniform(1.0 - spread, 1.0 + spread, len(values))

    constants = {field.name: drawn(getattr(model, field.name)) for field in fields(model) if field.name != "delay"}
    delay = rng.uniform(np.maximum(0.0, model.delay - spread * _LATE), model.delay + spread * _LATE)
    pd = IdealPd(**constants, delay=delay)
    return FrictionPd(pd, drawn(coulomb)) if coulomb.any() else pd


def _of_the_robot(posterior: MotorPosterior, robot: Robot) -> MotorPosterior:
    """Motors with the names of the robot's joints, in the robot's order; one motor, or those of a bench, as they are.

    Raises:
        ConfigError: of neither one motor nor the robot's number, or some names are not the robot's joints.
    """
    posterior.sample(robot.num_joints, 0)
    names = posterior.joint_names
    unknown = sorted(set(names) - set(robot.joint_names))
    if len(names) == 1 or names == bench_names(len(names)):
        return posterior
    if unknown:
        raise ConfigError(f"joints {unknown} are not {robot.name}'s", remedy=f"name them {list(robot.joint_names)}")
    order = [names.index(name) for name in robot.joint_names]
    return replace(
        posterior, mean=posterior.mean[order], covariance=posterior.covariance[order], joint_names=robot.joint_names,
        surprise=tuple(posterior.surprise[index] for index in order),
        gains=None if posterior.gains is None else posterior.gains[:, order],
    )  # fmt: skip
