"""Fit a motor prior to motor logs: grey boxes by one search, or a network by Adam."""

from dataclasses import replace

from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.optional_terms import TERMS
from motorprior.identification.checkpoint import Checkpoint, unsaved
from motorprior.identification.grey_box_fit import WORK, fit_grey_boxes
from motorprior.identification.latents.standardise import standard_posterior
from motorprior.identification.physics import motor_fit
from motorprior.identification.physics.term_selection import SELECTABLE_TERMS
from motorprior.identification.presets import Recipe
from motorprior.identification.training_result import TrainingResult
from motorprior.identification.windows import TrainingData
from motorprior.progress import ReportProgress


def work_of(recipe: Recipe) -> int:
    """Sum of the work that `identify` reports, if nothing diverges."""
    if recipe.grey_boxes:
        return WORK * (len(TERMS) + motor_fit.STAGES)
    return recipe.steps


def identify(
    data: TrainingData,
    recipe: Recipe,
    seed: int,
    report: ReportProgress = lambda work, text: None,
    checkpoint: Checkpoint = unsaved,
    selectable_terms: tuple[str, ...] = SELECTABLE_TERMS,
) -> TrainingResult:
    """Train a prior, deterministically.

    Args:
        data: logs of the training motors.
        recipe: settings of the fit.
        seed: of searches, weights, windows and noise.
        report: called with units of work (`work_of`) and a text.
        checkpoint: saves searches and fitted motors of grey boxes for a run that continues this
            one.
        selectable_terms: optional terms that a recipe with ``tries_terms`` tries.

    Raises:
        MotorPriorError: the training diverges.
    """
    assumed = None  # assumed standard deviations of latents
    min_std = 0.0
    if recipe.grey_boxes:
        result, assumed, min_std = fit_grey_boxes(
            data, recipe, seed, report, checkpoint, selectable_terms
        )
    else:
        from motorprior.identification.networks.descent import train_network  # here: it imports JAX

        model, mean, log_var, losses = train_network(data, recipe, seed, report)
        result = TrainingResult(model, mean, log_var, recipe, losses, FitMetrics(), ())
    if not recipe.standardise:
        return result

    model, mean, log_var, classes = standard_posterior(
        result.model, data, result.recipe, result.mean, assumed, min_std
    )
    return replace(result, model=model, mean=mean, log_var=log_var, classes=classes)
