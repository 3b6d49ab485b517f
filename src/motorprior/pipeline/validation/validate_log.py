"""Fidelity of a prior where there is no truth: on a log that nothing was fitted to, beside baselines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import atomic_path
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.doctor.excitation import joints_at_rest
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog, other_firmware
from motorprior.pipeline.adapt import adapt_to, first_and_rest
from motorprior.pipeline.fit_report import other_conditions
from motorprior.pipeline.prior_file import prior_and_robot, trained_on
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.recipe import recipe_of
from motorprior.pipeline.stage import description, is_finished, read_results, working, write_results
from motorprior.pipeline.validation.log_baselines import (
    BaselineFits,
    baseline_recipes,
    fitted_baselines,
    with_gains_of,
)
from motorprior.results import Result, Results

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel, LogTraces
    from motorprior.identification.latents.latent_fit import Posterior
    from motorprior.identification.physics.window_runs import WindowRuns

SPANS = {"free_run_rmse": "1 s", "whole_run_rmse": "whole log"}
"""Errors that are measured, and how long their free runs are."""
COVERAGE = {"free_run_rmse": "coverage", "whole_run_rmse": "whole_run_coverage"}
ADAPTED, PRIOR = "adapted", "prior"
"""Models beside the baselines, as benchmarks/real_logs.py names them."""
BASELINES, PICTURES = "baselines", "pictures"
TRAINED_ON = "prior_was_trained_on_this_log"
_DPI = 110
"""A picture per motor: small files."""


@dataclass(frozen=True)
class ValidateLog:
    """Measure how far a prior's motors and baselines are from a held-out log, command in and motion out."""

    prior: Path
    """Prior that `motorprior identify` wrote from other logs."""
    log: Path
    """Motor log (.parquet) with load_inertia and external_torque, at the prior's sample period, of any motors."""
    out: Path
    """Folder for figures.json and a picture per motor."""
    fitted_on: tuple[Path, ...] = ()
    """Other logs of the same motors: the baselines are fitted to them and the prior is adapted to them, and all of the
    log is judged. If none is given, the log's first half takes their place and its second half is judged."""
    seconds: float | None = None
    """The log's first seconds [s] take the place of its first half, and the rest is judged; not with other logs."""
    adam_steps: int | None = None
    """Adam steps of the pooled network; the preset's own number if not given."""
    seed: int = 0
    """Seed of the baselines' searches and weights."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). If none is given, the prior
    must be of the robot that the log names."""


def run_validate_log(config: ValidateLog, progress: Progress = SILENT) -> Results:
    """Measure, or read what this very measurement found.

    Returns:
        ``free_run_rmse`` [rad] of free runs of a second and ``whole_run_rmse`` [rad] of free runs of whole segments:
        median and mean over motors, and of each motor (``part``). Models: ADAPTED, the prior's motors as what is known
        of them tells; PRIOR, the prior told only names of joints and stated gains: its motor of the same name, or its
        central one; and the baselines of `log_baselines`. ``coverage50``, ``coverage90`` and ``whole_run_coverage50``,
        ``whole_run_coverage90`` of the draws of both: of the posterior, and of z ~ N(0, I), which is told no names
        either. TRAINED_ON: 1 if the judged log is one that the prior was trained on, so that its figures are no test,
        otherwise 0.

    Raises:
        LogError, ArtifactError: a log or a prior that cannot be used.
        ConfigError: a number out of range, seconds beside other logs, or a prior of another robot.
    """
    require_seed(config.seed)
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    log = read_parquet(config.log)
    prior, robot = prior_and_robot(config.prior, log, config.robot)
    known, judged = _known_and_judged(config, log)
    inputs = [config.prior, config.log, *config.fitted_on, *(robot.files if robot else ())]
    wanted = description("validate-log", asdict(config), inputs)
    trained = trained_on(prior, log)
    if trained:
        progress.note(
            f"warning: the prior was trained on {config.log}: how well it does there is no test of it; judge a log "
            "that it has not seen"
        )
    if resting := joints_at_rest(judged):
        progress.note(
            f"note: {', '.join(resting)} did not move in what is judged: the error of a resting joint only "
            "tells how well it is held; judge another log, too"
        )
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            found = Results.of([Result(TRAINED_ON, "1", float(trained))])
            write_results(config.out, _measure(config, prior, known, judged, progress) + found)
    return read_results(config.out)


def _known_and_judged(config: ValidateLog, log: MotorLog) -> tuple[MotorLog, MotorLog]:
    from motorprior.identification.evaluation.log_fidelity import train_test_halves

    log = replace(log, source=str(config.log))
    if config.seconds is not None and config.fitted_on:
        problem = "seconds: the other logs that are given say what is known"
        raise ConfigError(problem, remedy="leave seconds, or the other logs, out", argument="seconds")
    if not config.fitted_on:
        return train_test_halves(log) if config.seconds is None else first_and_rest(log, config.seconds)
    known = joined([read_parquet(path) for path in config.fitted_on])
    if known.joint_names != log.joint_names:
        raise LogError(
            f"joints {', '.join(known.joint_names)}; {config.log} has {', '.join(log.joint_names)}",
            where=config.fitted_on[0], remedy="give logs of the same joints in the same order",
        )  # fmt: skip
    if other := other_firmware(known.firmware, log.firmware):
        raise LogError(f"{other}, of {config.log}", where=config.fitted_on[0], remedy="give logs of the same firmware")
    return replace(known, source=", ".join(map(str, config.fitted_on))), log


def _measure(config: ValidateLog, prior: MotorPrior, known: MotorLog, judged: MotorLog, progress: Progress) -> Results:
    from motorprior.identification.evaluation.log_fidelity import free_runs, log_traces, whole_runs

    where, preset = judged.source, with_gains_of(recipe_of(prior, config.prior), judged)
    spans = {
        "free_run_rmse": [free_runs(judged, preset, where)], "whole_run_rmse": whole_runs(judged, preset, where),
    }  # fmt: skip
    for line in other_conditions(preset, judged):
        progress.note(line)
    baseline_recipes(known, preset)  # too short a log is refused before anything is fitted
    with progress.start(f"adapt to {known.num_joints} motors", 1) as task:
        found = adapt_to(prior, config.prior, known, known.source)
        task.advance()
    models: dict[str, LogModel] = {
        ADAPTED: LatentActuator(prior.network, found.mean),
        PRIOR: LatentActuator(prior.network, prior.expected(judged.joint_names)),
    }
    fits = BaselineFits(config.out / BASELINES, config.adam_steps, config.seed)
    models |= fitted_baselines(known, preset, fits, progress)
    with progress.start("free runs", len(spans)) as task:
        results = measured(spans, models, prior, found, judged.joint_names, task.advance)
    draw_motors(config.out / PICTURES, judged.joint_names, log_traces(prior, found, spans["whole_run_rmse"]))
    return results


def measured(
    spans: dict[str, list[WindowRuns]],
    models: dict[str, LogModel],
    prior: MotorPrior,
    found: Posterior,
    joint_names: tuple[str, ...],
    report: Callable[[], None] = lambda: None,
) -> Results:
    """Errors of all models, and coverage of the prior, adapted and told nothing, over free runs of each of SPANS."""
    from motorprior.identification.evaluation.log_fidelity import (
        free_run_errors,
        log_coverage,
        within_a_turn,
        zero_shot,
    )

    rows = []
    for quantity, runs in spans.items():
        for model, values in free_run_errors(runs, models).items():
            rows += [
                Result(quantity, "rad", float(within_a_turn(float(of(values)))), model, statistic=statistic)
                for statistic, of in (("median", np.median), ("mean", np.mean))
            ]
            rows += [
                Result(quantity, "rad", float(within_a_turn(value)), model, part=joint)
                for joint, value in zip(joint_names, values, strict=True)
            ]
        for model, believed in ((ADAPTED, found), (PRIOR, zero_shot(prior, len(joint_names)))):
            covered = log_coverage(prior, believed, runs)
            rows += [Result(f"{COVERAGE[quantity]}{level}", "1", share, model) for level, share in covered.items()]
        report()
    return Results.of(rows)


def draw_motors(folder: Path, joint_names: tuple[str, ...], traces: LogTraces) -> None:
    """Write JOINT.png of every motor: what was recorded against the bands of the draws."""
    from motorprior.report.plots_log import log_against_bands
    from motorprior.report.plots_style import png_bytes

    folder.mkdir(parents=True, exist_ok=True)
    for motor, joint in enumerate(joint_names):
        bands = {level: (low[:, motor], high[:, motor]) for level, (low, high) in traces.bands.items()}
        target, pos, model = traces.position_target, traces.joint_pos, traces.model
        shown = log_against_bands(traces.time, target[:, motor], pos[:, motor], model[:, motor], bands, joint)
        with atomic_path(folder / f"{joint}.png") as temporary:
            temporary.write_bytes(png_bytes(shown, dpi=_DPI))
