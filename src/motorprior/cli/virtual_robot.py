"""``motorprior virtual-robot``: a virtual robot on a pseudo-terminal."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from motorprior.artifacts import write_json
from motorprior.cli.console import TERMINAL
from motorprior.pipeline.virtual.virtual_robot import Virtual, serve
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class VirtualRobotCommand:
    """A virtual robot on a pseudo-terminal, to deploy to and record from."""

    robot: Virtual = field(default_factory=Virtual)
    """The robot."""
    link: Path | None = None
    """Path of a symbolic link to the pseudo-terminal."""
    json: Path | None = None
    """File for the robot's statistics, written at its end."""
    seconds: float | None = None
    """Lifetime [s]; until Ctrl-C if not given."""
    with_parent: bool = False
    """End with the process that started it, however that ends."""
    kind: str = DEFAULT_ROBOT
    """Which robot: a shipped one by name."""


def run_virtual_robot(config: VirtualRobotCommand) -> None:
    """Run until Ctrl-C, or for ``seconds``."""
    life = serve(load_robot(config.kind), config.robot, config.link, config.seconds, config.with_parent, TERMINAL)
    if config.json is not None:
        write_json(config.json, life)
