"""Result of an identification."""

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.estimates import Estimates
from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.motor_prior import Decoder
from motorprior.identification.presets import Recipe
from motorprior.progress import Note


@dataclass(frozen=True)
class TrainingResult:
    """A decoder with the posteriors of the training motors."""

    # decoder of the prior
    model: Decoder
    # (M, Z) latents of the training motors
    mean: np.ndarray
    # (M, Z) logarithms of the variances of the latents
    log_var: np.ndarray
    # the recipe, with the terms that were selected
    recipe: Recipe
    # means of every `descent.CHUNK` steps, or of the finished fits on the recipe's own windows
    losses: np.ndarray
    # of grey boxes: what their logs identify, and the loss that tried terms save
    metrics: FitMetrics
    notes: tuple[Note, ...]
    # joint classes of the prior; None: one class
    classes: ClassLatents | None = None
    # uncertainty of the constants of grey boxes from their logs
    estimates: Estimates | None = None
