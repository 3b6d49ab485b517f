"""The width of a study's randomised PD, the share by which its constants vary: chosen where no twin is.

Policies of several widths walk on a validation fleet, whose motors no twin has; the width whose policies are upright
there for longest is kept, of two that are alike the one whose policies are faster. The prior needs no such choice: how
far its motors differ was learned.
"""

from __future__ import annotations

from dataclasses import replace

from motorprior.artifacts import write_json
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.transfer_study.study_cells import walk_table
from motorprior.pipeline.transfer_study.study_conditions import randomised_pd
from motorprior.pipeline.transfer_study.study_settings import OWN_MOTORS, SPREADS, Study
from motorprior.robots.load import load_robot
from motorprior.transfer.places import ABROAD
from motorprior.transfer.statistics import estimate
from motorprior.transfer.study_verdicts import PD_RANDOMISED, statistic_of
from motorprior.transfer.walk_table import OWN, WalkTable

_WIDTHS = (0.1, 0.2, 0.3, 0.4)
_FIRST_SEED, _SEEDS = 900, 3
"""Of the policies: other searches than the study's, which count from 0 and end before."""


def with_spread(config: Study, progress: Progress = SILENT) -> Study:
    """The study with the width of its randomised PD; the same study if it has no such PD or was told a width.

    spreads/spreads.json has what was found.
    """
    if not config.chooses_width:
        return config
    seeds = range(_FIRST_SEED, _FIRST_SEED + min(_SEEDS, config.seeds))
    fleet = config.fleet_for_width(load_robot(config.robot))
    made = {width: randomised_pd(config, width, f"{PD_RANDOMISED}_{width:g}") for width in _WIDTHS}
    # Watched on robots of the validation fleet only; which policy of a search is kept is decided as in the study.
    conditions = [replace(condition, twins=(ABROAD,)) for condition in made.values()]
    kept_by = config.fleet_of_contests(load_robot(config.robot)) or OWN_MOTORS
    there = replace(config, out=config.out / "spreads", foreign=fleet, validation=kept_by)
    progress.note(f"width of the randomised PD: the best is chosen on the fleet {fleet!r}")
    table = walk_table(there, [(condition, seed) for seed in seeds for condition in conditions], progress)
    found = {width: _found(table, condition.name) for width, condition in made.items()}
    best = max(found, key=lambda width: _rank(found[width]))
    tried = {f"{width:g}": walked for width, walked in found.items()}
    write_json(there.out / SPREADS, {"fleet": fleet, "tried": tried, "chosen": best})
    progress.note(f"width of the randomised PD: {best:g}")
    return replace(config, spread=best)


def _found(table: WalkTable, condition: str) -> dict[str, float]:
    """Speed [m/s] and share of the time upright, on the validation fleet and where policies were trained."""
    return {
        f"{prefix}{measure}": estimate(table.scores(place, condition, measure), statistic_of(measure)).value
        for prefix, place in (("", ABROAD), ("own_", OWN))
        for measure in ("speed", "upright")
    }


def _rank(walked: dict[str, float]) -> tuple[float, float]:
    return walked["upright"], walked["speed"]
