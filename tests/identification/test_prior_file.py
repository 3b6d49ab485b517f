"""The recipe in a prior's provenance is read as it was written, or rejected."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import PRESETS, recipe_of

RECIPE = replace(PRESETS["rollout"], taps=(0, 2, 5), num_latents=3, firmware=(("dead_zone", 0.002),))


@pytest.fixture
def prior_with(grey_box: Callable[..., GreyBox]) -> Callable[[Any], MotorPrior]:
    """A prior whose provenance holds this recipe."""
    box, z = grey_box(), np.zeros((2, 3))
    return lambda recipe: MotorPrior(box, z, z, "rollout", "pupper_v2", "m", {"recipe": recipe}, {})


@pytest.mark.parametrize("recipe", [None, [], {"period": 0.002}, {**asdict(RECIPE), "new": 1}], ids=repr)
def test_a_recipe_of_another_version_is_rejected(prior_with: Callable[[Any], MotorPrior], recipe: Any):
    with pytest.raises(ArtifactError, match="identify it again"):
        recipe_of(prior_with(recipe))
