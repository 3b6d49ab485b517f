"""Fit a motor prior: grey boxes by one search (`motor_fit`), or a network by Adam (`networks.descent`).

Optional terms of grey boxes are selected on some motors and some rows (`term_selection`), where a
gain may be due to chance. All motors are therefore fitted without the selected terms, and with them
from these fits; the terms are kept if they save MIN_GAIN of the loss of all motors. The constants
are refined on longer runs.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import (
    IDENTIFIED,
    UNIDENTIFIED,
    UNKNOWN_TORQUE_SCALE,
    Decoder,
    limit_text,
)
from motorprior.actuator.optional_terms import SIGNED, TERMS
from motorprior.exceptions import MotorPriorError, listed
from motorprior.identification.latents.standardise import LIMIT_STD, assumed_std, standard_posterior
from motorprior.identification.physics import motor_fit, motor_problem, term_selection
from motorprior.identification.physics.motor_fit import Arrays, Checkpoint, MotorFits, unsaved
from motorprior.identification.physics.term_selection import Selection, min_difference, select_terms
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData, subsampled
from motorprior.progress import Note, ReportProgress

WORK = 100  # progress units per stage of a grey-box fit, in Adam steps
# rows per motor in all but the last descents, or windows if more
SEARCH_ROWS = 10_000
SEARCH_WINDOWS = 20
MIN_GAIN = 0.03  # share of the loss of all motors that the selected terms must save


@dataclass(frozen=True)
class TrainingResult:
    """A decoder with the posteriors of the training motors."""

    model: Decoder  # decoder of the prior
    mean: np.ndarray  # (M, Z)
    log_var: np.ndarray  # (M, Z)
    recipe: Recipe  # the recipe, with the terms that were selected
    # means of every `descent.CHUNK` steps, or of the finished fits on the recipe's own windows
    losses: np.ndarray
    # ``saved_TERM``: saved share of held-out loss; ``unidentified_LIMIT``,
    # ``unknown_torque_scale``: `motor_prior`
    metrics: dict[str, float]
    notes: tuple[Note, ...]
    classes: ClassLatents | None = None  # joint classes of the prior; None: one class


def work_of(recipe: Recipe) -> int:
    """Sum of the work that `identify` reports, if nothing diverges."""
    return WORK * (len(TERMS) + motor_fit.STAGES) if recipe.grey_boxes else recipe.steps


def identify(
    data: TrainingData,
    recipe: Recipe,
    seed: int,
    report: ReportProgress = lambda work, text: None,
    checkpoint: Checkpoint = unsaved,
) -> TrainingResult:
    """Train a prior, deterministically. Raises `MotorPriorError` if it diverges.

    ``checkpoint`` saves searches and fitted motors of grey boxes for a run that continues this one.
    """
    assumed = None
    least_std = 0.0
    if recipe.grey_boxes:
        found, assumed, least_std = _grey_boxes(data, recipe, seed, report, checkpoint)
    else:
        from motorprior.identification.networks.descent import train_network  # here: it imports JAX

        model, mean, log_var, losses = train_network(data, recipe, seed, report)
        found = TrainingResult(model, mean, log_var, recipe, losses, {}, ())
    if recipe.standardise:
        model, mean, log_var, classes = standard_posterior(
            found.model, data, found.recipe, found.mean, assumed, least_std
        )
        found = replace(found, model=model, mean=mean, log_var=log_var, classes=classes)
    return found


def _grey_boxes(
    data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress, checkpoint: Checkpoint
) -> tuple[TrainingResult, np.ndarray, np.ndarray]:
    """The fitted motors, and the assumed and the minimum standard deviations (Z,) of their latents."""
    runs = WindowRuns(data, recipe)
    chosen = _selected(data, recipe, seed, report, checkpoint)
    found = _fitted(data, recipe, runs, chosen.terms, seed, report, checkpoint)
    recipe = replace(recipe, terms=found.terms, num_latents=len(found.center))
    metrics = {f"saved_{name}": value for name, value in chosen.saved.items()}
    model = motor_problem.grey_box(found.center, found.terms, recipe)
    report(0, "refining constants")
    longer = motor_fit.longer_runs(data, recipe, runs)
    z = found.offsets
    if longer is not runs:
        z = motor_fit.refined(model, z, longer, recipe.grey_boxes == "together")
    z = motor_fit.with_stiff_gears(model, z, longer)
    notes = _notes_on_terms(recipe, bool(chosen.saved))
    notes += _notes_on_identifiability(model, z, longer, data.joint_names, metrics)
    losses = motor_problem.motor_search(model, runs).losses(z).mean(keepdims=True)
    assumed = assumed_std(found.terms, motor_problem.fixed_constants(found.terms, runs))
    unseen = [
        name in motor_problem.LIMITS and not metrics[f"{IDENTIFIED}{name}"]
        for name in parameters_of(found.terms)
    ]
    result = TrainingResult(model, z, np.zeros_like(z), recipe, losses, metrics, tuple(notes))
    return result, assumed, np.where((assumed > 0.0) & unseen, LIMIT_STD, 0.0)


def _selected(
    data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress, checkpoint: Checkpoint
) -> Selection:
    if not recipe.tries_terms:
        report(WORK * len(TERMS), "no terms are tried")
        return Selection(recipe.logged_terms, {})
    part = subsampled(
        data, recipe, max(term_selection.MAX_ROWS, term_selection.MIN_WINDOWS * recipe.window)
    )
    motors = len(part.series)
    some = np.unique(np.linspace(0, motors - 1, min(term_selection.MAX_MOTORS, motors)).astype(int))
    left = [WORK] * len(TERMS)  # the number of later rounds is unknown
    runs = WindowRuns(part, recipe, some)
    chosen = select_terms(
        runs, seed, lambda text: report(left.pop() if left else 0, text), checkpoint
    )
    report(sum(left), "terms selected")
    return chosen


def _fitted(
    data: TrainingData,
    recipe: Recipe,
    runs: WindowRuns,
    terms: tuple[str, ...],
    seed: int,
    report: ReportProgress,
    checkpoint: Checkpoint,
) -> MotorFits:
    """The fit with the selected terms if they save enough; raises `MotorPriorError` if every simulation diverges."""
    some = subsampled(data, recipe, max(SEARCH_ROWS, SEARCH_WINDOWS * recipe.window))
    part = runs if some is data else WindowRuns(some, recipe)
    together = recipe.grey_boxes == "together"

    def fitted(
        name: str, terms: tuple[str, ...], report: Callable[[], None], nested: MotorFits | None
    ) -> MotorFits:
        def arrays() -> Arrays:
            fit = motor_fit.fit_motors(runs, terms, together, seed, report, part, nested)
            return {"center": fit.center, "offsets": fit.offsets, "loss": fit.loss}

        saved = checkpoint(name, arrays)
        return MotorFits(saved["center"], saved["offsets"], saved["loss"], terms)

    found = fitted("motors", recipe.logged_terms, lambda: report(WORK, "constants"), None)
    if set(terms) - set(recipe.logged_terms):
        more = fitted(
            "motors_with_terms", terms, lambda: report(0, f"with {', '.join(terms)}"), found
        )
        found = more if more.loss.mean() <= (1.0 - MIN_GAIN) * found.loss.mean() else found
    if not found.loss.max() < 1e6:
        raise MotorPriorError(
            f"the simulation of joint {int(found.loss.argmax())} of the log diverges with every motor",
            remedy="check the log with `motorprior logs check`",
        )
    return found


def _notes_on_terms(recipe: Recipe, tried: bool) -> list[Note]:
    chosen = [f"{name} (logged)" if name in recipe.logged_terms else name for name in recipe.terms]
    none = "none" if tried else "none was tried"
    notes = [Note("info", f"optional terms: {', '.join(chosen) or none}")]
    if recipe.tries_terms:
        return notes

    for name, low, nominal, high in recipe.conditions:
        if high - low >= min_difference(name, nominal):
            text = (
                f"{name} varies from {low:.3g} to {high:.3g} in these logs, which a recipe "
                "without optional terms ignores -> use preset rollout or long_runs"
            )
            notes.append(Note("warning", text))
    return notes


def _notes_on_identifiability(
    model: GreyBox,
    z: np.ndarray,
    runs: WindowRuns,
    names: tuple[str, ...],
    metrics: dict[str, float],
) -> list[Note]:
    """Notes on limits and on a scale of torques that the logs do not identify, also added to ``metrics``."""

    def logs(hidden: np.ndarray) -> str:
        named = (
            f" ({listed([names[motor] for motor in np.flatnonzero(hidden)], 6)})" if names else ""
        )
        return f"the logs of {hidden.sum()} of {len(hidden)} motors{named} do not identify"

    names_of = parameters_of(model.terms)
    identified = motor_problem.identifiable_constants(
        model, runs, z, [name for name in names_of if name not in SIGNED]
    )
    metrics |= {
        f"{IDENTIFIED}{name}": float(name in identified) for name in names_of if name not in SIGNED
    }
    notes = []
    free = ~motor_problem.fixed_constants(model.terms, runs)
    reached = motor_problem.near_bounds(z, model.center) & free
    for name, motors in zip(names_of, reached.T, strict=True):
        if motors.any():
            text = f"{logs(motors)} {name}: it is at the bound of the search -> do not interpret it"
            notes.append(Note("warning", text))
    for name, hidden in motor_problem.unidentifiable_limits(model, runs, z).items():
        value = float(model.constants(z)[name][hidden].max())
        metrics[f"{UNIDENTIFIED}{name}"] = value
        limit = limit_text(name, value)
        text = f"{logs(hidden)} the fitted {limit}; policies may over-rely on it"
        notes.append(Note("warning", text))
    hidden = motor_problem.unknown_torque_scale(model, runs, z)
    if hidden.any():
        metrics[UNKNOWN_TORQUE_SCALE] = float(hidden.sum())
        text = (
            f"{logs(hidden)} the scale of torques; only ratios of kp, torque limit, armature "
            "and friction are physical -> log kp in N·m/rad, or motions under larger loads"
        )
        notes.append(Note("warning", text))
    return notes
