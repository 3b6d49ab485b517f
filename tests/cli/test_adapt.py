"""From a log of new motors to a posterior that walk and transfer accept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.results import read_results

LOG_BASELINES = (
    "pure_delay",
    "second_order",
    "servo_limits",
    "per_motor",
    "pooled_network",
    "tuned_pd",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Benches of training motors and of new ones, and a prior."""
    root = tmp_path_factory.mktemp("adapt")
    run_bench(Bench(root / "bench", motors=12, steps=2000))
    run_bench(Bench(root / "new", motors=12, steps=1200, seed=5))
    run_bench(Bench(root / "held_out", motors=3, steps=3000, seed=7))
    run_identify(Identify((root / "bench",), root / "prior", "pace"))
    return root


def test_a_posterior_is_written_once_and_walks(folder: Path, tmp_path: Path, motorprior):
    prior = folder / "prior" / "prior.safetensors"
    out = tmp_path / "posterior"
    first = motorprior("adapt", prior, folder / "new" / "log.parquet", "--out", out)
    assert first.code == 0 and "motor posterior of 12 motors" in first.out
    known = MotorPrior.load(prior)
    found = MotorPosterior.load(out / "posterior.safetensors", known)
    assert found.mean.shape == (12, known.model.num_latents) and known.model.num_latents >= 5
    assert found.seconds == pytest.approx(2.4, abs=0.01)
    written = (out / "posterior.safetensors").stat().st_mtime_ns
    assert motorprior("adapt", prior, folder / "new" / "log.parquet", "--out", out).code == 0
    assert (out / "posterior.safetensors").stat().st_mtime_ns == written
    motors = f"posterior:{out / 'posterior.safetensors'},prior={prior}"
    walk = (
        "walk",
        "--motors",
        motors,
        "--iterations",
        1,
        "--episode-steps",
        20,
        "--out",
        tmp_path / "walk",
    )
    assert motorprior(*walk).code == 0
    assert motorprior("transfer", tmp_path / "walk", "--out", tmp_path / "transfer").code == 0


def test_a_held_out_log_takes_the_place_of_the_truth(folder: Path, tmp_path: Path, motorprior):
    prior = folder / "prior" / "prior.safetensors"
    out = tmp_path / "log"
    held_out = folder / "held_out" / "log.parquet"
    done = motorprior("validate", prior, held_out, "--adam-steps", 20, "--out", out)
    assert done.code == 0 and "tuned_pd" in done.out and "whole log, mean" in done.out
    found = read_results(out)
    for quantity in ("free_run_rmse", "whole_run_rmse"):
        errors = {
            row.model: row.value for row in found.where(quantity=quantity, statistic="median")
        }
        assert list(errors)[:2] == ["adapted", "prior"] and set(errors) == {
            "adapted",
            "prior",
            *LOG_BASELINES,
        }
        assert errors["adapted"] < errors["prior"] and errors["adapted"] < 0.5 * errors["tuned_pd"]
        assert errors["second_order"] < errors["pure_delay"]
        each = found.where(quantity=quantity, model="per_motor", statistic=None)
        assert [row.part for row in each] == ["motor_000", "motor_001", "motor_002"]
    # how wide the bands of three motors are, rounding decides
    for coverage in ("coverage", "whole_run_coverage"):
        for model in ("adapted", "prior"):
            half, most = (
                found.value(quantity=f"{coverage}{level}", model=model) for level in (50, 90)
            )
            assert 0.0 < half < most <= 1.0 and most > 0.3
    figures = read_json(out / "figures.json")
    assert {
        "coverage90/adapted",
        "whole_run_coverage50/prior",
        "whole_run_rmse_mean/adapted",
    } <= set(figures)
    assert "Held-out log" in (out / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_outliers_are_rejected(folder: Path, tmp_path: Path, motorprior):
    log = read_parquet(folder / "held_out" / "log.parquet")
    shaken = log.joint_pos + 0.5 * np.sin(np.arange(log.num_rows))[:, None]
    write_log(tmp_path / "shaken.parquet", replace(log, joint_pos=shaken))
    line = (
        "adapt",
        folder / "prior" / "prior.safetensors",
        tmp_path / "shaken.parquet",
        "--out",
        tmp_path / "out",
    )
    outcome = motorprior(*line)
    assert outcome.code == 2 and "outliers" in outcome.err
    assert not (tmp_path / "out" / "posterior.safetensors").exists()
    assert (
        motorprior(*line, "--allow-outliers").code == 0
        and (tmp_path / "out" / "posterior.safetensors").is_file()
    )
