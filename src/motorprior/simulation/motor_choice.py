"""The motors of a simulated robot: one description, used by walk, transfer, simulate and the environments."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from motorprior.actuator.actuator import Actuator, require_motors
from motorprior.actuator.ideal_pd import FRICTION_PD, IdealPd, described_pd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import Fleet, fleet_files, load_robot_fleet, nominal_pd
from motorprior.bench.recording import bench_names
from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.identification.prior_file import load_prior, robot_gains
from motorprior.logs.motor_log import MotorLog, logged_gains_of
from motorprior.robots.robot import Robot
from motorprior.simulation.mujoco_backend import DrawMotors

ActuatorName: TypeAlias = Literal["prior", "pd", "fleet"]
ACTUATORS: tuple[ActuatorName, ...] = get_args(ActuatorName)
_USED_BY = {  # options of one kind of motors
    **dict.fromkeys(("kp", "kd", "torque_limit", "armature", "delay", "coulomb", "spread"), "actuator pd"),
    "latent_spread": "actuator prior without a posterior",
    "limit_follows_gain": "actuator prior with a posterior",
    **dict.fromkeys(("prior", "posterior"), "actuator prior"),
}
_MAX_DELAY = 1.0  # [s]; the delay line holds so many physics steps


def gains_for(prior: MotorPrior, robot: Robot, log: MotorLog) -> np.ndarray | None:
    """Gains in the log, if they are in the prior's unit; otherwise the robot's."""
    logged = logged_gains_of(log) if log.gain_unit == prior.network.gain_unit else None
    return robot_gains(prior, robot) if logged is None else logged


MotorSource: TypeAlias = MotorPrior | MotorPosterior | Fleet | Actuator | DrawMotors
"""A distribution of motors, fixed motors, or a function that draws motors."""


def motor_sampler(motors: MotorSource, robot: Robot) -> tuple[DrawMotors, float]:
    """A function that draws the motors of an episode, and their physics step [s].

    Args:
        motors: a prior, a posterior or a fleet, sampled for every episode; fixed motors; or a function of a generator,
            called once here to find the physics step.
        robot: with these motors.

    Raises:
        ConfigError: motors of another robot, of another number, or of an unknown type.
    """
    count = robot.num_joints
    if isinstance(motors, MotorPrior):
        motors.require(robot.name, robot.physics_dt)
        return (lambda rng: motors.sample(count, rng, robot_gains(motors, robot))), robot.physics_dt
    if isinstance(motors, MotorPosterior):
        motors.prior.require(robot.name, robot.physics_dt)
        ordered = _in_joint_order(motors, robot)
        return (lambda rng: ordered.sample(count, rng, robot_gains(motors.prior, robot))), robot.physics_dt
    if isinstance(motors, Fleet):
        physics_dt = robot.physics_step(motors.kind.max_step)
        return (lambda rng: motors.sample(count, rng, of_one_robot=True).actuator()), physics_dt
    draw = motors if callable(motors) else (lambda rng: motors)
    drawn = draw(np.random.default_rng(0))
    require_motors(drawn, count)
    return draw, robot.physics_step(drawn.kind.max_step)


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
    robot if not given. If there is none, the PD has the gains of the robot's description."""
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
    """Coulomb friction of the PD's motors [N·m]; it needs an armature."""
    spread: float = 0.0
    """Randomization of the PD: every constant is drawn for every motor and episode, uniformly within ± this share; the
    delay within ± this share of 20 ms [-]."""
    latent_spread: float = 1.0
    """Factor on the standard deviation of z, for the actuator prior without a posterior: 0 is its mean motor [-]."""
    limit_follows_gain: bool = False
    """Scale the torque limit of each motor of a posterior with its kp: for motors that give less torque per ampere,
    from a log that does not reach the limit."""
    name: str | None = None
    """Name of these motors in a study; that of their model if not given."""

    def physics_dt(self, robot: Robot) -> float:
        """Physics step [s] of these motors, see `Robot.physics_step`."""
        if self.actuator != "fleet":
            return robot.physics_dt
        return robot.physics_step(load_robot_fleet(robot, self.fleet).kind.max_step)

    def condition(self) -> str:
        """Name of these motors in a study."""
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
        """Files that the choice depends on."""
        files = [self.prior, self.posterior] if self.actuator == "prior" else []
        fleet = fleet_files(robot, self.fleet) if self._has_fleet(robot) else []
        return [file for file in files if file is not None] + fleet

    def nominal(self, robot: Robot) -> IdealPd:
        """PD gains of the robot's own motors: those of the fleet's center, or of the robot's description."""
        if not self._has_fleet(robot):
            return described_pd(robot)
        return nominal_pd(load_robot_fleet(robot, self.fleet), robot.num_joints)

    def _has_fleet(self, robot: Robot) -> bool:
        return self.fleet is not None or bool(robot.fleets) or self.actuator == "fleet"

    def sampler(self, robot: Robot) -> DrawMotors:
        """A function that draws the motors of an episode, one per joint.

        Raises:
            ConfigError: a prior is missing, an option has no effect on these motors, or a number is out of range.
            ArtifactError: a file cannot be read.
        """
        self._require_options()
        if self.actuator == "fleet":
            return motor_sampler(load_robot_fleet(robot, self.fleet), robot)[0]
        if self.actuator == "pd":
            return self._pd(robot)
        if self.prior is None:
            raise ConfigError(
                "actuator prior needs the file of a prior", remedy="identify one, or use another actuator",
                argument="actuator",
            )  # fmt: skip
        prior = load_prior(self.prior, robot)
        require_number("latent_spread", self.latent_spread)
        gains, count = robot_gains(prior, robot), robot.num_joints
        if self.posterior is None:
            return lambda rng: prior.sample(count, rng, gains, self.latent_spread)
        try:
            posterior = _in_joint_order(MotorPosterior.load(self.posterior, prior), robot)
            posterior.sample(count, 0, gains, self.limit_follows_gain)  # raise errors now, not in the first episode
        except ConfigError as error:
            raise ConfigError(error.problem, where=self.posterior, remedy=error.remedy) from error
        return lambda rng: posterior.sample(count, rng, gains, self.limit_follows_gain)

    def _require_options(self) -> None:
        used = {f"actuator {self.actuator}"}
        if self.actuator == "prior":
            used.add(f"actuator prior {'without' if self.posterior is None else 'with'} a posterior")
        for field in fields(self):
            needed = _USED_BY.get(field.name)
            if needed is not None and needed not in used and getattr(self, field.name) != field.default:
                raise ConfigError(
                    f"{field.name} has no effect: it is for {needed}", remedy="leave it out, or use other motors",
                    argument=field.name,
                )  # fmt: skip

    def _pd(self, robot: Robot) -> DrawMotors:
        changes = {}
        for name in ("kp", "kd", "torque_limit", "armature"):
            value = getattr(self, name)
            if value is not None:
                require_number(name, value)
                changes[name] = np.full(robot.num_joints, float(value))
        require_number("delay", self.delay, maximum=_MAX_DELAY)
        require_number("coulomb", self.coulomb)
        require_number("spread", self.spread, maximum=0.9)
        if self.coulomb and not self.armature:
            raise ConfigError(
                f"coulomb {self.coulomb:g} N·m without armature", argument="coulomb",
                remedy="give the PD's armature too: friction acts on the rotor",
            )  # fmt: skip
        model = replace(self.nominal(robot), **changes, delay=np.full(robot.num_joints, float(self.delay)))
        coulomb = np.full(robot.num_joints, float(self.coulomb))
        return lambda rng: _randomized_pd(model, coulomb, self.spread, rng)


def _randomized_pd(model: IdealPd, coulomb: np.ndarray, spread: float, rng: np.random.Generator) -> Actuator:
    if not spread:
        return replace(model, coulomb=coulomb)

    def drawn(values: np.ndarray) -> np.ndarray:
        return values * rng.uniform(1.0 - spread, 1.0 + spread, len(values))

    constants = {field.name: drawn(getattr(model, field.name)) for field in fields(model)[:4]}
    late = 0.02 * spread  # not a share of the delay, which may be 0
    delay = rng.uniform(np.maximum(0.0, model.delay - late), model.delay + late)
    return IdealPd(**constants, delay=delay, coulomb=drawn(coulomb) if coulomb.any() else coulomb)


def _in_joint_order(posterior: MotorPosterior, robot: Robot) -> MotorPosterior:
    """Motors sorted by name in the order of the robot's joints; one motor, or those of a bench, are unchanged.

    Raises:
        ConfigError: neither one motor nor the robot's number, or a name that is not a joint of the robot.
    """
    posterior.sample(robot.num_joints, 0)
    names = posterior.joint_names
    if len(names) == 1 or names == bench_names(len(names)):
        return posterior
    if unknown := sorted(set(names) - set(robot.joint_names)):
        raise ConfigError(f"joints {unknown} are not {robot.name}'s", remedy=f"name them {list(robot.joint_names)}")
    order = [names.index(name) for name in robot.joint_names]
    return replace(
        posterior, mean=posterior.mean[order], covariance=posterior.covariance[order], joint_names=robot.joint_names,
        outlier_p_value=tuple(posterior.outlier_p_value[index] for index in order),
        gains=None if posterior.gains is None else posterior.gains[:, order],
    )  # fmt: skip
