"""Settings of the transfer study."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path

from motorprior.bench.fleet import load_fleet, load_robot_fleet
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import Kind, require_executor
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.studies.summary import CONDITIONS

OWN_MOTORS = "own"  # as validation: select on the training motors
_QUICK = {
    "seeds": 2, "draws": 4, "seconds": 6.0, "iterations": 8, "bench_steps": 4000, "adam_steps": 200, "spread": 0.2,
}  # fmt: skip
_VALIDATION_FLEETS = ("mixed", "foreign_servo", "foreign_direct")


@dataclass(frozen=True)
class Study:
    """Train on each model of a bench's motors, with several seeds, and evaluate on held-out robots."""

    out: Path
    """Run folder."""
    fleet: str | None = None
    """Population of the bench's motors and of the environment `fleet`; the robot's own if not given."""
    foreign: str = "foreign_direct"
    """Out-of-family population, of the environments `foreign` and `hard`."""
    conditions: tuple[str, ...] = CONDITIONS
    """Training conditions."""
    seeds: int = 8
    """Policies per condition."""
    draws: int = 32
    """Walks of each policy per environment."""
    seconds: float = 10.0
    """Duration of a walk [s]."""
    speed: float | None = None
    """Commanded forward speed in training and evaluation [m/s]; 1.5 times the robot's usual maximum if not given: at
    lower speeds the plain gait walks on any motors."""
    iterations: int = 50
    """ARS iterations per policy."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose motors the best policy of a search is selected; no test environment uses
    it. The first of the robot's other fleets if not given; `own`: the training motors."""
    spread: float | None = None
    """Relative range of the randomised PD [-]; selected on the validation fleet if not given."""
    latent_spread: float = 1.0
    """Factor on the standard deviation of z of the sampled priors [-]."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    seed: int = 0
    """Seed of the bench and the priors; policies of different studies share no search seed."""
    quick: bool = False
    """A smoke test in minutes: 2 seeds, 4 walks of 6 s, 8 iterations, a small bench."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; with the executor ray, walks of one policy at a time. The result does not depend on it."""
    executor: Kind = "threads"
    """Threads of this process, or walks on Ray's processes."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray."""

    def commanded(self, robot: Robot) -> float:
        """Commanded speed [m/s]."""
        return 1.5 * robot.require_legs().forward[1] if self.speed is None else self.speed

    def commands(self, robot: Robot) -> Commands:
        """Commands of every episode."""
        return Commands.steady(self.commanded(robot))

    def validation_fleet(self, robot: Robot) -> str | None:
        """Fleet on whose motors policies are selected; None: the training motors."""
        if self.validation is not None:
            return None if self.validation == OWN_MOTORS else self.validation
        return self.range_fleet(robot)

    def range_fleet(self, robot: Robot) -> str | None:
        """Fleet that no test environment uses, on which the range of the randomised PD is selected."""
        if self.validation not in (None, OWN_MOTORS):
            return self.validation
        used = {load_robot_fleet(robot, name).name for name in (self.fleet, self.foreign)}
        others = (name for name in _VALIDATION_FLEETS if name not in used and load_fleet(name).robot == robot.name)
        return next(others, None)

    @property
    def episodes_at_a_time(self) -> int:
        """Walks of one policy at a time; one per thread."""
        return self.workers if self.executor == "ray" else 1

    def sized(self) -> Study:
        """Checked settings, with the sizes of a quick study if ``quick``.

        Raises:
            ConfigError: names the invalid setting.
        """
        config, robot = self, load_robot(self.robot)
        if self.quick:
            few = _QUICK | {"motors": max(16, robot.num_joints)}
            defaults = {field.name: field.default for field in fields(self)}
            config = replace(self, **{name: few[name] for name in few if getattr(self, name) == defaults[name]})
        if unknown := [name for name in config.conditions if name not in CONDITIONS]:
            remedy = f"use some of {', '.join(CONDITIONS)}"
            raise ConfigError(f"no condition {unknown[0]!r}", argument="conditions", remedy=remedy)
        robot.require_legs()
        for name in ("seeds", "draws", "iterations", "workers"):
            require_count(name, getattr(config, name))
        require_count("motors", config.motors, robot.num_joints)
        require_executor(config.executor, config.ray_address)
        own, foreign = load_robot_fleet(robot, config.fleet), load_robot_fleet(robot, config.foreign, "foreign")
        if config.validation not in (None, OWN_MOTORS):
            load_robot_fleet(robot, config.validation, "validation")
        if replace(own, name=foreign.name) == foreign or config.validation in (own.name, foreign.name):
            problem = "fleet, foreign and validation must be three different fleets"
            raise ConfigError(problem, argument="foreign", remedy="change one of them")
        if config.spread is None and "pd_randomised" in config.conditions and config.range_fleet(robot) is None:
            problem = f"no fleet of {robot.name!r} to select the range of pd_randomised on"
            raise ConfigError(problem, argument="validation", remedy="give a validation fleet, or a spread")
        return config
