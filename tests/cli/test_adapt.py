"""`adapt` turns a log of new motors into a posterior that `walk` and `transfer` accept."""

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
    """Benches of training motors, of new motors and of held-out motors, and a prior."""
    root = tmp_path_factory.mktemp("adapt")
    run_bench(Bench(root / "bench", motors=12, steps=2000))
    run_bench(Bench(root / "new", motors=12, steps=1200, seed=5))
    run_bench(Bench(root / "held_out", motors=3, steps=3000, seed=7))
    run_identify(Identify((root / "bench",), root / "prior", "pace"))

    return root


def test_a_posterior_is_written_once_and_walks(folder: Path, tmp_path: Path, motorprior):
    prior_file = folder / "prior" / "prior.safetensors"
    out = tmp_path / "posterior"
    posterior_file = out / "posterior.safetensors"
    command = ("adapt", prior_file, folder / "new" / "log.parquet", "--out", out)

    outcome = motorprior(*command)

    assert outcome.code == 0
    assert "motor posterior of 12 motors" in outcome.out

    prior = MotorPrior.load(prior_file)
    posterior = MotorPosterior.load(posterior_file, prior)

    assert posterior.mean.shape == (12, prior.model.num_latents)
    assert prior.model.num_latents >= 5
    assert posterior.seconds == pytest.approx(2.4, abs=0.01)

    # the same command again does not adapt again
    modified = posterior_file.stat().st_mtime_ns

    assert motorprior(*command).code == 0
    assert posterior_file.stat().st_mtime_ns == modified

    walk = tmp_path / "walk"
    motors = f"posterior:{posterior_file},prior={prior_file}"
    sizes = ("--iterations", 1, "--episode-steps", 20)

    assert motorprior("walk", "--motors", motors, *sizes, "--out", walk).code == 0
    assert motorprior("transfer", walk, "--out", tmp_path / "transfer").code == 0


def test_validation_on_a_held_out_log_ranks_the_adapted_prior_before_the_prior_and_baselines(
    folder: Path, tmp_path: Path, motorprior
):
    prior = folder / "prior" / "prior.safetensors"
    out = tmp_path / "log"
    held_out = folder / "held_out" / "log.parquet"
    outcome = motorprior("validate", prior, held_out, "--adam-steps", 20, "--out", out)

    assert outcome.code == 0
    assert "tuned_pd" in outcome.out
    assert "whole log, mean" in outcome.out

    results = read_results(out)
    for quantity in ("free_run_rmse", "whole_run_rmse"):
        medians = results.where(quantity=quantity, statistic="median")
        errors = {row.model: row.value for row in medians}
        assert list(errors)[:2] == ["adapted", "prior"]
        assert set(errors) == {"adapted", "prior", *LOG_BASELINES}
        assert errors["adapted"] < errors["prior"]
        assert errors["adapted"] < 0.5 * errors["tuned_pd"]
        assert errors["second_order"] < errors["pure_delay"]

        of_motors = results.where(quantity=quantity, model="per_motor", statistic=None)
        assert [row.part for row in of_motors] == ["motor_000", "motor_001", "motor_002"]

    # rounding decides how wide the bands of three motors are
    for coverage in ("coverage", "whole_run_coverage"):
        for model in ("adapted", "prior"):
            share_50 = results.value(quantity=f"{coverage}50", model=model)
            share_90 = results.value(quantity=f"{coverage}90", model=model)
            assert 0.0 < share_50 < share_90 <= 1.0
            assert share_90 > 0.3

    figures = read_json(out / "figures.json")

    assert "coverage90/adapted" in figures
    assert "whole_run_coverage50/prior" in figures
    assert "whole_run_rmse_mean/adapted" in figures
    assert "Held-out log" in (out / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_outliers_are_rejected_unless_they_are_allowed(folder: Path, tmp_path: Path, motorprior):
    log = read_parquet(folder / "held_out" / "log.parquet")
    shaken = log.joint_pos + 0.5 * np.sin(np.arange(log.num_rows))[:, None]
    write_log(tmp_path / "shaken.parquet", replace(log, joint_pos=shaken))
    prior = folder / "prior" / "prior.safetensors"
    posterior = tmp_path / "out" / "posterior.safetensors"
    command = ("adapt", prior, tmp_path / "shaken.parquet", "--out", tmp_path / "out")

    outcome = motorprior(*command)

    assert outcome.code == 2
    assert "outliers" in outcome.err
    assert not posterior.exists()

    assert motorprior(*command, "--allow-outliers").code == 0
    assert posterior.is_file()
