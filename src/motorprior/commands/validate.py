"""Errors of a prior and of baselines on held-out rows of a log."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior, prior_path
from motorprior.artifacts import write_text
from motorprior.evaluation.free_runs import Validation
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import note_training_log
from motorprior.priors.prior_file import load_prior
from motorprior.priors.validate import validate
from motorprior.progress import SILENT, Progress
from motorprior.results import Results, read_results
from motorprior.stage import PAGE, description, is_finished, working

BASELINES = "baselines"  # folder with the fits of the baselines


@dataclass(frozen=True)
class Validate:
    """Compare a prior and baselines with the motors of a held-out log."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs of the log's robot, or the name of a
    shipped motor card."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period."""
    out: Path
    """Folder for figures.json and report.html."""
    fitted_on: tuple[Path, ...] = ()
    """Other logs of the same motors. The prior is adapted to them and the baselines are fitted to
    them; then the whole log is the test. If no such log is given, the models are fitted to the
    first half of the log and tested on its second half."""
    seconds: float | None = None
    """Duration of the first part of the log, to which the models are fitted in place of its first
    half [s]; not with fitted_on."""
    adam_steps: int | None = None
    """Adam steps of the pooled network; the number of its preset if not given."""
    seed: int = 0
    """Seed of the searches and initial weights of the baselines."""


def _log_at(path: Path) -> MotorLog:
    """The log in a file, with its path as source."""
    return replace(read_parquet(path), source=str(path))


def run_validate(config: Validate, progress: Progress = SILENT, command: str = "") -> Results:
    """Call `validate`, and write its results and a page; read the results of a finished stage.

    The page names the ``command`` that makes it again.

    Raises the errors of `validate`, and ArtifactError or LogError for an unreadable file.
    """
    paths = (config.log, *config.fitted_on)
    log = _log_at(config.log)
    fitted_on = [_log_at(path) for path in config.fitted_on]
    prior = load_prior(config.prior, log)

    stage = description("validate", asdict(config), [prior_path(config.prior), *paths])
    if is_finished(config.out, stage):
        note_training_log(prior, log, progress)
        return read_results(config.out)
    with working(config.out, stage):
        validation = validate(
            prior,
            log,
            fitted_on=fitted_on,
            seconds=config.seconds,
            adam_steps=config.adam_steps,
            seed=config.seed,
            folder=config.out / BASELINES,
            progress=progress,
        )
        _write_page(config, prior, validation, command)
    return read_results(config.out)


def _write_page(config: Validate, prior: MotorPrior, validation: Validation, command: str) -> None:
    # here: they import matplotlib
    from motorprior.report.page import page
    from motorprior.report.sections import models_of_logs, samples, write_validation

    write_validation(config.out, validation)
    title = f"Motors in a held-out log: {config.log.name}"
    sections = [models_of_logs(config.out, "Held-out log", "whole_run_rmse"), samples(prior)]
    write_text(config.out / PAGE, page(title, sections, asdict(config), command))
