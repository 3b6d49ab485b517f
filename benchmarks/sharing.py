"""Advantage of pooling motors over fitting them separately: short logs, few motors, no torques.

    python benchmarks/sharing.py --out runs/sharing

Presets rollout and per_motor have the same model and search. In rollout a Gaussian over the fleet is estimated with the
motors; in per_motor each motor is fitted separately. figures.json contains the median error over motors [rad] on
held-out excitation as EXCITATION/CASE/PRESET, and the correlation of armature and Coulomb friction with the truth over
motors as CONSTANT/CASE/PRESET. Finished stages are reused. Twenty minutes on two cores.
"""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.bench_folder import BenchSettings, read_bench
from motorprior.bench.families import require_geared
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.identification.evaluation.bench_truth import HELD_OUT, bench_errors
from motorprior.identification.fit_prior import PRIOR
from motorprior.progress import Lines
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import FIGURES, description, is_finished, working

PRESETS = ("rollout", "per_motor")
EXCITATIONS = ("gait", "impacts", "chirp")
CONSTANTS = ("armature", "coulomb")
PERIOD = 0.002
PROGRESS = Lines(sys.stderr)


@dataclass(frozen=True)
class Case:
    """A bench: motors, seconds of log each, and whether the log has torques."""

    motors: int
    seconds: float
    torque: bool = True

    @property
    def name(self) -> str:
        """Name of the folder and in figures."""
        return f"{self.motors}_motors_{self.seconds:g}_s" + ("" if self.torque else "_no_torque")

    @property
    def steps(self) -> int:
        """Samples per motor."""
        return round(self.seconds / PERIOD)


CASES = (Case(32, 2.0), Case(32, 5.0), Case(32, 10.0), Case(4, 5.0), Case(8, 5.0), Case(32, 5.0, torque=False))


@dataclass(frozen=True)
class Settings:
    """Fit motors to short logs, pooled and separately, and measure the errors of both."""

    out: Path  # run folder
    fleet: str = "mixed"  # population of motors of the geared family
    seed: int = 0  # seed of bench, searches and held-out excitation
    cases: tuple[str, ...] = tuple(case.name for case in CASES)  # names of the cases to run


def measure(settings: Settings, case: Case) -> dict[str, float]:
    """The figures of one case; measured if the file does not exist."""
    bench, folder = settings.out / case.name / "bench", settings.out / case.name / "measured"
    run_bench(Bench(bench, settings.fleet, "adapt", case.motors, case.steps, settings.seed), PROGRESS)
    paths = {name: settings.out / case.name / name / PRIOR for name in PRESETS}
    for name, path in paths.items():
        run_identify(Identify(bench, path.parent, name, settings.seed, torque=case.torque), PROGRESS)
    wanted = description("validate", asdict(settings) | {"cases": [case.name]}, list(paths.values()))
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            priors = {name: MotorPrior.load(path) for name, path in paths.items()}
            write_json(folder / FIGURES, figures(settings, case, priors, read_bench(bench)[1]))
    return read_json(folder / FIGURES)


def figures(settings: Settings, case: Case, priors: dict[str, MotorPrior], bench: BenchSettings) -> dict[str, float]:
    """Errors [rad] on held-out excitation, and correlations of constants with the truth."""
    motors, preset = bench.physical_motors(), HELD_OUT.for_robot(load_robot(DEFAULT_ROBOT))
    models = {name: prior.training_motors for name, prior in priors.items()}
    errors = bench_errors(motors, models, settings.seed, preset)
    found = {
        f"{kind}/{case.name}/{name}": float(np.median(errors[kind][name])) for kind in EXCITATIONS for name in PRESETS
    }
    for name, prior in priors.items():
        assert isinstance(prior.model, GreyBox)
        fitted, true = prior.model.constants(prior.mean), require_geared(motors)
        for constant in CONSTANTS:
            value = float(np.corrcoef(fitted[constant], getattr(true, constant))[0, 1])
            found[f"{constant}/{case.name}/{name}"] = value
    return found


def table(found: dict[str, float], names: tuple[str, ...]) -> str:
    """Markdown: one row per case; errors in mrad, pooled / separate."""
    titles = (*(f"{kind} [mrad]" for kind in EXCITATIONS), *(f"{name}, correlation" for name in CONSTANTS))
    lines = [f"| log | {' | '.join(titles)} |", "|---" * (1 + len(titles)) + "|"]
    for name in names:
        scaled = [(kind, 1e3, 1) for kind in EXCITATIONS] + [(constant, 1.0, 2) for constant in CONSTANTS]
        cells = [
            " / ".join(f"{scale * found[f'{column}/{name}/{preset}']:.{digits}f}" for preset in PRESETS)
            for column, scale, digits in scaled
        ]
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, write figures.json and table.md, print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    cases = {case.name: case for case in CASES}
    found: dict[str, float] = {}
    for name in settings.cases:
        found |= measure(settings, cases[name])
    write_json(settings.out / FIGURES, found)
    text = table(found, settings.cases)
    write_text(settings.out / "table.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
