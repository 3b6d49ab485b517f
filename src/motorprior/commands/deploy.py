"""Run a policy on a robot."""

from dataclasses import dataclass, field
from pathlib import Path

from motorprior.commands.robot_port import RobotChoice, messages, opened_port
from motorprior.hardware.settings import DeploySettings, require_robot_extra
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Deploy(DeploySettings, RobotChoice):
    """Run a policy on a robot."""

    policy: Path = field(kw_only=True)
    """Policy that `motorprior walk` wrote."""


def run_deploy(config: Deploy, progress: Progress = SILENT) -> None:
    """Walk until the robot is stopped; errors as `hardware.runs.deploy`."""
    require_robot_extra()
    from motorprior.hardware.runs import deploy  # here: it needs the extra robot
    from motorprior.locomotion.policy import Policy  # here: it imports numba, help needs none

    robot = load_robot(DEFAULT_ROBOT)
    Policy.load(config.policy)  # an error comes before a virtual robot is started
    with opened_port(robot, config) as port:
        deploy(robot, config.policy, port, config, messages(progress))
