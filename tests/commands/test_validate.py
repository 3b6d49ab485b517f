"""Validation of a prior against the motors of its bench, small."""

from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.validate import Validate, run_validate
from motorprior.identification.fit_prior import PRIOR
from motorprior.studies.robot_fidelity import FIDELITY_METRICS


@pytest.mark.slow
def test_every_model_is_measured_on_the_bench_and_in_the_robot(tmp_path: Path):
    run_bench(Bench(tmp_path / "bench", motors=12, steps=1000, preset="paper"))
    run_identify(Identify(tmp_path / "bench", tmp_path / "prior", "paper", steps=10))
    run_validate(Validate((tmp_path / "prior" / PRIOR,), tmp_path / "validate", held_out=False))
    figures = read_json(tmp_path / "validate" / "figures.json")
    for metric in FIDELITY_METRICS:
        for model in ("ideal_pd", "tuned_pd", "paper", "physical"):
            assert figures[f"{metric}/{model}"] >= 0.0
    assert figures["suspended_rmse/physical"] < figures["suspended_rmse/tuned_pd"]
