"""What of a motor prior transfers: graded priors, how faithful each is, and how their policies walk. docs/transfer.md.

    python benchmarks/grades.py --out runs/grades

Priors of few and of many motors, of a narrow excitation, of other motors; z drawn less and more than it should be;
shorter and longer training, judged on its own motors or on a validation fleet. Policies are trained and watched as by
`motorprior transfer --study`. Writes figures.json with GRADE/fidelity [rad] and GRADE/PLACE/MEASURE, results.csv of
every walk, tables.md, and grades.png. Finished stages are kept. Hours on two cores; `--grades` picks some.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_json, write_text
from motorprior.bench.fleet import load_fleet
from motorprior.identification.bench_fidelity import HELD_OUT_SEED
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice, load_robot_fleet
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.study import walk_table
from motorprior.pipeline.study_conditions import Condition
from motorprior.pipeline.study_settings import Study
from motorprior.report.plots_style import describe, new_figure, panels, png_bytes
from motorprior.robots.load import load_robot
from motorprior.transfer.robot_fidelity import robot_fidelity
from motorprior.transfer.statistics import estimate, iqms, means, ratio
from motorprior.transfer.study_verdicts import LEAST_SPEED, MEANS
from motorprior.transfer.walk_table import OWN, WalkTable

PROGRESS = Lines(sys.stderr)
MEASURES = ("speed", "upright", "drift")
FIDELITY_STREAM, POOL = 0x64AD, 96
"""Tag of the random stream of the motors that fidelity is measured on, and their number."""


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
    """

    motors: int = 32
    preset: str = "rollout"
    fleet: str | None = None
    spread: float = 1.0
    iterations: int = 50
    validation: str | None = None

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
    "foreign": Grade(fleet="foreign_direct"),
    "spread_0": Grade(spread=0.0),
    "spread_0.5": Grade(spread=0.5),
    "spread_1.5": Grade(spread=1.5),
    "iterations_20": Grade(iterations=20),
    "iterations_200": Grade(iterations=200),
    "iterations_200_validated": Grade(iterations=200, validation="mixed"),
}
"""Each differs from the first in one thing; the last from the one before it."""


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


def fidelity(settings: Settings, path: Path, spread: float) -> float:
    """Median error of a standing robot's joint angles [rad]: drawn motors against unseen ones of the robot's fleet.

    Neither knows the other: motors of a fleet differ, so that even its own motors, drawn again, have an error.
    """
    robot, prior = load_robot(Study(settings.out).robot), MotorPrior.load(path)
    rng = np.random.default_rng([HELD_OUT_SEED, settings.seed, FIDELITY_STREAM])
    motors = load_robot_fleet(robot).sample(POOL, rng)
    models = {"prior": lambda index: prior.sample(len(index), rng, spread=spread)}
    found = robot_fidelity(robot, motors, models, hung=False, seed=settings.seed)
    return float(np.median(found.rmse["prior"]))


def walks(settings: Settings, priors: dict[str, Path]) -> WalkTable:
    """Every walk of the policies of every grade, grades of the same search together."""
    found = []
    searches = {(grade.iterations, grade.validation) for grade in map(GRADES.__getitem__, priors)}
    for iterations, validation in sorted(searches, key=str):
        study = Study(
            settings.out, seeds=settings.seeds, draws=settings.draws, iterations=iterations, validation=validation,
            seed=settings.seed, workers=settings.workers,
        )  # fmt: skip
        cells = [
            (Condition(name, MotorChoice("prior", path, latent_spread=GRADES[name].spread, name=name)), seed)
            for seed in range(settings.seeds)
            for name, path in priors.items()
            if (GRADES[name].iterations, GRADES[name].validation) == (iterations, validation)
        ]
        found += walk_table(study.sized(), cells, PROGRESS).walks
    return WalkTable.of(found)


def figures_of(table: WalkTable, faithful: dict[str, float]) -> dict[str, float]:
    """GRADE/fidelity [rad], GRADE/PLACE/MEASURE with /low and /high, and GRADE/PLACE/ratio to its own speed."""
    figures = {f"{name}/fidelity": value for name, value in faithful.items()}
    for name in faithful:
        own = table.at(OWN, name).scores(OWN, name, "speed")
        for place in table.distinct("place"):
            here = table.at(place, name)
            found = {
                measure: estimate(here.scores(place, name, measure), means if measure in MEANS else iqms)
                for measure in MEASURES
            }
            if place != OWN:
                found["ratio"] = ratio(here.scores(place, name, "speed"), own, LEAST_SPEED)
            for measure, each in found.items():
                ends = {"": each.value, "/low": each.low, "/high": each.high}
                known = {end: value for end, value in ends.items() if np.isfinite(value)}
                figures |= {f"{name}/{place}/{measure}{end}": float(value) for end, value in known.items()}
    return figures


def markdown(figures: dict[str, float], names: list[str], places: list[str]) -> str:
    """A row per grade: fidelity, then speed, time upright and drift at every place, and the ratio to its own speed."""
    lines = [
        "| prior | fidelity [mrad] | " + " | ".join(places) + " |",
        "|---|---|" + "---|" * len(places),
    ]
    for name in names:
        cells = [f"{1000.0 * figures[f'{name}/fidelity']:.1f}"]
        for place in places:
            speed, upright, drift = (figures[f"{name}/{place}/{measure}"] for measure in MEASURES)
            of_own = figures.get(f"{name}/{place}/ratio")
            share = "" if of_own is None else f", × {of_own:.2f}"
            cells.append(f"{speed:.2f} m/s{share}, {100.0 * upright:.0f} %, {drift:.2f} m")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(figures: dict[str, float], names: list[str], places: list[str], path: Path) -> None:
    """Transfer over fidelity: a panel per measure, a colour per place, a number per grade."""
    shown = {"ratio": "speed, of its own [-]", "upright": "time upright [-]", "drift": "sideways at the end [m]"}
    figure = new_figure(2.4 * len(shown) + 0.6)
    grid = panels(figure, len(shown), sharex=True)[:, 0]
    for axes, (measure, title) in zip(grid, shown.items(), strict=True):
        for place in [place for place in places if place != OWN]:
            points = [
                (1000.0 * figures[f"{name}/fidelity"], figures[f"{name}/{place}/{measure}"], str(number))
                for number, name in enumerate(names)
                if f"{name}/{place}/{measure}" in figures
            ]
            axes.plot([x for x, *_ in points], [y for _, y, _ in points], "o", markersize=4, label=place)
            for x, y, number in points:
                axes.annotate(number, (x, y), textcoords="offset points", xytext=(4, 2), fontsize=7)
        describe(axes, y=title)
    describe(grid[0], title="Transfer over fidelity; " + ", ".join(f"{n} {name}" for n, name in enumerate(names)))
    describe(grid[-1], x="error of the standing robot's joints [mrad]")
    grid[0].legend(fontsize=7)
    path.write_bytes(png_bytes(figure))


def main() -> None:
    """Measure, write, print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    for name in settings.grades:
        if name not in GRADES:
            sys.exit(f"no grade {name!r}: use one of {', '.join(GRADES)}")
    for fleet in {grade.fleet for grade in GRADES.values() if grade.fleet}:
        load_fleet(fleet)  # before hours of work
    priors = {name: prior_of(settings, GRADES[name]) for name in settings.grades}
    faithful = {name: fidelity(settings, path, GRADES[name].spread) for name, path in priors.items()}
    table = walks(settings, priors)
    table.save(settings.out / "walks.csv")
    figures, names, places = figures_of(table, faithful), list(priors), table.distinct("place")
    write_json(settings.out / "figures.json", figures)
    text = markdown(figures, names, places)
    write_text(settings.out / "tables.md", text)
    draw(figures, names, places, settings.out / "grades.png")
    print(text)


if __name__ == "__main__":
    main()
