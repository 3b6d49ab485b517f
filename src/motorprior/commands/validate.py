"""Motor priors compared with the physical motors that they learned from, or with a held-out log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_text
from motorprior.bench.bench_folder import BenchSettings, bench_from_json
from motorprior.bench.fleet import nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_number, require_seed
from motorprior.evaluation.bench_truth import ModelOfMotors
from motorprior.evaluation.free_runs import Validation
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import RESTARTS, WITH_ROTOR, fit_pd
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import note_training_log
from motorprior.priors.held_out import adapt_all, adaptation, adapted_models, distribution, held_out_motors
from motorprior.priors.prior_file import load_prior
from motorprior.priors.validate import validate
from motorprior.progress import SILENT, Progress
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import PAGE, description, is_finished, read_results, working, write_results
from motorprior.studies.robot_fidelity import FIDELITY_METRICS, fidelity


@dataclass(frozen=True)
class Validate:
    """Compare priors with the physical motors of a bench, and with held-out motors."""

    priors: tuple[Path, ...]
    """Prior files that `motorprior identify` wrote, all from benches of the same motors."""
    out: Path
    """Folder for figures.json."""
    seed: int = 0
    """Seed of the held-out excitation."""
    adapt_seconds: tuple[float, ...] = (2.0, 5.0, 10.0, 30.0)
    """Lengths of log [s] to which the prior is adapted for held-out motors."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_validate(config: Validate, progress: Progress = SILENT) -> Results:
    """Measure, or read the results of the finished stage; errors for a prior or setting that cannot be used."""
    require_seed(config.seed)
    for seconds in config.adapt_seconds:
        require_number("adapt_seconds", seconds, 1.0, 600.0)
    robot = load_robot(config.robot)
    priors, bench = load_priors(robot, config.priors)
    wanted = description("validate", asdict(config), [*config.priors, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            write_results(config.out, _measure(config, robot, priors, bench, progress))
    return read_results(config.out)


def load_priors(robot: Robot, paths: tuple[Path, ...]) -> tuple[dict[str, MotorPrior], BenchSettings]:
    """The priors by preset, and the bench whose motors they learned; ConfigError if they do not fit together."""
    priors: dict[str, MotorPrior] = {}
    benches: list[BenchSettings] = []
    for path in paths:
        prior = load_prior(path, robot)
        if prior.preset in priors:
            raise ConfigError(f"two priors of preset {prior.preset!r}", where=path, remedy="give one of each")
        priors[prior.preset] = prior
        benches.append(bench_from_json(prior.provenance.get("bench"), str(path)))
        first, own = benches[0], benches[-1]
        if (own.fleet, own.motors, own.seed) != (first.fleet, first.motors, first.seed):
            problem, remedy = f"its bench is not that of {paths[0]}", "give priors of the same motors"
            raise ConfigError(problem, where=path, remedy=remedy)
    if robot.legs and benches[0].motors < robot.num_joints:
        problem = f"its bench has {benches[0].motors} motors, the robot needs {robot.num_joints}"
        raise ConfigError(problem, where=paths[0], remedy="record a bench of as many motors or more")
    return priors, benches[0]


def _measure(
    config: Validate, robot: Robot, priors: dict[str, MotorPrior], bench: BenchSettings, progress: Progress
) -> Results:
    motors, seed = bench.physical_motors(), config.seed
    with progress.start("tune a PD on the bench log", RESTARTS) as task:
        log = record(motors, bench_preset("rollout").for_robot(robot), bench.steps, bench.seed, bench.fleet)
        tuned = fit_pd(log, WITH_ROTOR, report=task.advance).constants
    baselines: dict[str, ModelOfMotors] = {
        "ideal_pd": lambda index: nominal_pd(bench.fleet, len(index)),
        "tuned_pd": lambda index: IdealPd.uniform(len(index), **tuned),
    }
    models = baselines | {name: prior.training_motors for name, prior in priors.items()}
    with progress.start("validate: bench, standing robot, suspended robot", 4) as task:
        results = fidelity(robot, motors, models, "train", seed, task)
        task.advance()
    title = "held-out motors: adapt, bench, standing robot, suspended robot"
    with progress.start(title, 4 + len(config.adapt_seconds)) as task:
        motors, adapted = held_out_motors(bench), adapt_all(robot, priors, bench)
        models = baselines | adapted_models(priors, adapted, len(motors))
        task.advance()
        results += fidelity(robot, motors, models, "held_out", seed, task).where(quantity=FIDELITY_METRICS)
        of_physics = [name for name, prior in priors.items() if name in adapted and isinstance(prior.model, GreyBox)]
        if of_physics:
            name = "rollout" if "rollout" in of_physics else of_physics[0]
            lengths = config.adapt_seconds
            results += adaptation(robot, priors[name], bench, lengths, adapted[name], seed, task.advance)
            results += distribution(priors[name], bench)
    return results


@dataclass(frozen=True)
class ValidateLog:
    """Compare a prior and baselines on a held-out log."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs of the robot that the log names."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period, of any motors."""
    out: Path
    """Folder for figures.json and report.html."""
    fitted_on: tuple[Path, ...] = ()
    """Other logs of the same motors: the prior is adapted to them, the baselines are fitted to them, and the whole log
    is the test. If none is given, the log's first half is used for this and its second half is the test."""
    seconds: float | None = None
    """Use the log's first seconds [s] in place of its first half; not with fitted_on."""
    adam_steps: int | None = None
    """Adam steps of the pooled network; the preset's own number if not given."""
    seed: int = 0
    """Seed of the baselines' searches and weights."""


def run_validate_log(config: ValidateLog, progress: Progress = SILENT) -> Results:
    """See `validate`; reads the results of the finished stage. Errors as `validate`, or for an unreadable file."""
    log, *fitted_on = (replace(read_parquet(path), source=str(path)) for path in (config.log, *config.fitted_on))
    prior = load_prior(config.prior, log)
    wanted = description("validate-log", asdict(config), [config.prior, config.log, *config.fitted_on])
    if is_finished(config.out, wanted):
        note_training_log(prior, log, progress)
        return read_results(config.out)
    with working(config.out, wanted):
        found = validate(
            prior, log, fitted_on=fitted_on, seconds=config.seconds, adam_steps=config.adam_steps, seed=config.seed,
            folder=config.out / "baselines", progress=progress,
        )  # fmt: skip
        _write_page(config, prior, found)
    return read_results(config.out)


def _write_page(config: ValidateLog, prior: MotorPrior, found: Validation) -> None:
    from motorprior.report.page import page
    from motorprior.report.sections import models_of_logs, samples, write_validation  # here: they import matplotlib

    write_validation(config.out, found)
    title = f"Motors in a held-out log: {config.log.name}"
    sections = [models_of_logs(config.out, "Held-out log", "whole_run_rmse"), samples(prior)]
    write_text(config.out / PAGE, page(title, sections, asdict(config), repr(config)))
