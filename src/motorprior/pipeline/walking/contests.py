"""Where the contests of a training are walked, which decide which policy is kept: at home, or on a fleet's motors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.pipeline.motor_choice import drawn_from, load_robot_fleet
from motorprior.robots.robot import Robot
from motorprior.search.executor import Executor, Kind, make_executor, many_executors
from motorprior.simulation.engines import Scene
from motorprior.simulation.mujoco_backend import DrawMotors


def validation_motors(validation: Fleet | str | Path, robot: Robot) -> tuple[DrawMotors, float]:
    """What draws the motors of contests from a validation fleet, and the physics step [s] that they need.

    Raises:
        ArtifactError, ConfigError: there is none, or it is another robot's.
    """
    try:
        return drawn_from(load_robot_fleet(robot, validation), robot)
    except (ArtifactError, ConfigError) as error:
        problem = f"validation: {error.problem}"
        raise type(error)(problem, where=error.where, remedy=error.remedy, argument="validation") from error


def is_of_the_twin(validation: Fleet | str | Path, robot: Robot) -> bool:
    """Whether a validation fleet is the one from which twins of this robot draw their motors by default."""
    return bool(robot.fleets) and load_robot_fleet(robot, validation).name == robot.default_fleet


NO_JUDGE = (
    "note: validation is on the fleet of the twin, which says less of a policy that was kept for how it walks there: "
    "judge it on another fleet, or validate on another"
)
"""For who trains with a fleet that `is_of_the_twin`."""


@contextmanager
def executors(
    scenes: list[Scene], workers: int, kind: Kind = "threads", address: str | None = None
) -> Iterator[tuple[Executor, Executor]]:
    """Where candidates walk, and where contests are walked.

    Args:
        scenes: of the candidates, and of the contests where they are walked on other motors.
        workers: episodes at a time.
        kind: see `make_executor`.
        address: see `make_executor`.
    """
    with ExitStack() as stack:
        if len(scenes) > 1:
            stack.enter_context(many_executors(kind, workers, address))
        made = [
            stack.enter_context(closing(make_executor(scene.simulator, workers, kind, address))) for scene in scenes
        ]
        yield made[0], made[-1]
