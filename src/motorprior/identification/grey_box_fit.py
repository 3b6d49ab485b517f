"""Fit of grey boxes to the logs of their motors: select terms, fit all motors, refine constants.

Optional terms are selected on some motors and some rows (`term_selection`), where a saving may be
due to chance. All motors are therefore fitted without the selected terms, and with them from these
fits; the terms are kept if they save MIN_SAVING of the loss of all motors, or if a limit among them
binds, since `limits` decides on limits. The constants are refined on longer runs.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from motorprior.actuator.estimates import LIMITS
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.optional_terms import TERMS
from motorprior.exceptions import MotorPriorError
from motorprior.identification.checkpoint import Arrays, Checkpoint, parts_of
from motorprior.identification.fit_notes import (
    encoder_notes,
    identifiability,
    notes_on_terms,
    outlier_notes,
)
from motorprior.identification.latents.standardise import UNIDENTIFIED_LIMIT_STD, assumed_std
from motorprior.identification.physics import motor_fit, motor_problem, refinement, term_selection
from motorprior.identification.physics.estimate_uncertainty import UNKNOWN_STD, estimates_of
from motorprior.identification.physics.limits import binding_windows
from motorprior.identification.physics.motor_fit import MotorFits
from motorprior.identification.physics.motor_model_fit import level_of_logs, sibling_deviations
from motorprior.identification.physics.term_selection import Selection
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.training_result import TrainingResult
from motorprior.identification.windows import TrainingData, subsampled
from motorprior.progress import ReportProgress

WORK = 100  # progress units per stage of a grey-box fit, in Adam steps
# rows per motor in all but the last descents, or more rows for SEARCH_WINDOWS windows
SEARCH_ROWS = 10_000
SEARCH_WINDOWS = 20
MIN_SAVING = 0.03  # share of the loss of all motors that the selected terms must save
_DIVERGED = 1e6  # loss


def fit_grey_boxes(
    data: TrainingData,
    recipe: Recipe,
    seed: int,
    report: ReportProgress,
    checkpoint: Checkpoint,
    selectable_terms: tuple[str, ...],
) -> tuple[TrainingResult, np.ndarray, np.ndarray]:
    """The fitted motors, and the assumed and the minimum standard deviations (Z,) of their latents.

    Arguments and errors as for `identify`.
    """
    runs = WindowRuns(data, recipe)
    selection = _selected_terms(data, recipe, seed, report, checkpoint, selectable_terms)
    fits = _fitted_motors(data, recipe, runs, selection.terms, seed, report, checkpoint)
    recipe = replace(recipe, terms=fits.terms, num_latents=len(fits.center))
    model = motor_problem.grey_box(fits.center, fits.terms, recipe)

    report(0, "refining constants")
    longer = refinement.longer_runs(data, recipe, runs)
    z = fits.offsets
    if longer is not runs:
        together = recipe.grey_boxes == "together"
        z = refinement.refined(model, z, longer, together, parts_of("refined", checkpoint))
    z = refinement.with_stiff_gears(model, z, longer, parts_of("stiff_gears", checkpoint))

    tried = bool(selection.saved)
    fixed = motor_problem.fixed_constants(fits.terms, runs)
    notes = notes_on_terms(recipe, tried)
    notes += encoder_notes(model, z, data, recipe, fixed)
    report(0, "uncertainty of constants")
    estimates = estimates_of(model, z, longer)
    is_slow = np.isin(data.joint_names, data.slow_commands)
    if is_slow.any():
        # the logged commands are not those that moved the joint
        estimates = estimates.with_more_variance(UNKNOWN_STD * is_slow[:, None] * ~fixed)
    level = level_of_logs(runs, fits.center, fits.terms)
    if level is not None:
        deviations = sibling_deviations(level, z, fixed)
        estimates = estimates.with_more_variance(deviations)
        notes += outlier_notes(model, z, deviations, data)
    metrics, warnings = identifiability(model, z, longer, estimates, data.joint_names, level)
    metrics = replace(metrics, saved_loss=selection.saved)
    notes += warnings
    losses = motor_problem.motor_search(model, runs).losses(z).mean(keepdims=True)
    result = TrainingResult(
        model=model,
        mean=z,
        log_var=np.zeros_like(z),
        recipe=recipe,
        losses=losses,
        metrics=metrics,
        notes=tuple(notes),
        estimates=estimates,
    )

    # a limit that the logs do not identify varies widely between motors
    assumed = assumed_std(fits.terms, fixed)
    min_std = np.zeros_like(assumed)
    for column, name in enumerate(parameters_of(fits.terms)):
        if assumed[column] == 0.0 or name not in LIMITS or metrics.identified.get(name, True):
            continue
        min_std[column] = UNIDENTIFIED_LIMIT_STD
        if level is not None and level.is_stated[:, column].all():
            min_std[column] = level.stated_std[:, column].max()
    return result, assumed, min_std


def _selected_terms(
    data: TrainingData,
    recipe: Recipe,
    seed: int,
    report: ReportProgress,
    checkpoint: Checkpoint,
    selectable_terms: tuple[str, ...],
) -> Selection:
    """Optional terms, selected on some motors and rows of the logs."""
    if not recipe.tries_terms:
        report(WORK * len(TERMS), "no terms are tried")
        return Selection(recipe.logged_terms, {})

    min_rows = term_selection.MIN_WINDOWS * recipe.window
    subset = subsampled(data, recipe, max(term_selection.MAX_ROWS, min_rows))
    motors = term_selection.some_motors(subset.joint_classes, len(subset.series))

    # reports of later rounds have no work: their number is unknown
    remaining = [WORK] * len(TERMS)

    def report_text(text: str) -> None:
        report(remaining.pop() if remaining else 0, text)

    runs = WindowRuns(subset, recipe, motors)
    selection = term_selection.select_terms(runs, seed, report_text, checkpoint, selectable_terms)
    report(sum(remaining), "terms selected")
    return selection


def _fitted_motors(
    data: TrainingData,
    recipe: Recipe,
    runs: WindowRuns,
    terms: tuple[str, ...],
    seed: int,
    report: ReportProgress,
    checkpoint: Checkpoint,
) -> MotorFits:
    """The fit of all motors, with the selected ``terms`` if they save enough.

    Raises `MotorPriorError` if every simulation diverges.
    """
    rows = max(SEARCH_ROWS, SEARCH_WINDOWS * recipe.window)
    subset_data = subsampled(data, recipe, rows)
    subset = runs if subset_data is data else WindowRuns(subset_data, recipe)
    together = recipe.grey_boxes == "together"

    def fit(
        name: str,
        terms: tuple[str, ...],
        report_stage: Callable[[], None],
        nested: MotorFits | None,
    ) -> MotorFits:
        def arrays() -> Arrays:
            fits = motor_fit.fit_motors(
                runs,
                terms,
                together,
                seed,
                report_stage,
                subset,
                nested,
                checkpoint=parts_of(name, checkpoint),
            )
            return {"center": fits.center, "offsets": fits.offsets, "loss": fits.loss}

        saved = checkpoint(name, arrays)
        return MotorFits(saved["center"], saved["offsets"], saved["loss"], terms)

    def report_constants() -> None:
        report(WORK, "constants of each motor")

    def report_terms() -> None:
        report(0, f"with {', '.join(terms)}")

    fits = fit("motors", recipe.logged_terms, report_constants, None)
    if set(terms) - set(recipe.logged_terms):
        with_terms = fit("motors_with_terms", terms, report_terms, fits)
        saves_enough = with_terms.loss.mean() <= (1.0 - MIN_SAVING) * fits.loss.mean()
        new_limits = [
            name for name in terms if TERMS[name].is_limit and name not in recipe.logged_terms
        ]
        if saves_enough or binding_windows(runs, with_terms.outputs, terms, new_limits).any():
            fits = with_terms

    if not fits.loss.max() < _DIVERGED:
        joint = int(fits.loss.argmax())
        raise MotorPriorError(
            f"the simulation of joint {joint} of the log diverges with every motor",
            remedy="check the log with `motorprior logs check`",
        )
    return fits
