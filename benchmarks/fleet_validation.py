"""Closed-loop fidelity of the priors of a bench, compared with the bench's physical motors.

    python benchmarks/fleet_validation.py runs/prior/prior.safetensors --out runs/fleet_validation

All priors are from benches of the same motors and of different presets. They are compared with the
motors of the bench (train) and with held-out motors of its fleet (held_out), to whose logs they are
adapted. figures.json has the medians and means of `robot_fidelity.FIDELITY_METRICS` and, for the
prior of preset rollout (or the first with physics), errors, false alarms and coverage after
adaptation, and the AUC of a classifier that separates samples of the prior from motors of the
fleet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from figures import PROGRESS, markdown
from motorprior.actuator.fleet import nominal_pd
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import BenchSettings, bench_from_json
from motorprior.bench.recording import bench_schedule, record
from motorprior.bounds import require_number, require_seed
from motorprior.evaluation.errors import MAX_ERROR
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import RESTARTS, WITH_ROTOR, fit_pd
from motorprior.priors.prior_file import load_prior
from motorprior.progress import SILENT, Progress
from motorprior.results import Results, read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working
from virtual_fleets.held_out_motors import (
    POPULATION,
    adapt_all,
    adaptation,
    adapted_models,
    distribution,
    held_out_motors,
)
from virtual_fleets.held_out_trials import ModelOfMotors
from virtual_fleets.robot_fidelity import DIVERGED, FIDELITY_METRICS, fidelity

ADAPT_SECONDS = (2.0, 5.0, 10.0, 30.0)
TITLES = {
    "train": "Closed-loop joint RMSE [rad] and torque above 20 Hz (hf) [N·m], medians; physical: "
    "the true motors, started 4 mrad off",
    "held_out": "The same on held-out motors, adapted to 10 s of log each",
}
# quantities of the prior with physics on held-out motors
DISTRIBUTION = (
    "adapt_rmse_ratio",
    "adapt_false_alarms",
    "coverage50",
    "coverage90",
    "two_sample_auc",
)


@dataclass(frozen=True)
class Settings:
    """Compare priors with the physical motors of a bench, and with held-out motors."""

    priors: tyro.conf.Positional[tuple[Path, ...]]
    """Prior files that `motorprior identify` wrote, all from benches of the same motors."""
    out: Path
    """Run folder."""
    seed: int = 0
    """Seed of the held-out excitation."""
    adapt_seconds: tuple[float, ...] = ADAPT_SECONDS
    """Lengths of log [s] to which the prior is adapted for held-out motors."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or a .toml file."""
    population: int = POPULATION
    """Samples of a prior, and held-out motors, that the classifier separates."""


def validate_on_bench(
    priors: Sequence[Path],
    out: Path,
    *,
    seed: int = 0,
    adapt_seconds: Sequence[float] = ADAPT_SECONDS,
    robot: str = DEFAULT_ROBOT,
    population: int = POPULATION,
    progress: Progress = SILENT,
) -> Results:
    """Compare priors with the physical motors of their bench, and with held-out motors.

    Args:
        priors: prior files of different presets, all from benches of the same motors.
        out: folder for results.json and figures.json; a repeated call reads them.
        seed: of the held-out excitation.
        adapt_seconds: lengths of log [s] to which the prior with physics is adapted for held-out
            motors.
        robot: a name, or the path of a .toml file.
        population: samples of a prior, and held-out motors, that the classifier separates.
        progress: where to report to.

    Returns:
        `FIDELITY_METRICS` of priors, of the robot's nominal PD (ideal_pd) and of one PD tuned to
        the bench log (tuned_pd), on the motors of the bench (train) and on held-out motors
        (held_out), to 10 s of whose logs the priors are adapted; `held_out_motors.adaptation` and
        `held_out_motors.distribution` of the prior of preset rollout, or of the first one with
        physics if there is none.

    Raises:
        ConfigError: a number out of range, or priors that do not fit together or to the robot.
        ArtifactError: a prior or a robot that cannot be read, or ``out`` that cannot be written.
    """
    require_seed(seed)
    for seconds in adapt_seconds:
        require_number("adapt_seconds", seconds, 1.0, 600.0)
    loaded_robot = load_robot(robot)
    loaded, bench = _load_priors(loaded_robot, priors)

    settings = {
        "priors": priors,
        "seed": seed,
        "adapt_seconds": adapt_seconds,
        "robot": robot,
        "population": population,
    }
    stage = description("validate", settings, [*priors, *loaded_robot.files])
    if not is_finished(out, stage):
        with working(out, stage):
            results = _measure(
                loaded_robot, loaded, bench, seed, adapt_seconds, population, progress
            )
            write_results(out, results)
    return read_results(out)


def _load_priors(
    robot: Robot, paths: Sequence[Path]
) -> tuple[dict[str, MotorPrior], BenchSettings]:
    """The priors by preset, and the bench whose motors they learned.

    Raises ConfigError for two priors of a preset or of different motors, and for a bench that has
    fewer motors than the robot.
    """
    if not paths:
        raise ConfigError("no priors given", remedy="give at least one", argument="priors")
    priors: dict[str, MotorPrior] = {}
    benches: list[BenchSettings] = []
    for path in paths:
        prior = load_prior(path, robot)
        if prior.preset in priors:
            problem = f"two priors of preset {prior.preset!r}"
            raise ConfigError(problem, where=path, remedy="give one of each")
        priors[prior.preset] = prior

        bench = bench_from_json(prior.provenance.get("bench"), str(path))
        benches.append(bench)
        first = benches[0]
        if (bench.fleet, bench.motors, bench.seed) != (first.fleet, first.motors, first.seed):
            problem = f"its bench differs from the bench of {paths[0]}"
            raise ConfigError(problem, where=path, remedy="give priors of the same motors")

    if robot.legs and benches[0].motors < robot.num_joints:
        problem = f"its bench has {benches[0].motors} motors, the robot needs {robot.num_joints}"
        remedy = "record a bench of as many motors or more"
        raise ConfigError(problem, where=paths[0], remedy=remedy)
    return priors, benches[0]


def _measure(
    robot: Robot,
    priors: dict[str, MotorPrior],
    bench: BenchSettings,
    seed: int,
    adapt_seconds: Sequence[float],
    population: int,
    progress: Progress,
) -> Results:
    motors = bench.physical_motors()
    baselines = _baselines(robot, bench, progress)

    models = baselines | {name: prior.training_motors for name, prior in priors.items()}
    with progress.start("validate: bench, standing robot, suspended robot", 4) as task:
        results = fidelity(robot, motors, models, "train", seed, task)
        task.advance()

    title = "held-out motors: adapt, bench, standing robot, suspended robot"
    with progress.start(title, 4 + len(adapt_seconds)) as task:
        held_out = held_out_motors(bench)
        adapted = adapt_all(robot, priors, bench)
        models = baselines | adapted_models(priors, adapted, len(held_out))
        task.advance()
        measured = fidelity(robot, held_out, models, "held_out", seed, task)
        results += measured.where(quantity=FIDELITY_METRICS)

        name = _name_of_physics(priors, adapted)
        if name is not None:
            prior = priors[name]
            lengths = tuple(adapt_seconds)
            results += adaptation(robot, prior, bench, lengths, adapted[name], seed, task.advance)
            results += distribution(prior, bench, population)
    return results


def _baselines(robot: Robot, bench: BenchSettings, progress: Progress) -> dict[str, ModelOfMotors]:
    """The robot's nominal PD, and one PD tuned to the bench log."""
    with progress.start("tune a PD on the bench log", RESTARTS) as task:
        schedule = bench_schedule("rollout").for_robot(robot)
        log = record(bench.physical_motors(), schedule, bench.steps, bench.seed, bench.fleet)
        tuned = fit_pd(log, WITH_ROTOR, report=task.advance).constants
    return {
        "ideal_pd": lambda index: nominal_pd(bench.fleet, len(index)),
        "tuned_pd": lambda index: IdealPd.uniform(len(index), **tuned),
    }


def _name_of_physics(priors: Mapping[str, MotorPrior], adapted: Mapping[str, object]) -> str | None:
    """Preset of the prior whose adaptation is measured; None if none has physics."""
    names = [
        name
        for name, prior in priors.items()
        if name in adapted and isinstance(prior.model, GreyBox)
    ]
    if "rollout" in names:
        return "rollout"
    return names[0] if names else None


def fidelity_table(results: Results, motors: str) -> str:
    """Markdown: medians of the `FIDELITY_METRICS` that were measured; hf is torque above 20 Hz."""
    medians = results.where(motors=motors, statistic="median")
    quantities = [name for name in FIDELITY_METRICS if medians.where(quantity=name)]
    models = medians.where(quantity=quantities[0]).distinct("model") if quantities else []

    titles = []
    for quantity in quantities:
        short = quantity.replace("_rmse", "").replace("_torque_hf", " hf")
        titles.append(short.replace("_", " "))
    rows = [[model, *(_cell(medians, name, model) for name in quantities)] for model in models]
    return markdown(["model", *titles], rows)


def _cell(results: Results, quantity: str, model: str) -> str:
    value = results.value(quantity=quantity, model=model)
    limit = MAX_ERROR if "rmse" in quantity else DIVERGED
    return f"{value:.4f}" if value < limit else "diverged"


def main() -> None:
    """Measure, write results.json and figures.json, print the tables."""
    settings = tyro.cli(Settings, description=__doc__)
    results = validate_on_bench(**asdict(settings), progress=PROGRESS)
    for motors, title in TITLES.items():
        print(f"{title}\n\n{fidelity_table(results, motors)}\n")

    figures = results.where(quantity=DISTRIBUTION).to_figures()
    rows = [[name, f"{value:.3f}"] for name, value in figures.items()]
    if rows:  # priors without physics have none
        print(f"Held-out motors\n\n{markdown(['figure', 'value'], rows)}")


if __name__ == "__main__":
    main()
