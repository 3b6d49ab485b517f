"""Compare fitted motors with simpler models on parts of their log.

The log is cut into chunks, every second of which is held out from the simpler models: the responses
of `response_fit`, or under velocity and torque control rigid motors with Coulomb and viscous
friction; and the physics of each motor alone, without the other motors. The fitted motors have seen
all chunks, so the comparison favours them.
"""

from dataclasses import replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.evaluation.errors import PER_MOTOR, PRIOR, LogErrors
from motorprior.evaluation.free_runs import MotorModel, free_run_errors
from motorprior.evaluation.splits import alternating_chunks
from motorprior.exceptions import LogError
from motorprior.identification.baselines.response_fit import fitted_responses
from motorprior.identification.physics.motor_fit import fit_rigid_motors
from motorprior.identification.physics.motor_problem import grey_box
from motorprior.identification.physics.refinement import refined
from motorprior.identification.physics.window_runs import WindowRuns, whole_runs
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints
from motorprior.progress import Note, Progress

SECONDS = 20.0  # duration of the training chunks, and of the held-out chunks
MAX_JOINTS = 6  # joints that are compared, evenly spread over those that move
COULOMB_VISCOUS = "coulomb_viscous"
TOO_SHORT = (
    "the log is too short to hold a part of it out: a simpler model, such as a response of the "
    "commands, may predict better -> record at least half a minute, or compare by validate"
)
_HELD_OUT = "chunks of the log that it was not fitted to"


def better_baselines(
    model: GreyBox, x: np.ndarray, log: MotorLog, recipe: Recipe, seed: int, progress: Progress
) -> list[Note]:
    """A warning if a simpler model has smaller errors than the motors x (M, K) of a log.

    ``model`` has one latent per constant. The warning is about the best of the simpler models. For
    a short log, there is a note that they cannot be compared.
    """
    excited = excited_joints(log)
    places = np.linspace(0, len(excited) - 1, min(len(excited), MAX_JOINTS))
    joints = [int(excited[round(place)]) for place in places.tolist()]
    try:
        train, test = alternating_chunks(log.with_joints(joints), SECONDS)
    except LogError:
        return [Note("info", TOO_SHORT)]

    models: dict[str, MotorModel] = dict(fitted_responses(train, recipe, seed, progress))
    if not models:  # velocity or torque commands
        models[COULOMB_VISCOUS] = _fitted_rigid(train, recipe, seed)
    if recipe.grey_boxes == "together" and len(x) > 1:
        alone = _fitted_alone(model, x[joints], train, recipe)
        models[PER_MOTOR] = model.motors(alone)
    models[PRIOR] = model.motors(x[joints])
    errors = free_run_errors(whole_runs(test, recipe), models)
    best = min(errors, key=lambda name: float(np.mean(errors[name])))
    compared = {name: errors[name][None] for name in dict.fromkeys((best, PRIOR))}
    warnings = LogErrors((_HELD_OUT,), test.joint_names, compared).warnings(PRIOR)
    return [Note("warning", text) for text in warnings]


def _fitted_alone(model: GreyBox, x: np.ndarray, train: MotorLog, recipe: Recipe) -> np.ndarray:
    """(M, K) motors, each fitted to its own training rows from x (M, K)."""
    return refined(model, x, _runs(train, recipe), together=False)


def _fitted_rigid(train: MotorLog, recipe: Recipe, seed: int) -> GreyBoxActuator:
    """Rigid motors with Coulomb and viscous friction, each fitted to its own training rows."""
    runs = _runs(train, recipe)
    fits = fit_rigid_motors(runs, recipe.logged_terms, seed)
    return grey_box(fits.center, fits.terms, runs.recipe).motors(fits.offsets)


def _runs(train: MotorLog, recipe: Recipe) -> WindowRuns:
    train = replace(train, joint_torque=None)
    recipe = with_window_that_fits(recipe, train)
    return WindowRuns(training_data(train, recipe, train.source), recipe)
