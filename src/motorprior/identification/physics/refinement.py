"""Last steps of a fit of motors: longer free runs, and constants that the logs do not identify.

Long free runs identify constants that short ones confuse, but a search on them ends in poor optima.
The search therefore uses short runs, and `refined` takes the last steps on longer ones.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, PARAMETERS
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification.checkpoint import PartCheckpoint, unsaved_part
from motorprior.identification.physics.descents import FINEST, STEPS
from motorprior.identification.physics.motor_model_fit import (
    ModelLevel,
    level_of_logs,
    likelihood_scale,
    refined_with_models,
)
from motorprior.identification.physics.motor_problem import (
    WEAK_PRECISION,
    fixed_constants,
    initial_center,
    motor_search,
    single_motor_prior,
)
from motorprior.identification.physics.population_fit import population_prior, posterior_variance
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.search import (
    FIXED,
    NARROW,
    WIDE,
    GaussianPrior,
    Search,
    Steps,
)
from motorprior.identification.windows import TrainingData

# factors on constants of the initial motor that make its gear stiff. Short velocity filters are not
# tried in this way: that costs two of five mrad in an unseen leg of a real quadruped
STIFF_GEAR = {"gear_stiffness": 140.0, "backlash": 1e-4}
# less than `near_bounds`, which marks constants that the search could not reach
_WITHIN = 0.98 * MAX_LOG_FACTOR
# `longer_runs`
LONGER_WINDOW = 200  # [steps]
MIN_LONGER_WINDOWS = 10
MAX_LOST_ROWS = 0.2  # share of the rows
# refinement: wide differences average over ripples, narrow ones find the minimum
REFINEMENT = ((10, WIDE), (10, NARROW), (10, FINEST))


def with_stiff_gears(
    model: GreyBox,
    x: np.ndarray,
    runs: WindowRuns,
    checkpoint: PartCheckpoint = unsaved_part,
) -> np.ndarray:
    """(M, K) latents with stiff gears without backlash, in classes that fit better with them.

    Otherwise a compliance that the logs do not identify explains a part of the delay, and the
    fitted delay is too short. All motors of a class, or of a motor model, get the same kind of
    gear, since the mean of stiff and compliant gears is neither stiff nor compliant.
    """
    terms = model.terms
    fixed = fixed_constants(terms, runs)
    level = level_of_logs(runs, model.center, terms)
    initial = initial_center(terms, runs) - model.center
    stiff = {}
    for name, factor in STIFF_GEAR.items():
        column = PARAMETERS.index(name)
        stiff[column] = np.clip(initial[column] + np.log(factor), -_WITHIN, _WITHIN)
    return _set_where_cheap(
        motor_search(model, runs, checkpoint),
        x,
        fixed,
        stiff,
        STEPS[1:],
        runs.classes if level is None else level.index,
        max_cost=0.0,
        level=level,
    )


def _set_where_cheap(
    search: Search,
    x: np.ndarray,
    fixed: np.ndarray,
    values: dict[int, Any],
    steps: Steps,
    groups: np.ndarray,
    max_cost: float,
    level: ModelLevel | None = None,
) -> np.ndarray:
    """(M, K) unknowns, of which some columns are set to given values if that costs little.

    If the columns of a motor are set, its other unknowns descend from x (M, K). All unknowns stay
    the same if one of the columns is fixed.

    Args:
        search: of the motors' problems.
        x: unknowns of the fit.
        fixed: (K,) mask of the constants that are not fitted.
        values: column -> value, or values (M,).
        steps: of the descent of the other unknowns.
        groups: (M,) motors of one group decide together, by their mean cost.
        max_cost: largest share of the loss that the values may cost.
        level: motor models; the motors stay near the means of their models at x.
    """
    if fixed[list(values)].any():
        return x

    start = x.copy()
    frozen = fixed.copy()
    for column, value in values.items():
        start[:, column] = value
        frozen[column] = True
    precision = np.broadcast_to(np.where(frozen, FIXED, WEAK_PRECISION), x.shape)
    prior = GaussianPrior(start, precision)
    if level is not None:
        scale = likelihood_scale(search, search.losses(x))
        near_siblings = level.prior_of(x, scale, fixed)
        prior = GaussianPrior(
            np.where(frozen, start, near_siblings.mean),
            np.where(frozen, FIXED, near_siblings.precision),
        )
    changed = search.descend(start, prior, steps)

    growth = np.log(changed.loss / search.at(x, prior).loss)  # (M,)
    max_growth = -np.log(1.0 - max_cost)
    allowed = np.array([growth[groups == group].mean() <= max_growth for group in groups])
    return np.where(allowed[:, None], changed.x, x)


def longer_runs(data: TrainingData, recipe: Recipe, runs: WindowRuns) -> WindowRuns:
    """Free runs of about LONGER_WINDOW steps.

    Returns ``runs``, with the windows of the recipe, if they are as long, or if longer windows lose
    more than MAX_LOST_ROWS of the rows or are fewer than MIN_LONGER_WINDOWS.
    """
    # equal windows that fill the median segment
    lengths = []
    for segment in data.segments:
        lengths.append(segment.stop - segment.start - 1 - recipe.history)
    lengths = np.array(lengths)
    length = int(np.median(lengths[lengths >= recipe.window]))
    window = length // max(1, round(length / LONGER_WINDOW))
    if window <= recipe.window:
        return runs

    longer = WindowRuns(data, replace(recipe, window=window))
    rows = runs.windows * recipe.window
    keeps_rows = longer.windows * window >= (1.0 - MAX_LOST_ROWS) * rows
    return longer if keeps_rows and longer.windows >= MIN_LONGER_WINDOWS else runs


def refined(
    model: GreyBox,
    x: np.ndarray,
    runs: WindowRuns,
    together: bool,
    checkpoint: PartCheckpoint = unsaved_part,
) -> np.ndarray:
    """(M, K) latents after Gauss-Newton steps from x (M, K) on ``runs``.

    The runs are longer than the runs of the search.

    Motors that are fitted ``together`` have the prior of `motor_model_fit` if their models are
    stated, and otherwise the Gaussian over the motors, estimated at x. Motors that are fitted alone
    have `single_motor_prior` around x.
    """
    search = motor_search(model, runs, checkpoint)
    terms = model.terms
    fixed = fixed_constants(terms, runs)
    initial = initial_center(terms, runs) - model.center
    level = level_of_logs(runs, model.center, terms) if together else None
    if level is not None:
        fit = refined_with_models(search, x, fixed, level)
        return np.where(fixed, x, np.clip(fit.x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR))

    prior = single_motor_prior(search, x, x, initial).fixing(fixed)
    if together and len(x) > 1:
        fit = search.at(x, prior)
        certain = population_prior(fit, runs.windows, 0.0, runs.classes).fixing(fixed)
        variance = posterior_variance(search, fit, certain)
        prior = population_prior(fit, runs.windows, variance, runs.classes).fixing(fixed)

    # fixed constants stay at x, not at 0
    prior = replace(prior, mean=np.where(fixed, x, prior.mean))
    descended = search.descend(x, prior, REFINEMENT).x
    return np.where(fixed, x, np.clip(descended, -MAX_LOG_FACTOR, MAX_LOG_FACTOR))
