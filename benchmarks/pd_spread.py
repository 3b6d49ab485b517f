"""How far the constants of a randomised PD should vary: the rival of docs/transfer.md gets its best width.

    python benchmarks/pd_spread.py --study runs/study --out runs/pd_spread

Policies are trained as in the study on its PD with friction, all constants ± WIDTH, other seeds, and walk on the
physical motors of a validation fleet, which is none of the study's twins'. Writes tables.md, and figures.json with
WIDTH/PLACE/MEASURE, where PLACE is own or the fleet's name. Finished policies are kept. A quarter of an hour on two
cores.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bounds import require_count
from motorprior.pipeline.folder_lock import taken
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.study import walk_table
from motorprior.pipeline.study_conditions import FITS, Condition
from motorprior.pipeline.study_settings import Study
from motorprior.results import Results
from motorprior.transfer.places import ABROAD
from motorprior.transfer.statistics import estimate
from motorprior.transfer.study_results import with_interval
from motorprior.transfer.study_verdicts import MEASURES as UNITS
from motorprior.transfer.study_verdicts import PD_FRICTION, statistic_of
from motorprior.transfer.walk_table import OWN, WalkTable

MEASURES = ("speed", "upright")


@dataclass(frozen=True)
class Settings:
    """Train PDs of several widths, and watch."""

    study: Path
    """Folder of a study, whose fitted PD is varied."""
    out: Path
    """Run folder."""
    widths: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4)
    """Shares by which every constant varies."""
    validation: str = "mixed"
    """Fleet whose motors the policies walk on; none of the study's twins'."""
    fleet: str | None = None
    """Fleet of the study."""
    speed: float | None = None
    """Commanded in the study [m/s]; its default if not given."""
    seeds: int = 3
    """Policies per width."""
    draws: int = 32
    """Walks of each policy at each place."""
    seed: int = 100
    """Of the searches; another than the study's."""
    workers: int = 2
    """Policies at a time."""


def measured(settings: Settings) -> WalkTable:
    """Every walk of every policy, in its own simulation and on the validation fleet."""
    constants = read_json(settings.study / "fits" / FITS)[PD_FRICTION]["constants"]
    study = Study(
        settings.out, settings.fleet, seeds=settings.seeds, draws=settings.draws, speed=settings.speed,
        validation=settings.validation, seed=settings.seed, workers=settings.workers,
    ).sized()  # fmt: skip
    pd = MotorChoice("pd", fleet=settings.fleet, **constants)
    conditions = [
        Condition(f"{width:g}", replace(pd, spread=width, name=f"{width:g}"), twins=(ABROAD,))
        for width in settings.widths
    ]
    cells = [(condition, seed) for seed in range(settings.seeds) for condition in conditions]
    there = replace(study, foreign=settings.validation, validation=None)  # contests are won at home, as in the study
    return walk_table(there, cells, Lines(sys.stderr))


def figures_of(table: WalkTable, validation: str) -> dict[str, float]:
    """WIDTH/PLACE/MEASURE with /low and /high ends of the 95 % interval."""
    places, rows = {OWN: OWN, ABROAD: validation}, []
    for width in table.distinct("condition"):
        for place, name in places.items():
            for measure in MEASURES:
                found = estimate(table.scores(place, width, measure), statistic_of(measure))
                rows += with_interval(f"{width}/{name}/{measure}", UNITS[measure], found)
    return Results.of(rows).to_figures()


def markdown(figures: dict[str, float], validation: str) -> str:
    """A row per width: speed and time upright where it was trained and on the validation fleet."""
    lines = [f"| varied by | own simulation | {validation} |", "|---|---|---|"]
    for width in dict.fromkeys(name.split("/")[0] for name in figures):
        cells = [
            "{:.2f} m/s, {:.0%}".format(*(figures[f"{width}/{place}/{measure}"] for measure in MEASURES))
            for place in (OWN, validation)
        ]
        lines.append(f"| ± {float(width):.0%} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, write, print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    for name in ("seeds", "draws", "workers"):  # before minutes of work
        require_count(name, getattr(settings, name))
    with taken(settings.out):
        figures = figures_of(measured(settings), settings.validation)
        write_json(settings.out / "figures.json", figures)
        text = markdown(figures, settings.validation)
        write_text(settings.out / "tables.md", text)
    print(text)


if __name__ == "__main__":
    main()
