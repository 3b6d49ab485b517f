"""Constants that vary of motors that lack them are refused before anything is trained or lost."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.exceptions import ConfigError
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.train_policy import train_policy
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.ars import ArsConfig
from motorprior.simulation.randomization import Randomization

WITHOUT_GAINS = r"^randomization\.kd: motors of the model 'latent' .* have no kd that could vary -> leave the range"


@pytest.fixture
def no_gains(grey_network: Callable[..., LatentNetwork]) -> LatentActuator:
    network = replace(grey_network(network=0.1), motor=None)
    return LatentActuator(network, np.zeros((12, network.num_latents)))


def test_a_finished_policy_survives_the_refusal(
    tmp_path: Path, no_gains: LatentActuator, monkeypatch: pytest.MonkeyPatch
):
    search = ArsConfig(num_directions=2, num_top_directions=2)
    config = Walk(tmp_path, MotorChoice("pd"), iterations=1, episode_steps=5, search=search)
    run_walk(config)
    held = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    monkeypatch.setattr(MotorChoice, "drawer", lambda self, robot: lambda rng: no_gains)
    with pytest.raises(ConfigError, match=WITHOUT_GAINS) as error:
        run_walk(replace(config, randomization=Randomization(kd=(0.8, 1.2))))
    assert "--randomization.kd" in error.value.on_command_line()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == held
    assert POLICY in held


def test_from_python_too(no_gains: LatentActuator):
    with pytest.raises(ConfigError, match=WITHOUT_GAINS):
        train_policy(
            load_robot(DEFAULT_ROBOT), no_gains, iterations=1, episode_steps=5,
            randomization=Randomization(kd=(0.8, 1.2)),
        )  # fmt: skip
