"""Compare fitted motors with simpler models on parts of their log.

The log is cut into chunks, every second of which is held out from the simpler models: the responses
of `response_fit`, and the physics of each motor alone, without the other motors. The fitted motors
have seen all chunks, so the comparison favours them.
"""

from dataclasses import replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.evaluation.errors import PER_MOTOR, PRIOR, LogErrors
from motorprior.evaluation.free_runs import MotorModel, free_run_errors
from motorprior.evaluation.splits import alternating_chunks
from motorprior.exceptions import LogError
from motorprior.identification.baselines.response_fit import fitted_responses
from motorprior.identification.physics.refinement import refined
from motorprior.identification.physics.window_runs import WindowRuns, whole_runs
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints
from motorprior.progress import Progress

SECONDS = 20.0  # duration of the training chunks, and of the held-out chunks
MAX_JOINTS = 6  # joints that are compared, evenly spread over those that move
_HELD_OUT = "chunks of the log that it was not fitted to"


def better_baselines(
    model: GreyBox, x: np.ndarray, log: MotorLog, recipe: Recipe, seed: int, progress: Progress
) -> list[str]:
    """A warning if a simpler model has smaller errors than the motors x (M, K) of a log.

    ``model`` has one latent per constant. The warning is about the best of the simpler models.
    """
    if log.command_mode in ("velocity", "torque"):  # there are no responses
        return []
    excited = excited_joints(log)
    places = np.linspace(0, len(excited) - 1, min(len(excited), MAX_JOINTS))
    joints = [int(excited[round(place)]) for place in places.tolist()]
    try:
        train, test = alternating_chunks(log.with_joints(joints), SECONDS)
    except LogError:  # too short a log
        return []

    models: dict[str, MotorModel] = dict(fitted_responses(train, recipe, seed, progress))
    if recipe.grey_boxes == "together" and len(x) > 1:
        alone = _fitted_alone(model, x[joints], train, recipe)
        models[PER_MOTOR] = model.motors(alone)
    models[PRIOR] = model.motors(x[joints])
    errors = free_run_errors(whole_runs(test, recipe), models)
    best = min(errors, key=lambda name: float(np.mean(errors[name])))
    compared = {name: errors[name][None] for name in dict.fromkeys((best, PRIOR))}
    return LogErrors((_HELD_OUT,), test.joint_names, compared).warnings(PRIOR)


def _fitted_alone(model: GreyBox, x: np.ndarray, train: MotorLog, recipe: Recipe) -> np.ndarray:
    """(M, K) motors, each fitted to its own training rows from x (M, K)."""
    train = replace(train, joint_torque=None)
    recipe = with_window_that_fits(recipe, train)
    runs = WindowRuns(training_data(train, recipe, train.source), recipe)
    return refined(model, x, runs, together=False)
