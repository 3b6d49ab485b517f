"""The recipe in a prior's provenance, checked before anything computes with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import TERMS
from motorprior.bounds import is_number
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import PRESETS, Preset
from motorprior.logs.motor_log import CONDITIONS, FIRMWARE, GAIN_UNITS, is_register
from motorprior.schema import TRUTH, Field, Schema, integer, many, number, one_of

LONGEST_WINDOW = 100_000
"""Rows, history included."""
_REMEDY = "identify it again"


def _is_register(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2 or not isinstance(value[0], str):
        return False
    return value[0] in FIRMWARE and is_register(*value)


def _is_condition(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 4 or not isinstance(value[0], str):
        return False
    return value[0] in CONDITIONS and all(is_number(each, *CONDITIONS[value[0]]) for each in value[1:])


RECIPE = Schema(
    {
        "objective": one_of("torque", "rollout"),
        "period": number(1e-6, 1.0),
        "taps": many(integer(0, LONGEST_WINDOW), least=1),
        **dict.fromkeys(("has_armature", "grey_box", "noisy", "own_latents", "standardise"), TRUTH),
        "physics_first": one_of("", "alone", "together"),
        "gain_unit": one_of("", *GAIN_UNITS),
        "tries_terms": TRUTH,
        "terms": many(one_of(*TERMS)),
        "lacks": many(one_of(*PARAMETERS)),
        "firmware": many(Field("the name and the value of a register", _is_register)),
        "conditions": many(Field("a condition, its least, usual and largest value", _is_condition)),
        "num_latents": integer(0, 1000),
        "num_neurons": integer(0, 10_000),
        "kl_weight": number(0.0, 1e6),
        "warm_up": integer(0, LONGEST_WINDOW),
        "window": integer(1, LONGEST_WINDOW),
        "batch": integer(1, 10**6),
        "steps": integer(1, 10**9),
        "learning_rate": number(1e-12, 1e3),
    },
    _REMEDY,
    name="recipe",
)
"""The entries of a Preset; identify writes all of them, and a default in place of one would be another recipe."""


def recipe_of(prior: MotorPrior, where: str | Path) -> Preset:
    """The recipe a prior was trained with.

    Raises:
        ArtifactError: its provenance lacks an entry, or says what no training can have been made with; names the
            entry, its value and its bounds.
    """
    recipe: Any = prior.provenance.get("recipe")
    if not isinstance(recipe, dict):
        raise ArtifactError("its provenance holds no recipe", where=where, remedy=_REMEDY)
    recipe = {"conditions": []} | recipe  # a prior that an older version wrote knows of none
    RECIPE.check(recipe, where)
    series = {name: tuple(recipe[name]) for name in ("taps", "terms", "lacks")}
    pairs = {key: tuple(tuple(each) for each in recipe[key]) for key in ("firmware", "conditions")}
    preset = Preset(**{**recipe, **series, **pairs})
    _require_fit(preset, prior, where)
    return preset


def _require_fit(preset: Preset, prior: MotorPrior, where: str | Path) -> None:
    network, named = prior.network, PRESETS.get(prior.preset)
    terms = () if network.motor is None else network.motor.terms
    said = (preset.taps, preset.period, preset.num_latents, preset.num_neurons, preset.grey_box, preset.has_armature)
    fits = (*said, preset.terms, preset.gain_unit) == (
        network.taps, network.period, network.num_latents, len(network.w3), network.motor is not None,
        network.has_armature, terms, network.gain_unit,
    )  # fmt: skip
    if not fits or (named is not None and named.objective != preset.objective):
        raise ArtifactError("the recipe in its provenance is not its network's", where=where, remedy=_REMEDY)
    if preset.history + preset.window > LONGEST_WINDOW:
        problem = f"recipe: history and window are {preset.history + preset.window} rows, beyond {LONGEST_WINDOW}"
        raise ArtifactError(problem, where=where, remedy=_REMEDY)
