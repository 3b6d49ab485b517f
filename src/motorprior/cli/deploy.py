"""``motorprior deploy``: walk a robot with a policy."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.cli.robot_choice import RobotChoice
from motorprior.hardware.settings import DeploySettings, require_robot_extra
from motorprior.locomotion.policy import Policy
from motorprior.robots.load import load_robot


@dataclass(frozen=True)
class Deploy:
    """Walk a robot: check, arm, stand up, walk, sit down, record."""

    policy: tyro.conf.Positional[Path]
    """Policy that `motorprior walk` wrote."""
    choice: Annotated[RobotChoice, tyro.conf.arg(name="")] = field(default_factory=RobotChoice)
    """The robot."""
    settings: Annotated[DeploySettings, tyro.conf.arg(name="")] = field(default_factory=DeploySettings)
    """How to walk."""


def run_deploy_command(config: Deploy) -> None:
    """Deploy, and print the timing of the control loop.

    Raises:
        ConfigError: pyserial or msgpack is not installed.
        ConfigError, ArtifactError, RobotFault: see `hardware.commands.run_deploy`.
    """
    require_robot_extra()
    from motorprior.hardware.commands import run_deploy
    from motorprior.hardware.teleop import non_blocking

    Policy.load(config.policy)  # an error comes before a virtual robot is started
    show = non_blocking(TERMINAL.note, sys.stderr)
    with config.choice.open() as port:
        results = run_deploy(load_robot(config.choice.kind), config.policy, port, config.settings, show)
    if results:
        rows = [[name, f"{value:.3f}"] for name, value in results.to_figures().items()]
        table("Control loop", ["figure", "value"], rows)
