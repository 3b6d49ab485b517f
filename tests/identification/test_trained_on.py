"""A prior records the logs that it was trained on, and validation on them warns the user."""

import io
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.validate_log import ValidateLog, run_validate_log
from motorprior.identification import fit_prior as identify
from motorprior.identification import validate
from motorprior.identification.fit_prior import fit_prior, trained_on
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.progress import Lines

WARNING = "warning: the prior was trained on"


def log(seed: int) -> MotorLog:
    time = 0.002 * np.arange(900)
    angle = np.sin(9.0 * time + seed)[:, None]
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m",
        source=f"log {seed}", load_inertia=np.full_like(angle, 0.01), external_torque=0.0 * angle,
    )  # fmt: skip


@pytest.fixture
def fit(grey_box: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is fitted: a prior with the provenance of its logs."""
    z = np.zeros((1, 3))

    def fitted(log: MotorLog, recipe: Any, preset: str, seed: int, provenance: dict, *_: object) -> MotorPrior:
        provenance = {**provenance, "recipe": json.loads(json.dumps(asdict(recipe)))}
        return MotorPrior(grey_box(), z, z, preset, log.robot, "m", provenance, {})

    monkeypatch.setattr(identify, "_fitted", fitted)


@pytest.mark.usefixtures("fit")
def test_a_prior_records_its_training_logs(tmp_path: Path):
    logs = [log(0), log(1)]
    prior = fit_prior(logs, "pace")
    for number, each in enumerate(logs):
        write_log(tmp_path / f"{number}.parquet", each)
    run_identify(Identify((tmp_path / "0.parquet", tmp_path / "1.parquet"), tmp_path / "out", "pace"))
    for same in (prior, MotorPrior.load(tmp_path / "out" / "prior.safetensors")):
        assert all(trained_on(same, each) for each in logs)
        assert trained_on(same, replace(logs[0], source="elsewhere", load_inertia=2.0 * log(0).joint_pos))
        assert not trained_on(same, log(2)) and not trained_on(same, logs[0].rows(slice(0, 800)))
    assert not trained_on(fit_prior(logs[0], "pace"), logs[1])
    assert not trained_on(replace(prior, provenance={}), logs[0])


def stop(*_: object) -> None:
    raise InterruptedError


@pytest.mark.usefixtures("fit")
def test_validation_on_a_training_log_warns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(validate, "free_runs", stop)
    path = tmp_path / "prior.safetensors"
    fit_prior(log(0), "pace").save(path)
    for seed, known in ((0, True), (1, False)):
        write_log(tmp_path / f"{seed}.parquet", log(seed))
        output = io.StringIO()
        config = ValidateLog(path, tmp_path / f"{seed}.parquet", tmp_path / f"out{seed}")
        with pytest.raises(InterruptedError):
            run_validate_log(config, Lines(output))
        assert (f"{WARNING} {tmp_path / f'{seed}.parquet'}" in output.getvalue()) is known
