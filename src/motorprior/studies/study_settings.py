"""Training conditions and settings of the transfer study."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from motorprior.actuator.fleet import load_fleet, load_robot_fleet
from motorprior.actuator.motor_prior import FROZEN
from motorprior.bounds import require_count, require_number
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import IDEAL_PD, WITH_FRICTION, WITH_ROTOR
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import ExecutorName, require_executor
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.studies.environments import ENVIRONMENTS, NOISY, OUT_OF_FAMILY

VALIDATION = "validation"  # population of the validation fleet
_VALIDATION_FLEETS = ("mixed", "foreign_servo", "foreign_direct")
# PDs by name -> their fitted constants
PDS = {"gains": IDEAL_PD, "rotor": WITH_ROTOR, "friction": WITH_FRICTION}
# sensor noise of the environments, and pushes: without any disturbance policies overfit one
# deterministic walk, and fall more often on held-out robots
TRAINING = replace(NOISY, push=0.3, push_interval=1.0)


@dataclass(frozen=True)
class Condition:
    """A training condition: the motors of trainings, and what else differs between them.

    The motors are a PD or a prior, fitted to the bench or to the log of one robot, or the fleet.
    """

    pd: str = ""  # name in PDS
    prior: str = ""  # preset of the prior
    motors: str = ""  # text of motors, as of `walk`; the same for both populations
    adapted: bool = False  # to the log of one robot, the only robot that the policy walks on
    options: Mapping[str, float | str] = field(default_factory=dict)  # of the motors
    randomization: Randomization = TRAINING  # of the training, in addition to the motors
    iterations: int | None = None  # largest number of iterations; the study's if None

    @property
    def per_population(self) -> bool:
        """Whether it is trained for, and evaluated on, the motors of one population."""
        return self.adapted or not (self.pd or self.prior or self.motors)


# training conditions in the order of every table, see docs/transfer.md
CONDITIONS = {
    "ideal_pd": Condition(pd="gains"),
    "tuned_pd": Condition(pd="rotor"),
    "friction_pd": Condition(pd="friction"),
    "random_pd": Condition(pd="friction"),
    "adapted_pd": Condition(pd="friction", adapted=True),
    "paper": Condition(prior="paper"),
    "paper_wide": Condition(prior="paper_wide"),
    "central_motor": Condition(prior="rollout", options={"latent_spread": 0.0}),
    "sampled_prior": Condition(prior="rollout"),
    "adapted_prior": Condition(prior="rollout", adapted=True),
    "robust_prior": Condition(prior="rollout", randomization=ROBUST),
    "oracle": Condition(),
}
STANDARD = tuple(CONDITIONS)

# the sampled prior with the mean motor's values of some constants, and with fewer iterations
CONDITIONS |= {
    f"frozen_{group}": Condition(prior="rollout", options={"frozen": group}) for group in FROZEN
}
# the mean motors of the adapted prior's posterior, without its spread
CONDITIONS["adapted_motors"] = Condition(
    prior="rollout", adapted=True, options={"latent_spread": 0.0}
)
CONDITIONS["short_training"] = Condition(prior="rollout", iterations=70)


def condition_of(name: str) -> Condition:
    """The training condition of this name; another name is a text of motors."""
    return CONDITIONS[name] if name in CONDITIONS else Condition(motors=name)


_COUNTS = ("benches", "seeds", "walks", "iterations", "directions", "bench_steps", "workers")
_OPTIONAL_COUNTS = ("oracle_seeds", "robots", "patience")
_MAX_PD_RANGE = 0.9
SHORT_ITERATIONS = 40  # largest number of iterations of the conditions `Study.short`


@dataclass(frozen=True)
class Study:
    """Train on each model of a bench's motors, with several seeds; evaluate on held-out robots."""

    out: Path
    """Run folder."""
    fleet: str | None = None
    """Fleet of the motors on the bench and in the environment `fleet`; the robot's fleet if not
    given."""
    out_of_family: str = "foreign_direct"
    """Fleet of the out-of-family motors, in the environments `out_of_family` and
    `hard_out_of_family`."""
    conditions: tuple[str, ...] = STANDARD
    """Training conditions: names of docs/transfer.md, or other motors, as for `walk --motors`."""
    environments: tuple[str, ...] = tuple(ENVIRONMENTS)
    """Environments of the evaluation: names of docs/transfer.md."""
    benches: int = 4
    """Number of benches, each with its own motors, robots, floors and pushes; bench k has the seed
    `seed` + k."""
    seeds: int = 4
    """Policies per condition and bench."""
    oracle_seeds: int | None = None
    """Policies of the oracle per bench, which take longer, as their physics step is shorter;
    `seeds` if not given."""
    short: tuple[str, ...] = ()
    """Training conditions with one policy per bench, trained for at most 40 iterations: enough to
    show that policies of a condition do not walk in their own simulation."""
    walks: int = 32
    """Walks of each policy per environment."""
    robots: int | None = None
    """Number of robots of each population to which the prior and a PD are adapted; one per policy
    if not given. Policy k is trained for robot k modulo this number."""
    seconds: float = 10.0
    """Duration of a walk [s]."""
    speed: float | None = None
    """Commanded forward speed in training and evaluation [m/s]; 1.5 times the robot's usual maximum
    if not given. At lower speeds the untrained gait walks with any motors."""
    iterations: int = 200
    """Largest number of ARS iterations per policy."""
    patience: int | None = 3
    """A training ends once the mean training return of 20 iterations has not reached a new maximum
    this many times in a row; None never ends it early."""
    directions: int = 8
    """ARS directions per iteration."""
    validation: str | None = None
    """Validation fleet: a name or a .toml file. The best policy of a search, the range of the
    randomised PD and the share of the adapted prior are selected on its motors. No test environment
    may use it. If not given, the first fleet of the robot that no test environment uses."""
    pd_range: float | None = None
    """Relative range of the randomised PD [-]; selected on the validation fleet if not given."""
    prior_share: float | None = None
    """Share of the prior's standard deviation that the adapted prior's motors have in addition to
    the posterior's [-]; selected on the validation fleet if not given."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor."""
    adam_steps: int | None = None
    """Adam steps of each identification; the number of its preset if not given."""
    seed: int = 0
    """Seed of the first bench and its priors. Policies of different benches have different search
    seeds."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of policies at a time; with the executor ray, number of walks of one policy at a time.
    The result does not depend on it."""
    executor: ExecutorName = "threads"
    """Policies run in threads of this process, or their walks run in Ray processes."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray."""

    @property
    def commanded(self) -> float:
        """Commanded speed [m/s].

        Without a given speed it follows from the robot's range of speeds, not from a policy's.
        """
        if self.speed is not None:
            return self.speed
        _, max_speed = load_robot(self.robot).require_gait().forward
        return 1.5 * max_speed

    @property
    def commands(self) -> Commands:
        """Commands of every episode."""
        return Commands.steady(self.commanded)

    def fleet_of(self, population: str) -> str | None:
        """The fleet of a population."""
        if population == VALIDATION:
            return self.validation_fleet(load_robot(self.robot))
        return self.out_of_family if population == OUT_OF_FAMILY else self.fleet

    def seeds_of(self, condition: str) -> range:
        """Seeds of the policies of a training condition."""
        if condition in self.short:
            return range(1)
        if condition == "oracle" and self.oracle_seeds:
            return range(self.oracle_seeds)
        return range(self.seeds)

    @property
    def fitted(self) -> list[Condition]:
        """Training conditions with a model that is fitted to logs."""
        conditions = [CONDITIONS[name] for name in self.conditions if name in CONDITIONS]
        return [condition for condition in conditions if condition.pd or condition.prior]

    def robot_number(self, seed: int) -> int:
        """Number of the robot that the adapted policies of a seed walk on."""
        return seed % self.robots if self.robots else seed

    def of_benches(self) -> list[Self]:
        """The settings of every bench, with its folder and its seed."""
        benches = []
        for seed in range(self.seed, self.seed + self.benches):
            out = self.out / f"bench_{seed}"
            benches.append(replace(self, out=out, seed=seed, benches=1))
        return benches

    def validation_fleet(self, robot: Robot) -> str | None:
        """Fleet that no test environment uses, on which policies are selected.

        None: they are selected on the training motors.
        """
        if self.validation is not None:
            return self.validation
        test_fleets = self._test_fleets(robot)
        for name in _VALIDATION_FLEETS:
            if name not in test_fleets and load_fleet(name).robot == robot.name:
                return name
        return None

    def _test_fleets(self, robot: Robot) -> set[str]:
        """Names of the fleets of the test environments."""
        fleets = {load_robot_fleet(robot, self.fleet, "fleet").name}
        if self._tests_out_of_family:
            fleets.add(load_robot_fleet(robot, self.out_of_family, "out_of_family").name)
        return fleets

    @property
    def _tests_out_of_family(self) -> bool:
        """Whether an environment has out-of-family motors."""
        return any(ENVIRONMENTS[name].population == OUT_OF_FAMILY for name in self.environments)

    @property
    def episodes_at_a_time(self) -> int:
        """Walks of one policy at a time; one per thread."""
        return self.workers if self.executor == "ray" else 1

    def require_valid(self) -> None:
        """Check the settings; raises `ConfigError`, which names the invalid one."""
        robot = load_robot(self.robot)
        self._require_conditions(robot)
        self._require_environments()
        robot.require_gait()
        self._require_numbers(robot)
        require_executor(self.executor, self.ray_address)
        self._require_fleets(robot)

    def _require_conditions(self, robot: Robot) -> None:
        for name in self.conditions:
            if name in CONDITIONS:
                continue
            try:
                simulated_motors(name, robot)
            except ConfigError as error:
                raise ConfigError(
                    f"no condition {name!r}",
                    argument="conditions",
                    remedy=f"use some of {', '.join(CONDITIONS)}, or motors as of `walk`",
                ) from error

    def _require_environments(self) -> None:
        unknown = set(self.environments) - set(ENVIRONMENTS)
        if unknown:
            raise ConfigError(
                f"no environments {sorted(unknown)}",
                argument="environments",
                remedy=f"use some of {', '.join(ENVIRONMENTS)}",
            )

    def _require_numbers(self, robot: Robot) -> None:
        for name in _COUNTS:
            require_count(name, getattr(self, name))
        for name in _OPTIONAL_COUNTS:
            count = getattr(self, name)
            if count is not None:
                require_count(name, count)

        require_number("seconds", self.seconds, robot.control_dt)
        if self.pd_range is not None:
            require_number("pd_range", self.pd_range, 0.0, _MAX_PD_RANGE)
        if self.prior_share is not None:
            require_number("prior_share", self.prior_share, 0.0, 1.0)
        require_count("motors", self.motors, robot.num_joints)

    def _require_fleets(self, robot: Robot) -> None:
        """Check that test and validation fleets differ, and that there is one to select on."""
        test_fleets = self._test_fleets(robot)
        validation = self.validation_fleet(robot)
        is_test_fleet = False
        if validation:
            is_test_fleet = load_robot_fleet(robot, validation, "validation").name in test_fleets
        is_same_fleet = self._tests_out_of_family and len(test_fleets) < 2
        if is_same_fleet or is_test_fleet:
            raise ConfigError(
                "fleet, out_of_family and validation must be three different fleets",
                argument="out_of_family",
                remedy="change one of them",
            )

        if validation is None and self.to_select():
            raise ConfigError(
                f"no fleet of {robot.name!r} to select {', '.join(self.to_select())} on",
                argument="validation",
                remedy="give a validation fleet, or these numbers",
            )

    def to_select(self) -> dict[str, str]:
        """Setting that is selected on the validation fleet -> its training condition."""
        conditions = {}
        if self.pd_range is None:
            conditions["pd_range"] = "random_pd"
        if self.prior_share is None:
            conditions["prior_share"] = "adapted_prior"
        return {setting: name for setting, name in conditions.items() if name in self.conditions}
