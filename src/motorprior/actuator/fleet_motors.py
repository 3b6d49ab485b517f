"""The motors ``fleet``: samples of a fleet of physical motors, the oracle of a simulated robot."""

from motorprior.actuator.fleet import Fleet, load_robot_fleet
from motorprior.actuator.registry import EpisodeMotors, register
from motorprior.robots.robot import Robot


@register("fleet")
def fleet_motors(robot: Robot, fleet: str | Fleet | None = None) -> EpisodeMotors:
    """Motors of a fleet, given by name or .toml file; of the robot's own fleet if not given."""
    population = load_robot_fleet(robot, fleet)
    return EpisodeMotors(
        lambda rng: population.sample(robot.num_joints, rng, of_one_robot=True).actuator(),
        "oracle",
    )
