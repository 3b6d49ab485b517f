"""The motors ``prior``: samples of a learned prior."""

from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.registry import EpisodeMotors, register
from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot


@register("prior")
def prior_motors(
    robot: Robot,
    file: str | MotorPrior,
    latent_spread: float = 1.0,
    frozen: str = "",
    of_robot: str = "",
) -> EpisodeMotors:
    """Samples of a learned prior, given as a file, the name of a shipped card, or an object.

    Args:
        robot: the simulated robot.
        file: the prior.
        latent_spread: factor on the standard deviation of z [-]; 0 gives the mean motors.
        frozen: constants that all motors have from the mean motor: friction, delay, armature or
            gear.
        of_robot: the robot or bench of the prior, if this robot has the same motors.

    Raises:
        ConfigError: the prior does not fit the robot, or an option is out of range.
        ArtifactError: the file cannot be read.
    """
    require_number("latent_spread", latent_spread)
    prior = load_prior_for(robot, file, of_robot) if isinstance(file, str) else file
    prior.require(robot.name, robot.physics_dt)
    if frozen:
        prior = prior.with_frozen(frozen)

    condition = prior.preset
    if latent_spread != 1.0:
        condition = f"{condition}, z × {latent_spread:g}"
    return EpisodeMotors(
        lambda rng: prior.sample(robot, rng, spread=latent_spread), condition, prior
    )


def load_prior_for(robot: Robot, file: str, of_robot: str = "") -> MotorPrior:
    """Read the prior of a robot, or of the robot or bench ``of_robot``, which has the same motors.

    Raises:
        ConfigError: the prior is of another robot.
        ArtifactError: the file cannot be read.
    """
    prior = MotorPrior.load(file)
    if of_robot:
        if prior.robot != of_robot:
            raise ConfigError(
                f"of_robot={of_robot}, but the prior is of {prior.robot!r}",
                where=file,
                remedy="correct it",
            )
        prior = prior.for_robot(robot.name)

    try:
        prior.require(robot.name, robot.physics_dt)
    except ConfigError as error:
        raise ConfigError(error.problem, where=Path(file), remedy=error.remedy) from error
    return prior
