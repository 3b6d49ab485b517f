"""What one policy of a study is trained on."""

from __future__ import annotations

from dataclasses import dataclass

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.transfer_study.study_settings import Study
from motorprior.simulation.randomization import Randomization
from motorprior.transfer.places import ABROAD, HOME, TWINS

NOTHING = Randomization()
"""Nothing but the motors differs between episodes."""


@dataclass(frozen=True)
class Condition:
    """What a policy is trained on.

    Attributes:
        name: in tables.
        motors: of every episode.
        randomization: what else differs between episodes.
        twins: where it is watched.
        robot: number of the one robot that it is watched on; of all if not given.
        population: HOME, or ABROAD for what was made for foreign motors.
    """

    name: str
    motors: MotorChoice
    randomization: Randomization = NOTHING
    twins: tuple[str, ...] = tuple(TWINS)
    robot: int | None = None
    population: str = HOME

    def folder(self, seed: int) -> str:
        """Name of the folders of its policy of a seed."""
        return f"{self.name}_{seed}" if self.population == HOME else f"{self.name}_{self.population}_{seed}"

    @property
    def one_draw_is_all(self) -> bool:
        """Whether its own simulation has no chance in it."""
        motors = self.motors
        if self.randomization != NOTHING or motors.actuator == "fleet" or motors.posterior is not None:
            return False
        if motors.actuator == "pd":
            return motors.spread == 0.0
        return motors.latent_spread == 0.0 or _latents(motors) == 0


def _latents(motors: MotorChoice) -> int:
    """Number of latents of the prior; motors of one without any are all the same."""
    return 1 if motors.prior is None else MotorPrior.load(motors.prior).network.num_latents


def fleet_of(config: Study, population: str) -> str | None:
    """The fleet of a population."""
    return config.foreign if population == ABROAD else config.fleet
