"""Whatever a prior says of its recipe is one that a training can have been made with, or refused by name and value."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import PRESETS, Preset
from motorprior.pipeline.recipe import recipe_of

PATH = Path("mine.safetensors")
RECIPE = replace(PRESETS["rollout"], taps=(0, 2, 5), num_latents=3)


@pytest.fixture
def prior_with(grey_network: Callable[..., LatentNetwork]) -> Callable[[Any], MotorPrior]:
    """A prior whose provenance holds this recipe."""
    network, z = grey_network(), np.zeros((2, 3))

    def make(recipe: Any) -> MotorPrior:
        return MotorPrior(network, z, z, "rollout", "pupper_v2", "m", {"recipe": recipe}, {})

    return make


def as_json(preset: Preset) -> dict[str, Any]:
    return json.loads(json.dumps(asdict(preset)))


def test_the_recipe_that_identify_writes_is_read(prior_with: Callable[[Any], MotorPrior]):
    for recipe in (RECIPE, replace(RECIPE, firmware=(("dead_zone", 0.002), ("profile_speed", 3.0)))):
        assert recipe_of(prior_with(as_json(recipe)), PATH) == recipe


WRONG = {
    "objective": ("paper", 1, ["rollout"]),
    "period": ("fast", 0.0, -1.0, 10**400, True, 0.003),
    "taps": (5, "0", [0, "2"], [0, 2.0, 5], [False, 2, 5], [], [0, 2, 6]),
    "has_armature": (1, "no", True),
    "grey_box": (1, None, False),
    "num_latents": (3.0, "3", -1, True, 10**400, 4),
    "num_neurons": (8.5, -1, 10_001, None),
    "kl_weight": ("small", -1e-9, 10**400, False),
    "warm_up": (1.5, -1, "120", True, 99_937, 10**400),
    "window": ("abc", 0, -1, 1.5, None, True, [64], 99_881, 10**400),
    "noisy": (0, 0.5, "all"),
    "batch": (0, 2.5, True),
    "steps": (0, 1e3, "many"),
    "learning_rate": (0.0, -1.0, "fast", 10**400),
    "own_latents": (1, "yes"),
    "physics_first": (None, True, "apart"),
    "terms": (None, "heat", ["warmth"], [1], ["heat"]),
    "tries_terms": (1, "no"),
    "lacks": (None, "coulomb", ["rust"], [1]),
    "gain_unit": (None, "A/rad", "firmware"),
    "firmware": (
        None,
        {},
        ["dead_zone"],
        [["rust", 1.0]],
        [["dead_zone", 2.0]],
        [["dead_zone", "1"]],
        [["dead_zone"]],
        [[[], 1.0]],
    ),
    "conditions": (
        None,
        {},
        ["supply_voltage"],
        [["humidity", 1.0, 1.0, 1.0]],
        [["supply_voltage", 7.0]],
        [["supply_voltage", 7.0, "7", 7.0]],
        [["supply_voltage", 7.0, 7.0, 1e9]],
        [[[], 1.0, 1.0, 1.0]],
    ),
    "standardise": (1.0, {}),
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_a_recipe_with_a_wrong_entry_is_refused(prior_with: Callable[[Any], MotorPrior], name: str, value: object):
    with pytest.raises(ArtifactError) as error:
        recipe_of(prior_with(as_json(RECIPE) | {name: value}), PATH)
    assert error.value.where == PATH and error.value.remedy == "identify it again"
    of_the_network = "not its network's" in error.value.problem
    of_the_window = name in ("window", "warm_up") and "are 100001 rows, beyond 100000" in error.value.problem
    shown = f"{value:.6g}" if isinstance(value, float) else repr(value)[:30]  # of more, the beginning
    as_declared = error.value.problem.startswith(f"recipe: {name} = {shown}") and " is not " in error.value.problem
    assert as_declared or of_the_network or of_the_window
