"""A recipe of another version in a prior's provenance is rejected."""

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


@pytest.mark.parametrize("recipe", [None, [], {"period": 0.002}, {**asdict(RECIPE), "new": 1}], ids=repr)
def test_a_recipe_of_another_version_is_rejected(grey_box: Callable[..., GreyBox], recipe: Any):
    z = np.zeros((2, 3))
    with pytest.raises(ArtifactError, match="identify it again"):
        recipe_of(MotorPrior(grey_box(), z, z, "rollout", "pupper_v2", "m", {"recipe": recipe}, {}))
