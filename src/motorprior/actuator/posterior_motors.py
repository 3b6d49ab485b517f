"""The motors ``posterior``: samples of the posterior of the motors in a log."""

from dataclasses import replace

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior, robot_gains
from motorprior.actuator.prior_motors import load_prior_for
from motorprior.actuator.registry import EpisodeMotors, register
from motorprior.exceptions import ConfigError
from motorprior.logs.bench_names import bench_names
from motorprior.robots.robot import Robot


@register("posterior")
def posterior_motors(
    robot: Robot,
    file: str,
    prior: str,
    limit_follows_gain: bool = False,
    prior_share: float = 0.0,
    latent_spread: float = 1.0,
    of_robot: str = "",
) -> EpisodeMotors:
    """Samples of the posterior of one motor, or of all motors of the robot.

    Args:
        robot: the simulated robot.
        file: the posterior.
        prior: file or card of the prior that the posterior belongs to.
        limit_follows_gain: scale the torque limit of each motor with its kp. Use it for motors that
            give less torque per ampere, if the log does not reach the limit.
        prior_share: share of the prior's standard deviation of z, in addition to the posterior's
            [-].
        latent_spread: factor on the standard deviation of z [-]; 0 gives the mean motors.
        of_robot: the robot or bench of the prior, if this robot has the same motors.

    Raises:
        ConfigError: the posterior does not fit the robot or the prior, or an option is out of
            range.
        ArtifactError: a file cannot be read.
    """
    prior_of_robot = load_prior_for(robot, prior, of_robot)
    try:
        # the digest in the file is that of the prior before `MotorPrior.for_robot`
        posterior = MotorPosterior.load(file, MotorPrior.load(prior))
        posterior = replace(posterior, prior=prior_of_robot)
        return motors_of_posterior(robot, posterior, limit_follows_gain, prior_share, latent_spread)
    except ConfigError as error:
        raise ConfigError(error.problem, where=file, remedy=error.remedy) from error


def motors_of_posterior(
    robot: Robot,
    posterior: MotorPosterior,
    limit_follows_gain: bool = False,
    prior_share: float = 0.0,
    latent_spread: float = 1.0,
) -> EpisodeMotors:
    """Samples of a posterior, in the order of the robot's joints; options as `posterior_motors`.

    Motors of a bench have no names on the robot and stay in their order.
    """
    posterior.prior.require(robot.name, robot.physics_dt)
    gains = robot_gains(posterior.prior, robot)
    num_joints = robot.num_joints
    options = (limit_follows_gain, prior_share, latent_spread)
    # raises its errors now, not in the first episode
    posterior.sample(num_joints, 0, gains, *options)

    names = posterior.joint_names
    if len(names) > 1 and names != bench_names(len(names)):
        unknown_names = sorted(set(names) - set(robot.joint_names))
        if unknown_names:
            raise ConfigError(
                f"joints {unknown_names} are not {robot.name}'s",
                remedy=f"name them {list(robot.joint_names)}",
            )
        posterior = posterior.take([names.index(name) for name in robot.joint_names])
    return EpisodeMotors(
        lambda rng: posterior.sample(num_joints, rng, gains, *options),
        f"{posterior.prior.preset}, adapted",
        posterior.prior,
    )
