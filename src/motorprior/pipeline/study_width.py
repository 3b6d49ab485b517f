"""How far the constants of a study's randomised PD vary: its rival gets the width that suits the bench.

Policies of several widths walk on a validation fleet, whose motors no twin has; the width whose policies are upright
there for longest is kept, of two that are alike the one whose policies are faster.
"""

from __future__ import annotations

from dataclasses import replace

from motorprior.artifacts import write_json
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.study_cells import walk_table
from motorprior.pipeline.study_conditions import Condition, randomised_pd
from motorprior.pipeline.study_settings import Study
from motorprior.robots.load import load_robot
from motorprior.transfer.places import ABROAD
from motorprior.transfer.statistics import estimate
from motorprior.transfer.study_verdicts import PD_RANDOMISED, statistic_of
from motorprior.transfer.walk_table import OWN, WalkTable

WIDTHS = (0.1, 0.2, 0.3, 0.4)
"""Shares by which every constant varies [-]."""
WIDTH = "width.json"
_FLEETS = ("mixed", "foreign_servo", "foreign_direct")
"""Validation fleets: the first that is none of the twins'."""
_FIRST_SEED, _SEEDS = 900, 3
"""Of the policies: other searches than the study's, which count from 0."""


def with_width(config: Study, progress: Progress = SILENT) -> Study:
    """The study with the width of its randomised PD, where it has one; width/width.json has what was found."""
    if config.spread is not None or PD_RANDOMISED not in config.conditions:
        return config
    seeds, fleet = range(_FIRST_SEED, _FIRST_SEED + min(_SEEDS, config.seeds)), width_fleet(config)
    pds = [randomised_pd(config, width, f"{PD_RANDOMISED}_{width:g}") for width in WIDTHS]
    cells = [(replace(pd, twins=(ABROAD,)), seed) for seed in seeds for pd in pds]
    # contests are won at home, as in the study
    there = replace(config, out=config.out / "width", foreign=fleet, validation=None)
    progress.note(f"the randomised PD: {len(WIDTHS)} widths, of which one is chosen on the fleet {fleet!r}")
    found = _found(walk_table(there, cells, progress), pds)
    best = max(WIDTHS, key=lambda width: (found[f"{width:g}"]["upright"], found[f"{width:g}"]["speed"]))
    write_json(there.out / WIDTH, {"fleet": fleet, "widths": found, "chosen": best})
    progress.note(f"the randomised PD varies by {best:.0%}")
    return replace(config, spread=best)


def width_fleet(config: Study) -> str:
    """The study's own, or the first of ours that no twin has."""
    if config.validation is not None:
        return config.validation
    twins = config.fleets_of_twins(load_robot(config.robot))
    return next(name for name in _FLEETS if name not in twins)


def _found(table: WalkTable, pds: list[Condition]) -> dict[str, dict[str, float]]:
    """Width -> speed [m/s] and share of the time upright, on the validation fleet and where policies were trained."""
    return {
        f"{width:g}": {
            f"{prefix}{measure}": estimate(table.scores(place, pd.name, measure), statistic_of(measure)).value
            for prefix, place in (("", ABROAD), ("own_", OWN))
            for measure in ("speed", "upright")
        }
        for width, pd in zip(WIDTHS, pds, strict=True)
    }
