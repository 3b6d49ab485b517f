"""The recipe in a prior's provenance."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import Preset


def recipe_of(prior: MotorPrior, where: str | Path) -> Preset:
    """The recipe that a prior was trained with.

    Raises:
        ArtifactError: it is missing, or its entries are not those of this version.
    """
    try:
        recipe = prior.provenance["recipe"]
        if recipe.keys() != {field.name for field in fields(Preset)}:
            raise KeyError("other entries")
        return Preset(**{name: _hashable(value) for name, value in recipe.items()})
    except (KeyError, AttributeError, TypeError) as error:
        problem = f"its provenance does not hold a recipe of this version ({error})"
        raise ArtifactError(problem, where=where, remedy="identify it again") from error


def _hashable(value: Any) -> Any:
    """With tuples in place of the lists that JSON has."""
    return tuple(map(_hashable, value)) if isinstance(value, list) else value
