"""What of a motor prior transfers: graded priors, how faithful each is, and how their policies walk. docs/transfer.md.

    python benchmarks/grades.py --out runs/grades

Priors of few and of many motors, of a narrow excitation, of other motors; z drawn less and more than it should be;
shorter and longer training, judged on its own motors or on a validation fleet. Policies are trained and watched as by
`motorprior transfer --study`. Writes figures.json with GRADE/POPULATION/fidelity [rad], of motors of the robot's fleet
and of foreign ones, and GRADE/PLACE/MEASURE; rank_correlation/PLACE/MEASURE, of error and measure over the grades that
walk at home; walks.csv of every walk, tables.md, and grades.png. Finished stages are kept. An hour and a half on two
cores; `--grades` picks some.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from string import ascii_uppercase
from textwrap import fill

import numpy as np
import tyro
from scipy.stats import rankdata

from motorprior.actuator.actuator import Factors
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_json, write_text
from motorprior.bounds import require_count
from motorprior.identification.judging.bench_fidelity import HELD_OUT_SEED
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice, load_robot_fleet
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.stage import locked
from motorprior.pipeline.transfer_study.condition import NOTHING, Condition, fleet_of
from motorprior.pipeline.transfer_study.study_cells import walk_table
from motorprior.pipeline.transfer_study.study_settings import OWN_MOTORS, Study
from motorprior.report.plots_style import MODEL_COLORS, describe, new_figure, panels, png_bytes
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.simulation.randomization import Randomization, Range
from motorprior.transfer.places import ABROAD, HOME, TWINS, motors_of_robot
from motorprior.transfer.robot_fidelity import robot_fidelity
from motorprior.transfer.statistics import estimate, ratio
from motorprior.transfer.study_results import with_interval
from motorprior.transfer.study_verdicts import MEASURES as UNITS
from motorprior.transfer.study_verdicts import statistic_of
from motorprior.transfer.walk_table import OWN, WalkTable

PROGRESS = Lines(sys.stderr)
MEASURES = ("speed", "upright", "drift")
FIDELITY_STREAM = 0x64AD
"""Tag of the random stream of the motors that are drawn where fidelity is measured."""
LEAST_SPEED = 0.1
"""[m/s]; policies that are slower where they were trained have no ratio."""
APART = 0.9
"""Between letters of grades with the same error [mrad]."""
COLOR = MODEL_COLORS["rollout"]
DRAWS_OF_FRICTION = 1000
ROBOTS = range(10_000, 10_004)
"""Numbers of the robots that fidelity is measured on; no study walks them."""


@dataclass(frozen=True)
class Grade:
    """One prior and what is done with it.

    Attributes:
        motors: on its bench.
        preset: of its bench.
        fleet: of its bench's motors; the robot's own if not given.
        spread: factor on the standard deviation of z where policies are trained.
        iterations: of their search.
        validation: fleet that decides which policy is kept.
        friction_alone: of the motors only dry friction differs, by what the middle 90 % of the prior's draws have.
    """

    motors: int = 32
    preset: str = "rollout"
    fleet: str | None = None
    spread: float = 1.0
    iterations: int = 50
    validation: str | None = None
    friction_alone: bool = False

    @property
    def bench(self) -> str:
        """Name of the folders of its bench and prior."""
        return f"{self.motors}_{self.preset}_{self.fleet or 'own'}"


GRADES = {
    "reference": Grade(),
    "motors_4": Grade(motors=4),
    "motors_8": Grade(motors=8),
    "motors_128": Grade(motors=128),
    "narrow": Grade(preset="narrow"),
    "foreign_motors": Grade(fleet="foreign_direct"),
    "spread_0": Grade(spread=0.0),
    "spread_0.5": Grade(spread=0.5),
    "spread_1.5": Grade(spread=1.5),
    "iterations_20": Grade(iterations=20),
    "iterations_200": Grade(iterations=200),
    "iterations_200_validated": Grade(iterations=200, validation="mixed"),
    "friction_alone": Grade(spread=0.0, friction_alone=True),
    "iterations_600": Grade(iterations=600),
    "iterations_600_validated": Grade(iterations=600, validation="mixed"),
}
"""Each differs from the first in one thing, those that are validated from the one before them; friction_alone is the
mean motor, z × 0, whose friction differs."""


@dataclass(frozen=True)
class Settings:
    """Train on graded priors, and watch."""

    out: Path
    """Run folder."""
    grades: tuple[str, ...] = tuple(GRADES)
    """Names of grades."""
    seeds: int = 3
    """Policies per grade."""
    draws: int = 32
    """Walks of each policy at each place."""
    adam_steps: int | None = None
    """Of each identification; the preset's own number if not given."""
    seed: int = 0
    """Of benches, priors and searches."""
    workers: int = 2
    """Policies at a time."""


def prior_of(settings: Settings, grade: Grade) -> Path:
    """The prior of a grade, identified unless it is there."""
    bench, folder = (settings.out / kind / grade.bench for kind in ("bench", "priors"))
    run_bench(Bench(bench, grade.fleet, grade.preset, grade.motors, seed=settings.seed), PROGRESS)
    run_identify(Identify(bench, folder, "rollout", settings.seed, settings.adam_steps), PROGRESS)
    return folder / PRIOR


def friction_of(prior: MotorPrior) -> Range:
    """Between which factors on the central motor's dry friction the middle 90 % of a prior's draws are [-]."""
    drawn = prior.sample(DRAWS_OF_FRICTION, np.random.default_rng([HELD_OUT_SEED, FIDELITY_STREAM])).z
    coulomb, central = (prior.network.constants(z)["coulomb"] for z in (drawn, 0.0 * drawn[:1]))
    low, high = np.percentile(coulomb / central, [5.0, 95.0])
    return float(low), float(high)


def randomization_of(grade: Grade, path: Path) -> Randomization:
    """What differs between episodes besides z."""
    return Randomization(coulomb=friction_of(MotorPrior.load(path))) if grade.friction_alone else NOTHING


def fidelity(settings: Settings, path: Path, grade: Grade, population: str) -> float:
    """Median error of a standing robot's joint angles [rad]: drawn motors against those of unseen robots.

    Neither knows the other: robots of a fleet differ, so that even its own motors, drawn again, have an error.
    """
    study = Study(settings.out)
    robot, prior = load_robot(study.robot), MotorPrior.load(path)
    fleet = load_robot_fleet(robot, fleet_of(study, population))
    rng = np.random.default_rng([HELD_OUT_SEED, settings.seed, FIDELITY_STREAM])
    friction = randomization_of(grade, path).coulomb

    def drawn(index: np.ndarray) -> LatentActuator:
        motors = prior.sample(len(index), rng, spread=grade.spread)
        if not grade.friction_alone:
            return motors
        return motors.with_factors(Factors.ones(len(index))._replace(coulomb=rng.uniform(*friction, len(index))))

    models = {"prior": drawn}
    robots = {number: motors_of_robot(robot, fleet, settings.seed, number) for number in ROBOTS}
    errors = [
        robot_fidelity(robot, motors, models, hung=False, seed=number).rmse["prior"]
        for number, motors in robots.items()
    ]
    return float(np.median(np.concatenate(errors)))


def condition_of(name: str, path: Path) -> Condition:
    """What the policies of a grade are trained on."""
    motors = MotorChoice("prior", path, latent_spread=GRADES[name].spread, name=name)
    return Condition(name, motors, randomization_of(GRADES[name], path))


def walks(settings: Settings, priors: dict[str, Path]) -> WalkTable:
    """Every walk of the policies of every grade, grades of the same search together."""
    found = []
    searches = {(grade.iterations, grade.validation) for grade in map(GRADES.__getitem__, priors)}
    for iterations, validation in sorted(searches, key=str):
        study = Study(
            settings.out, seeds=settings.seeds, draws=settings.draws, iterations=iterations,
            validation=validation or OWN_MOTORS, seed=settings.seed, workers=settings.workers,
        )  # fmt: skip
        cells = [
            (condition_of(name, path), seed)
            for seed in range(settings.seeds)
            for name, path in priors.items()
            if (GRADES[name].iterations, GRADES[name].validation) == (iterations, validation)
        ]
        found += walk_table(study.sized(), cells, PROGRESS).walks
    return WalkTable.of(found)


def figures_of(table: WalkTable, faithful: dict[tuple[str, str], float]) -> dict[str, float]:
    """GRADE/POPULATION/fidelity [rad], GRADE/PLACE/MEASURE with /low and /high, GRADE/PLACE/ratio to its own speed."""
    rows = [Result(f"{name}/{population}/fidelity", "rad", value) for (name, population), value in faithful.items()]
    for name in dict.fromkeys(name for name, _ in faithful):
        own = table.at(OWN, name).scores(OWN, name, "speed")
        for place in table.distinct("place"):
            here = table.at(place, name)
            found = {
                measure: estimate(here.scores(place, name, measure), statistic_of(measure)) for measure in MEASURES
            }
            if place != OWN:
                found["ratio"] = ratio(here.scores(place, name, "speed"), own, LEAST_SPEED)
            for measure, each in found.items():
                rows += with_interval(f"{name}/{place}/{measure}", UNITS.get(measure, "1"), each)
    return Results.of(rows).to_figures()


def correlations(figures: dict[str, float], names: list[str], places: list[str]) -> dict[str, float]:
    """rank_correlation/PLACE/MEASURE, Spearman's, of error and measure, over the grades that walk where trained."""
    found = {}
    for place in (place for place in places if place in TWINS):
        walk = [name for name in names if f"{name}/{place}/ratio" in figures]
        if len(walk) < 3:
            continue
        error = rankdata([figures[f"{name}/{TWINS[place].population}/fidelity"] for name in walk])
        for measure in ("speed", "upright", "ratio"):
            ranks = rankdata([figures[f"{name}/{place}/{measure}"] for name in walk])
            if np.ptp(error) > 0.0 and np.ptp(ranks) > 0.0:
                found[f"rank_correlation/{place}/{measure}"] = float(np.corrcoef(error, ranks)[0, 1])
    return found


def markdown(figures: dict[str, float], names: list[str], places: list[str]) -> str:
    """A row per grade: fidelity, then speed, its ratio to its own, time upright and drift at every place."""
    lines = [
        f"| prior | error, {HOME} / {ABROAD} [mrad] | " + " | ".join(places) + " |",
        "|---|---|" + "---|" * len(places),
    ]
    for letter, name in zip(ascii_uppercase, names, strict=False):
        cells = [" / ".join(f"{1000.0 * figures[f'{name}/{each}/fidelity']:.1f}" for each in (HOME, ABROAD))]
        for place in places:
            speed, upright, drift, of_own = (
                figures.get(f"{name}/{place}/{measure}", float("nan")) for measure in (*MEASURES, "ratio")
            )
            share = f" (× {of_own:.2f})" if np.isfinite(of_own) else ""
            cells.append(f"{speed:.2f} m/s{share}, {100.0 * upright:.0f} %, {drift:.2f} m")
        lines.append(f"| {letter}: {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(figures: dict[str, float], names: list[str], places: list[str], path: Path) -> None:
    """Transfer over fidelity: a row per measure, a column per place, a letter per grade; equals side by side."""
    shown = {"ratio": "speed, of its own", "upright": "time upright", "drift": "sideways [m]"}
    twins = [place for place in places if place in TWINS]
    figure = new_figure(2.0 * len(shown) + 1.2)
    grid = panels(figure, len(shown), len(twins), sharey="row")
    for row, (measure, title) in zip(grid, shown.items(), strict=True):
        for axes, place in zip(row, twins, strict=True):
            drawn: Counter[float] = Counter()
            for letter, name in zip(ascii_uppercase, names, strict=False):
                x = 1000.0 * figures[f"{name}/{TWINS[place].population}/fidelity"]
                y = figures.get(f"{name}/{place}/{measure}", float("nan"))
                if np.isfinite(y):
                    axes.plot(x + APART * drawn[x], y, " ")  # makes room
                    axes.text(x + APART * drawn[x], y, letter, ha="center", va="center", fontsize=7, color=COLOR)
                    drawn[x] += 1
        describe(row[0], y=title)
    for axes, place in zip(grid[0], twins, strict=True):
        describe(axes, title=place)
    for axes in grid[-1]:
        describe(axes, x="joint error [mrad]")
    key = ", ".join(f"{letter}\u00a0{name}" for letter, name in zip(ascii_uppercase, names, strict=False))
    figure.supxlabel(fill(key, 95), fontsize=8)
    path.write_bytes(png_bytes(figure))


def main() -> None:
    """Measure, write, print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    for name in settings.grades:
        if name not in GRADES:
            sys.exit(f"no grade {name!r}: use one of {', '.join(GRADES)}")
    for name in ("seeds", "draws", "workers"):  # before hours of work
        require_count(name, getattr(settings, name))
    with locked(settings.out):
        priors = {name: prior_of(settings, GRADES[name]) for name in settings.grades}
        faithful = {
            (name, population): fidelity(settings, path, GRADES[name], population)
            for name, path in priors.items()
            for population in (HOME, ABROAD)
        }
        table = walks(settings, priors)
        table.save(settings.out / "walks.csv")
        figures, names, places = figures_of(table, faithful), list(priors), table.distinct("place")
        figures |= correlations(figures, names, places)
        write_json(settings.out / "figures.json", figures)
        text = markdown(figures, names, places)
        write_text(settings.out / "tables.md", text)
        draw(figures, names, places, settings.out / "grades.png")
    print(text)


if __name__ == "__main__":
    main()
