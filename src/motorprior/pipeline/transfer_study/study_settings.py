"""What a study is told, and what it refuses."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path

from motorprior.bench.facts import require_bench_size
from motorprior.bench.fleet import Fleet, load_fleet
from motorprior.bounds import require_count, require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.pipeline.motor_choice import WIDEST, WIDEST_LATENT, load_robot_fleet
from motorprior.pipeline.walking.walk import MOST_EPISODE_STEPS, MOST_WORKERS
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.executor import Kind, require_executor
from motorprior.transfer.study_verdicts import CONDITIONS, PD_RANDOMISED

FITS, SPREADS = "fits.json", "spreads.json"
"""Names of files: what the PDs took, in the folder fits; the widths that were tried, in the folder spreads."""
AGAIN = "delete it and run the study again"
"""Remedy of a damaged file in a study's folder."""
_FASTER = 1.5
"""Commanded speed, of the robot's usual fastest."""
_QUICK = {
    "seeds": 2, "draws": 4, "seconds": 6.0, "iterations": 8, "bench_steps": 4000, "adam_steps": 200, "spread": 0.2,
}  # fmt: skip
_QUICK_MOTORS = 16
"""Or more, if the robot has more joints."""
_FLEETS = ("mixed", "foreign_servo", "foreign_direct")
"""The first of these that is the robot's and no twin's decides which policies are kept, and the width of the
randomised PD."""
OWN_MOTORS = "own"
"""In place of a validation fleet: policies are kept by how they walk on the motors of their training."""
_MOST_SEEDS = 900
"""Policies from this number on are those that choose the width of the randomised PD, see `study_spreads`."""


@dataclass(frozen=True)
class Study:
    """Train on every model of a bench's motors, with several seeds; watch on four twins; decide."""

    out: Path
    """Run folder."""
    fleet: str | None = None
    """Population of the bench's motors and of the first twin; the robot's own if not given."""
    foreign: str = "foreign_direct"
    """Population of the twins with motors of another family."""
    conditions: tuple[str, ...] = CONDITIONS
    """What policies are trained on; targets about others cannot be told."""
    seeds: int = 8
    """Policies per condition."""
    draws: int = 32
    """Walks of each policy at each place."""
    seconds: float = 10.0
    """Of a walk [s]."""
    speed: float | None = None
    """Commanded straight on, in training and at every place [m/s]; if not given, half as fast again as the robot
    usually walks: slower, its gait does most of the walking, whatever the motors."""
    iterations: int = 50
    """ARS iterations per policy, the same for every condition."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose motors it is decided which policy of a search is kept. None of the
    twins': if not given, the first of the robot's fleets that no twin has. Where there is none, or `own` is given, the
    motors of training decide."""
    spread: float | None = None
    """Width of the randomised PD: the share by which its constants vary [-]; if not given, policies of several widths
    walk on the validation fleet, and the best one is kept."""
    latent_spread: float = 1.0
    """Factor on the standard deviation of z where motors are drawn from the prior [-]; 1 is as far as the bench's
    motors differ. The paper's priors and the adapted one keep 1."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    seed: int = 0
    """Of the bench and the priors; policies of different studies share no search seed."""
    quick: bool = False
    """Minutes instead: 2 seeds, 4 walks of 6 s, 8 iterations, a bench of 16 motors and 4000 samples, 200 Adam steps,
    a width of 0.2. A number that you give is kept, unless it is the full study's default. It decides nothing."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; with the executor ray, walks of one policy at a time. The result does not depend on it."""
    executor: Kind = "threads"
    """Threads of this process, one policy after the other, or walks on Ray's processes."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray; without one Ray starts on this machine only."""

    def told(self, robot: Robot) -> float:
        """Speed that is commanded [m/s]."""
        return _FASTER * robot.require_legs().forward[1] if self.speed is None else self.speed

    def commands(self, robot: Robot) -> Commands:
        """What a policy is told, in training and wherever it walks."""
        return Commands.steady(self.told(robot))

    def fleet_of_contests(self, robot: Robot) -> str | None:
        """Fleet on whose motors it is decided which policy of a search is kept; None: on those of its training."""
        return None if self.validation == OWN_MOTORS else self._fleet_of_no_twin(robot)

    def fleet_for_width(self, robot: Robot) -> str:
        """Fleet on whose motors the width of the randomised PD is chosen.

        Raises:
            ConfigError: none is given, and none of ours is of this robot.
        """
        fleet = self._fleet_of_no_twin(robot)
        if fleet is None:
            raise ConfigError(
                f"the width of {PD_RANDOMISED} is chosen on a fleet of {robot.name!r} that no twin has, and none is "
                "known", argument="validation", remedy="give such a fleet as validation, or the width as spread",
            )  # fmt: skip
        return fleet

    def _fleet_of_no_twin(self, robot: Robot) -> str | None:
        """The one that is given, or the first of ours."""
        if self.validation not in (None, OWN_MOTORS):
            return self.validation
        twins = [fleet.name for fleet in self._fleets_of_twins(robot)]
        ours = (name for name in _FLEETS if name not in twins and load_fleet(name).robot == robot.name)
        return next(ours, None)

    def _fleets_of_twins(self, robot: Robot) -> tuple[Fleet, Fleet]:
        """Whose motors the twins have, on which nothing may be chosen."""
        return load_robot_fleet(robot, self.fleet), load_robot_fleet(robot, self.foreign)

    def _require_unlike_fleets(self, robot: Robot) -> None:
        """Refuse foreign motors that are not foreign, and a validation on motors of a twin."""
        own, foreign = self._fleets_of_twins(robot)
        if replace(own, name=foreign.name) == foreign:
            raise ConfigError(
                f"foreign {self.foreign!r} has the motors of the bench's fleet", argument="foreign",
                remedy="give a fleet of other motors: these twins ask what transfers to motors unlike the bench's",
            )  # fmt: skip
        if self.validation in (None, OWN_MOTORS):
            return
        told = load_robot_fleet(robot, self.validation)
        if any(replace(told, name=fleet.name) == fleet or told.name == fleet.name for fleet in (own, foreign)):
            raise ConfigError(
                f"validation {self.validation!r} is the fleet of a twin", argument="validation",
                remedy="give another fleet: what a policy is judged on must not choose it",
            )  # fmt: skip

    @property
    def chooses_width(self) -> bool:
        """Whether it has a randomised PD and is not told its width."""
        return self.spread is None and PD_RANDOMISED in self.conditions

    @property
    def episodes_at_a_time(self) -> int:
        """Of one policy; threads have one each."""
        return self.workers if self.executor == "ray" else 1

    def _quicker(self) -> Study:
        """With the numbers of a quick study in place of the defaults."""
        few = _QUICK | {"motors": max(_QUICK_MOTORS, load_robot(self.robot).num_joints)}
        defaults = {field.name: field.default for field in fields(self)}
        return replace(self, **{name: few[name] for name in few if getattr(self, name) == defaults[name]})

    def sized(self) -> Study:
        """With the numbers of a quick study if it is one.

        Raises:
            MotorPriorError: names the setting that is out of range.
        """
        config = self._quicker() if self.quick else self
        _require_conditions(config.conditions)
        robot = load_robot(config.robot)
        robot.require_legs()
        for name, most in (("seeds", _MOST_SEEDS), ("draws", MOST_EPISODE_STEPS), ("iterations", MOST_EPISODE_STEPS)):
            require_count(name, getattr(config, name), 1, most)
        if config.adam_steps is not None:
            require_count("adam_steps", config.adam_steps)
        require_number("seconds", config.seconds, 2.0, MOST_EPISODE_STEPS * robot.control_dt)
        require_number("speed", config.told(robot), robot.require_legs().forward[1] * 0.5, 10.0)
        if config.spread is not None:
            require_number("spread", config.spread, 0.0, WIDEST)
        require_number("latent_spread", config.latent_spread, most=WIDEST_LATENT)
        require_count("workers", config.workers, 1, MOST_WORKERS)
        require_count("motors", config.motors, robot.num_joints)
        require_bench_size(config.motors, config.bench_steps, "bench_steps")
        require_seed(config.seed)
        require_executor(config.executor, config.ray_address)
        config._require_unlike_fleets(robot)
        if config.chooses_width:
            config.fleet_for_width(robot)
        return config


def _require_conditions(names: tuple[str, ...]) -> None:
    """Refuse none at all, and names that are no conditions'."""
    unknown = [name for name in names if name not in CONDITIONS]
    if unknown or not names:
        raise ConfigError(
            f"no condition {unknown[0]!r}" if unknown else "conditions are missing", argument="conditions",
            remedy=f"use some of {', '.join(CONDITIONS)}",
        )  # fmt: skip
