"""Gymnasium makes the walking task by name, on both engines and on any motors."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from policies import ACTIONS

import motorprior.environments  # noqa: F401  # registers the task
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import Randomization

ID = "motorprior/Walk-v0"


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory, grey_box) -> Path:
    """File of a prior of twelve equal motors, modelled by a grey box."""
    path = tmp_path_factory.mktemp("prior") / "prior.safetensors"
    motors = np.zeros((12, 3))
    MotorPrior(grey_box(), motors, motors, "rollout", PUPPER_V2.name, "servo", {}).save(path)

    return path


@pytest.mark.parametrize(
    ("engine", "motors"), [("mujoco", "pd"), ("mujoco", "prior:"), ("pybullet", "fleet")]
)
@pytest.mark.filterwarnings("error")
def test_the_environment_passes_the_checker_of_gymnasium(engine: str, motors: str, prior: Path):
    if engine == "pybullet":
        pytest.importorskip(
            "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
        )

    settings: dict[str, Any] = {
        "engine": engine,
        "episode_steps": 10,
        "motors": motors.replace(":", f":{prior}"),
    }

    if engine == "mujoco":
        settings["randomization"] = Randomization(
            joint_noise=0.01, sensor_delay=(0.0, 0.03), mass=(0.9, 1.1)
        )

    env = gymnasium.make(ID, **settings)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_every_seed_samples_other_motors_of_the_prior(prior):
    env = gymnasium.make(ID, motors=f"prior:{prior}")
    action = np.random.default_rng(0).uniform(-1.0, 1.0, ACTIONS)
    measured = []

    for seed in (1, 1, 2):
        observation, _ = env.reset(seed=seed)
        for _ in range(5):
            observation, *_ = env.step(action)
        measured.append(observation)

    env.close()

    np.testing.assert_array_equal(measured[0], measured[1])
    assert np.abs(measured[0] - measured[2])[5:17].min() > 1e-6, "all twelve joints differ"
