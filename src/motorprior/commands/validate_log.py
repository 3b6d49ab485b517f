"""Errors of a prior and of baselines on held-out rows of a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import atomic_path
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.adapt import adapt_to, first_and_rest
from motorprior.identification.baselines.log_baselines import (
    BaselineFits,
    baseline_recipes,
    fitted_baselines,
    with_gains_of,
)
from motorprior.identification.evaluation.model_errors import LogErrors, free_run_spans, log_warnings, model_errors
from motorprior.identification.prior_file import prior_and_robot, recipe_of, trained_on
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog, other_firmware
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results
from motorprior.stage import description, is_finished, read_results, working, write_results

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.latents.latent_fit import Posterior
    from motorprior.identification.physics.window_runs import WindowRuns

SPANS = {"free_run_rmse": "1 s", "whole_run_rmse": "whole log"}  # quantity -> free runs
COVERAGE = {"free_run_rmse": "coverage", "whole_run_rmse": "whole_run_coverage"}
ADAPTED, PRIOR = "adapted", "prior"
TRAINED_ON = "prior_was_trained_on_this_log"


@dataclass(frozen=True)
class ValidateLog:
    """Measure the errors of a prior's motors and of baselines in free runs on a held-out log."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period, of any motors."""
    out: Path
    """Folder for figures.json and a picture per motor."""
    fitted_on: tuple[Path, ...] = ()
    """Other logs of the same motors: the prior is adapted to them, the baselines are fitted to them, and the whole log
    is the test. If none is given, the log's first half is used for this and its second half is the test."""
    seconds: float | None = None
    """Use the log's first seconds [s] in place of its first half; not with fitted_on."""
    adam_steps: int | None = None
    """Adam steps of the pooled network; the preset's own number if not given."""
    seed: int = 0
    """Seed of the baselines' searches and weights."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). If none is given, the prior
    must be of the robot that the log names."""


def run_validate_log(config: ValidateLog, progress: Progress = SILENT) -> Results:
    """Measure, or read the results if the folder holds them already.

    Returns:
        ``free_run_rmse`` [rad] of free runs of 1 s and ``whole_run_rmse`` [rad] of free runs of whole segments: median
        and mean over motors, and of each motor (``part``). Models: ADAPTED, the prior adapted to the training rows;
        PRIOR, its motor of the same name or else its central motor; and the baselines of `log_baselines`.
        ``coverage50``, ``coverage90``, ``whole_run_coverage50`` and ``whole_run_coverage90`` of samples of the
        posterior and of z ~ N(0, I). TRAINED_ON: 1 if the prior was trained on the log, so that the figures are not
        a test, otherwise 0.

    Raises:
        LogError, ArtifactError: a log or a prior that cannot be used.
        ConfigError: a number out of range, seconds together with fitted_on, or a prior of another robot.
    """
    require_seed(config.seed)
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    log = read_parquet(config.log)
    prior, robot = prior_and_robot(config.prior, log, config.robot)
    train, test = _train_and_test(config, log)
    inputs = [config.prior, config.log, *config.fitted_on, *(robot.files if robot else ())]
    wanted = description("validate-log", asdict(config), inputs)
    trained = trained_on(prior, log)
    if trained:
        progress.note(f"warning: the prior was trained on {config.log}: its errors are not a test. Use a held-out log")
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            found = Results.of([Result(TRAINED_ON, "1", float(trained))])
            write_results(config.out, _measure(config, prior, train, test, progress) + found)
    return read_results(config.out)


def _train_and_test(config: ValidateLog, log: MotorLog) -> tuple[MotorLog, MotorLog]:
    from motorprior.identification.evaluation.log_fidelity import train_test_halves

    log = replace(log, source=str(config.log))
    if config.seconds is not None and config.fitted_on:
        raise ConfigError("seconds given together with fitted_on", remedy="omit one of them", argument="seconds")
    if not config.fitted_on:
        return train_test_halves(log) if config.seconds is None else first_and_rest(log, config.seconds)
    train = joined([read_parquet(path) for path in config.fitted_on])
    if train.joint_names != log.joint_names:
        raise LogError(
            f"joints {', '.join(train.joint_names)}; {config.log} has {', '.join(log.joint_names)}",
            where=config.fitted_on[0], remedy="give logs of the same joints in the same order",
        )  # fmt: skip
    if other := other_firmware(train.firmware, log.firmware):
        raise LogError(f"{other}, of {config.log}", where=config.fitted_on[0], remedy="give logs of the same firmware")
    return replace(train, source=", ".join(map(str, config.fitted_on))), log


def _measure(config: ValidateLog, prior: MotorPrior, train: MotorLog, test: MotorLog, progress: Progress) -> Results:
    preset = with_gains_of(recipe_of(prior, config.prior), test)
    for line in log_warnings(test, preset):
        progress.note(line)
    spans = free_run_spans(test, preset)
    baseline_recipes(train, preset)  # a log that is too short is an error before anything is fitted
    with progress.start(f"adapt to {train.num_joints} motors", 1) as task:
        posterior = adapt_to(prior, config.prior, train, train.source)
        task.advance()
    models: dict[str, LogModel] = {
        ADAPTED: LatentActuator(prior.network, posterior.mean),
        PRIOR: LatentActuator(prior.network, prior.expected(test.joint_names)),
    }
    models |= fitted_baselines(
        train, preset, BaselineFits(config.out / "baselines", config.adam_steps, config.seed), progress
    )
    results = Results()
    with progress.start("free runs", len(spans)) as task:
        for span, each in spans.items():
            quantity = f"{span}_rmse"  # a key of SPANS
            found = {name: values[None] for name, values in model_errors(each, models).items()}
            errors = LogErrors((test.source,), test.joint_names, found)
            results += errors.results(quantity, {"median": np.median, "mean": np.mean}).where(log=None)
            results += _coverage(COVERAGE[quantity], prior, posterior, each)
            task.advance()
            for line in errors.warnings(ADAPTED) if quantity == "whole_run_rmse" else ():
                progress.note(line)
    _draw_motors(config.out / "pictures", test.joint_names, prior, posterior, spans["whole_run"])
    return results


def _coverage(quantity: str, prior: MotorPrior, posterior: Posterior, runs: list[WindowRuns]) -> Results:
    from motorprior.identification.evaluation.log_fidelity import log_coverage, zero_shot

    return Results.of(
        Result(f"{quantity}{level}", "1", share, model)
        for model, motors in ((ADAPTED, posterior), (PRIOR, zero_shot(prior, len(posterior.mean))))
        for level, share in log_coverage(prior, motors, runs).items()
    )


def _draw_motors(
    folder: Path, joint_names: tuple[str, ...], prior: MotorPrior, posterior: Posterior, runs: list[WindowRuns]
) -> None:
    """Write JOINT.png of every motor: the recorded angle and the bands of samples of the posterior."""
    from motorprior.identification.evaluation.log_fidelity import log_traces
    from motorprior.report.plots_motor import log_against_bands
    from motorprior.report.plots_style import png_bytes

    folder.mkdir(parents=True, exist_ok=True)
    traces = log_traces(prior, posterior, runs)
    for motor, joint in enumerate(joint_names):
        bands = {level: (low[:, motor], high[:, motor]) for level, (low, high) in traces.bands.items()}
        target, pos, model = traces.position_target, traces.joint_pos, traces.model
        figure = log_against_bands(traces.time, target[:, motor], pos[:, motor], model[:, motor], bands, joint)
        with atomic_path(folder / f"{joint}.png") as temporary:
            temporary.write_bytes(png_bytes(figure, dpi=110))  # small files
