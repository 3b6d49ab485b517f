"""A minimal demo: every figure and every section; a second run repeats no stage."""

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.demo import Demo, run_demo

pytestmark = pytest.mark.slow
LOG = "env_real_1_joint_log.csv.gz"
MODELS = ("ideal_pd", "tuned_pd", "one_network", "paper", "rollout", "physical")
CONDITIONS = ("ideal_pd", "paper", "rollout", "oracle")
OF_MODELS = ("bench_impact_rmse", "standing_rmse", "suspended_rmse", "standing_torque_hf", "suspended_torque_hf")
OF_CONDITIONS = ("own_speed", "own_upright", "twin_speed", "twin_upright", "twin_drift")
CHAPTERS = (
    *("Bench: excitation and response", "Closed loop on the bench", "Closed loop inside the robot"),
    *("Learning to walk", "Transfer"),
)
STAGES = ("bench", "priors", "validate", "walk", "transfer")


@pytest.fixture(scope="module")
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """With one of the real logs, if they are here."""
    folder = tmp_path_factory.mktemp("demo")
    logs: Path | None = folder / "logs"
    try:
        shared: Path = request.getfixturevalue("shared_data")
        (folder / "logs").mkdir()
        shutil.copy(shared / "pupper_v2" / LOG, folder / "logs")
    except pytest.skip.Exception:
        logs = None
    config = Demo(
        folder / "run", logs=logs, motors=16, bench_steps=1500, adam_steps=30, iterations=2, seeds=1, workers=2
    )
    run_demo(config)
    return config


def figures(config: Demo) -> dict[str, float]:
    return read_json(config.out / "figures.json")


def modified(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_every_figure_is_a_finite_number_and_the_page_has_every_chapter(demo: Demo):
    found = figures(demo)
    assert {f"{figure}/{model}" for figure in OF_MODELS for model in MODELS} <= set(found)
    assert {f"{figure}/{name}" for figure in OF_CONDITIONS for name in CONDITIONS} <= set(found)
    assert [name for name, value in found.items() if type(value) not in (int, float) or not math.isfinite(value)] == []
    if demo.logs is not None:
        assert {f"real_motors_rmse/{model}" for model in ("pure_delay", "second_order")} <= set(found)
    page = (demo.out / "report.html").read_text("utf-8")
    chapters = [title for title in re.findall(r"<h2[^>]*>(.*?)</h2>", page) if title != "Settings"]
    assert chapters == [*([] if demo.logs is None else ["Your motors"]), *CHAPTERS] and "not complete" not in page


def test_a_second_run_finds_every_stage_done(demo: Demo):
    before, found = {stage: modified(demo.out / stage) for stage in STAGES}, figures(demo)
    run_demo(replace(demo, workers=1))
    assert {stage: modified(demo.out / stage) for stage in STAGES} == before
    assert figures(demo) == found
