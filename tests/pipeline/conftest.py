"""What several stages start from."""

from pathlib import Path

import pytest

from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import Walk, run_walk


@pytest.fixture(scope="session")
def gait_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a walk, the gait itself."""
    folder = tmp_path_factory.mktemp("walks") / "gait_0"
    run_walk(Walk(folder, MotorChoice("pd"), iterations=1, episode_steps=5, workers=1))
    return folder
