"""How far the motors of a study's conditions vary: the randomised PD and the prior each get the spread that suits them.

Policies of several spreads walk on a validation fleet, whose motors no twin has; the spread whose policies are upright
there for longest is kept, of two that are alike the one whose policies are faster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from motorprior.artifacts import write_json
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.study_cells import walk_table
from motorprior.pipeline.study_conditions import Condition, randomised_pd, sampled_prior
from motorprior.pipeline.study_settings import Study
from motorprior.robots.load import load_robot
from motorprior.transfer.places import ABROAD
from motorprior.transfer.statistics import estimate
from motorprior.transfer.study_verdicts import PD_RANDOMISED, PRIOR, ROBUST_PRIOR, statistic_of
from motorprior.transfer.walk_table import OWN, WalkTable

SPREADS = "spreads.json"
_FLEETS = ("mixed", "foreign_servo", "foreign_direct")
"""Validation fleets: the first that is none of the twins'."""
_FIRST_SEED, _SEEDS = 900, 3
"""Of the policies: other searches than the study's, which count from 0."""


@dataclass(frozen=True)
class _Choice:
    """A setting of a study that is chosen by how policies walk.

    Attributes:
        setting: the field of the study.
        values: tried.
        condition: with a value, under a name.
        name: in what is told of it.
        users: the conditions that have it.
    """

    setting: str
    values: tuple[float, ...]
    condition: Callable[[Study, float, str], Condition]
    name: str
    users: tuple[str, ...]

    def is_open(self, config: Study) -> bool:
        """Whether the study was not told a value that it needs."""
        return getattr(config, self.setting) is None and any(user in config.conditions for user in self.users)

    def conditions(self, config: Study) -> dict[float, Condition]:
        """By value; they are watched on the motors of the validation fleet only."""
        made = {value: self.condition(config, value, f"{self.users[0]}_{value:g}") for value in self.values}
        return {value: replace(condition, twins=(ABROAD,)) for value, condition in made.items()}


CHOICES = (
    _Choice("spread", (0.1, 0.2, 0.3, 0.4), randomised_pd, "constants of the randomised PD", (PD_RANDOMISED,)),
    _Choice("latent_spread", (0.75, 1.0, 1.25, 1.5), sampled_prior, "z of the prior", (PRIOR, ROBUST_PRIOR)),
)
"""As many values for the prior as for its rival."""


def with_spreads(config: Study, progress: Progress = SILENT) -> Study:
    """The study with every spread that it needs; spreads/spreads.json has what was found."""
    choices = [choice for choice in CHOICES if choice.is_open(config)]
    if not choices:
        return config
    seeds, fleet = range(_FIRST_SEED, _FIRST_SEED + min(_SEEDS, config.seeds)), validation_fleet(config)
    tried = {choice.setting: choice.conditions(config) for choice in choices}
    everything = [condition for conditions in tried.values() for condition in conditions.values()]
    # contests are won at home, as in the study
    there = replace(config, out=config.out / "spreads", foreign=fleet, validation=None)
    progress.note(f"spreads, of which the best is chosen on the fleet {fleet!r}: {', '.join(c.name for c in choices)}")
    table = walk_table(there, [(condition, seed) for seed in seeds for condition in everything], progress)
    found = {setting: _found(table, conditions) for setting, conditions in tried.items()}
    best = {setting: max(walked, key=lambda value: _rank(walked[value])) for setting, walked in found.items()}
    written = {
        setting: {"tried": {f"{value:g}": walked for value, walked in found[setting].items()}, "chosen": best[setting]}
        for setting in found
    }
    write_json(there.out / SPREADS, {"fleet": fleet, **written})
    for choice in choices:
        progress.note(f"spread of the {choice.name}: {best[choice.setting]:g}")
    return replace(config, **best)


def validation_fleet(config: Study) -> str:
    """The study's own, or the first of ours that no twin has."""
    if config.validation is not None:
        return config.validation
    twins = config.fleets_of_twins(load_robot(config.robot))
    return next(name for name in _FLEETS if name not in twins)


def _found(table: WalkTable, conditions: dict[float, Condition]) -> dict[float, dict[str, float]]:
    """Value -> speed [m/s] and share of the time upright, on the validation fleet and where policies were trained."""
    return {
        value: {
            f"{prefix}{measure}": estimate(table.scores(place, condition.name, measure), statistic_of(measure)).value
            for prefix, place in (("", ABROAD), ("own_", OWN))
            for measure in ("speed", "upright")
        }
        for value, condition in conditions.items()
    }


def _rank(walked: dict[str, float]) -> tuple[float, float]:
    return walked["upright"], walked["speed"]
