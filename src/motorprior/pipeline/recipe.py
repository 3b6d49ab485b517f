"""The recipe in a prior's provenance, checked before anything computes with it."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import PRESETS, Preset

LONGEST_WINDOW = 100_000
"""Rows, history included."""
_RANGES = {
    "period": (1e-6, 1.0), "num_latents": (0, 1000), "num_neurons": (1, 10_000), "kl_weight": (0.0, 1e6),
    "warm_up": (0, LONGEST_WINDOW), "window": (1, LONGEST_WINDOW), "batch": (1, 10**6),
    "steps": (1, 10**9), "learning_rate": (1e-12, 1e3),
}  # fmt: skip
"""(least, most) of the numbers of a Preset."""
_KINDS = {"bool": "true or false", "int": "an integer", "float": "a number", "str": "a text"}
_OBJECTIVES = ("torque", "rollout")
_ANEW = "identify it anew"


def recipe_of(prior: MotorPrior, where: str | Path) -> Preset:
    """The recipe a prior was trained with.

    Raises:
        ArtifactError: its provenance does not say, or says what no training can have been made with; names the entry,
            its value and its bounds.
    """
    recipe: Any = prior.provenance.get("recipe")
    if not isinstance(recipe, dict):
        raise ArtifactError("its provenance holds no recipe", where=where, remedy=_ANEW)
    known = {field.name: str(field.type) for field in fields(Preset)}
    needed = {field.name for field in fields(Preset) if field.default is MISSING}
    if odd := sorted((recipe.keys() - known.keys()) | (needed - recipe.keys())):
        problem = f"the recipe in its provenance lacks, or should not have, {', '.join(odd)[:80]}"
        raise ArtifactError(problem, where=where, remedy=_ANEW)
    for name, value in recipe.items():
        if wrong := _wrong(name, known[name], value):
            raise ArtifactError(f"recipe: {name} = {str(value)[:40]} is not {wrong}", where=where, remedy=_ANEW)
    preset = Preset(**{**recipe, "taps": tuple(recipe["taps"])})
    _require_fit(preset, prior, where)
    return preset


def _wrong(name: str, kind: str, value: Any) -> str:
    """What ``value`` should be and is not; nothing if it is."""
    if kind not in _KINDS:
        right = isinstance(value, list) and all(type(tap) is int for tap in value)
        return "" if right else "a list of integers"
    if not (type(value).__name__ == kind or (kind == "float" and type(value) is int)):
        return _KINDS[kind]
    if name == "objective":
        return "" if value in _OBJECTIVES else " or ".join(_OBJECTIVES)
    least, most = _RANGES.get(name, (value, value))
    return "" if least <= value <= most else f"from {least:g} to {most:g}"


def _require_fit(preset: Preset, prior: MotorPrior, where: str | Path) -> None:
    network, named = prior.network, PRESETS.get(prior.preset)
    fits = (preset.taps, preset.period, preset.num_latents, preset.grey_box, preset.has_armature) == (
        network.taps, network.period, network.num_latents, network.motor is not None, network.has_armature,
    )  # fmt: skip
    if not fits or (named is not None and named.objective != preset.objective):
        raise ArtifactError("the recipe in its provenance is not its network's", where=where, remedy=_ANEW)
    if preset.history + preset.window > LONGEST_WINDOW:
        problem = f"recipe: history and window are {preset.history + preset.window} rows, beyond {LONGEST_WINDOW}"
        raise ArtifactError(problem, where=where, remedy=_ANEW)
