"""Two priors are equal, or a table says where they are not."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior

Command = Callable[..., Any]


def a_prior(network: LatentNetwork, **changes: Any) -> MotorPrior:
    mean = np.random.default_rng(0).standard_normal((5, network.num_latents))
    provenance = {"bench": {"fleet": "mixed", "motors": 5}, "recipe": {"steps": 100, "taps": [0, 2, 5]}}
    metrics = {"loss_mean": 0.5, "minutes_of_log": 3.0}
    return replace(MotorPrior(network, mean, mean - 3, "rollout", "pupper_v2", "m", provenance, metrics), **changes)


@pytest.fixture
def one(grey_network: Callable[..., LatentNetwork], tmp_path: Path) -> tuple[MotorPrior, Path]:
    prior = a_prior(grey_network(network=0.5, armature=0.002))
    prior.save(tmp_path / "one.safetensors")
    return prior, tmp_path / "one.safetensors"


def other_of(prior: MotorPrior, folder: Path) -> Path:
    prior.save(folder / "other.safetensors")
    return folder / "other.safetensors"


def test_a_file_equals_itself_and_its_copy(one, tmp_path: Path, motorprior: Command):
    copy = Path(shutil.copy(one[1], tmp_path / "copy.safetensors"))
    outcome = motorprior("diff", one[1], copy, "--json", tmp_path / "diff.json")
    assert outcome.code == 0 and "equal" in outcome.out and outcome.err == ""
    found = json.loads((tmp_path / "diff.json").read_text())
    assert found["equal"] is True and found["header"] == {} and found["tensors"] == {}


def test_every_kind_of_difference_is_shown_with_its_size(one, tmp_path: Path, motorprior: Command):
    prior, path = one
    assert prior.network.motor is not None
    center = prior.network.motor.center.copy()
    center[PARAMETERS.index("armature")] += np.log(1.5)
    w1 = prior.network.w1.copy()
    w1[0, 0] += 0.4
    network = replace(prior.network, w1=w1, motor=GearedMotor(center, prior.network.motor.slope), torque_limit=1.5)
    provenance = {**prior.provenance, "recipe": {"steps": 300, "taps": [0, 2, 5], "warm_up": 30}}
    changed = replace(
        prior, network=network, mean=2 * prior.mean, preset="mine", provenance=provenance,
        metrics={"loss_mean": 0.4, "replay_rmse": 1.0},
    )  # fmt: skip
    outcome = motorprior("diff", path, other_of(changed, tmp_path), "--json", tmp_path / "diff.json")
    assert outcome.code == 1 and outcome.err == ""
    found = json.loads((tmp_path / "diff.json").read_text())
    assert found["equal"] is False
    assert found["header"] == {
        "metrics.loss_mean": [0.5, 0.4],
        "metrics.minutes_of_log": [3.0, None],
        "metrics.replay_rmse": [None, 1.0],
        "preset": ["rollout", "mine"],
        "provenance.recipe.steps": [100, 300],
        "provenance.recipe.warm_up": [None, 30],
        "torque_limit": [3.0, 1.5],
    }
    assert found["tensors"].keys() == {"mean", "motor_center", "w1"}
    assert found["tensors"]["w1"] == pytest.approx(0.4)
    motors = found["motors"]
    assert motors["armature"] == pytest.approx([0.002, 0.003])
    assert motors["spread of armature"][1] == pytest.approx(1.5 * motors["spread of armature"][0])
    length = np.linalg.norm(prior.mean, axis=1).mean()
    assert motors["training motors"] == [5, 5] and motors["mean |z|"] == pytest.approx([length, 2 * length])
    for words in (
        "metrics.loss_mean",
        "-20.0 %",
        "provenance.recipe.steps",
        "armature [kg·m²]",
        "+50.0 %",
        "w1",
        "0.4",
    ):
        assert words in outcome.out, words
    assert "recipe.taps" not in outcome.out  # equal


def test_the_spread_is_that_of_the_fleet(one, tmp_path: Path, motorprior: Command):
    prior, path = one
    assert prior.network.motor is not None
    wide = GearedMotor(prior.network.motor.center, 2 * prior.network.motor.slope)
    changed = replace(prior, network=replace(prior.network, motor=wide))
    assert motorprior("diff", path, other_of(changed, tmp_path), "--json", tmp_path / "diff.json").code == 1
    motors = json.loads((tmp_path / "diff.json").read_text())["motors"]
    for row, name in enumerate(PARAMETERS):
        sigma, spread = np.linalg.norm(prior.network.motor.slope[:, row]), motors[f"spread of {name}"]
        if name not in ("encoder_zero", "delay"):
            # lognormal: 68 % of the motors within e^±σ; 256 of them
            assert spread[0] == pytest.approx(motors[name][0] * np.sinh(sigma), rel=0.25), name
            assert spread[1] > 1.8 * spread[0]


def test_a_network_and_a_grey_box_of_other_sizes_can_be_compared(
    one, tmp_path: Path, motorprior: Command, grey_network
):
    network = replace(grey_network(latents=2), motor=None, has_armature=True)
    path = other_of(a_prior(network, mean=np.zeros((4, 2)), log_var=np.zeros((4, 2))), tmp_path)
    outcome = motorprior("diff", one[1], path, "--json", tmp_path / "diff.json")
    assert outcome.code == 1
    found = json.loads((tmp_path / "diff.json").read_text())
    assert found["motors"]["kp"][1] is None and found["header"]["grey_box"] == [True, False]
    assert found["tensors"]["mean"] == [[5, 3], [4, 2]]
    assert found["tensors"]["motor_center"] == [[14], None]
    back = motorprior("diff", path, one[1])
    assert back.code == 1 and "[[4, 2], [5, 3]]" in back.out


def test_a_prior_without_latents_has_constants_without_spread(tmp_path: Path, motorprior: Command, grey_network):
    paths = []
    for name, kp in (("a", 8.0), ("b", 10.0)):
        paths.append(tmp_path / f"{name}.safetensors")
        a_prior(grey_network(latents=0, kp=kp)).save(paths[-1])
    outcome = motorprior("diff", *paths)
    assert outcome.code == 1 and "spread of kp" in outcome.out and "+25.0 %" in outcome.out


def test_what_is_no_prior_is_refused(one, tmp_path: Path, refused: Command):
    path = one[1]
    refused("diff", path, tmp_path / "nowhere.safetensors", words=("nowhere.safetensors", "no such file"))
    refused("diff", tmp_path / "nowhere.safetensors", path, words=("nowhere.safetensors", "no such file"))
    (tmp_path / "text.safetensors").write_text("a text")
    refused("diff", path, tmp_path / "text.safetensors", words=("text.safetensors", "not a complete safetensors file"))
    (tmp_path / "file").write_text("in the way")
    out = ("--json", tmp_path / "file" / "diff.json")
    refused("diff", path, path, *out, words=(str(tmp_path / "file"),))
