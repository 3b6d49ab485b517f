"""A prior records its recipe and its training logs; validation on them warns the user."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.validate import Validate, run_validate
from motorprior.exceptions import ArtifactError
from motorprior.identification.presets import PRESETS, recipe_of
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.priors.fit_prior import fit_prior, trained_on
from motorprior.progress import SILENT, Lines


def log(seed: int) -> MotorLog:
    time = 0.01 * np.arange(400)
    angle = np.sin(9.0 * time + seed)[:, None]
    return log_of(
        time,
        angle + 0.01 * seed,
        angle,
        joint_vel=0.9 * angle,
        joint_torque=angle**2,
        source=f"log {seed}",
        load_inertia=0.0 * angle + 0.01,
        external_torque=0.0 * angle,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs, and a prior that was trained on the first two for one step."""
    folder = tmp_path_factory.mktemp("logs")
    for seed in (1, 2, 3):
        write_log(folder / f"{seed}.parquet", log(seed))

    run_identify(Identify((folder / "1.parquet", folder / "2.parquet"), folder, "paper", steps=1))
    return folder


def test_a_prior_records_its_training_logs(folder: Path):
    prior = MotorPrior.load(folder / "prior.safetensors")

    fitted = fit_prior([log(1), log(2)], "paper", steps=1, progress=SILENT)
    moved = replace(log(1), source="elsewhere", load_inertia=2.0 * log(1).joint_pos)

    for trained in (prior, fitted):
        assert trained_on(trained, log(1))
        assert trained_on(trained, log(2))
        assert trained_on(trained, moved)
        assert not trained_on(trained, log(3))
        assert not trained_on(trained, log(1).rows(slice(0, 100)))

    assert not trained_on(replace(prior, provenance={}), log(1))


@pytest.mark.parametrize(
    "recipe", [None, [], {"period": 0.002}, PRESETS["rollout"].as_json() | {"new": 1}], ids=repr
)
def test_a_recipe_of_another_version_is_rejected(folder: Path, recipe: Any):
    prior = replace(MotorPrior.load(folder / "prior.safetensors"), provenance={"recipe": recipe})
    with pytest.raises(ArtifactError, match="recipe"):
        recipe_of(prior)


@pytest.mark.parametrize(("seed", "warns"), [(1, True), (3, False)])
def test_validation_on_a_training_log_warns(folder: Path, seed: int, warns: bool):
    output = io.StringIO()
    path = folder / f"{seed}.parquet"
    config = Validate(folder / "prior.safetensors", path, folder / f"out{seed}")

    # it stops before the first long task
    with (
        pytest.raises(InterruptedError),
        mock.patch.object(Lines, "start", side_effect=InterruptedError),
    ):
        run_validate(config, Lines(output))

    assert (str(path) in output.getvalue()) is warns
