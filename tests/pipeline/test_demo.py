"""The demo, as small as it gets: every figure and every chapter, and a second run that finds it all done."""

import math
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json, read_tensors
from motorprior.exceptions import ConfigError
from motorprior.pipeline import demo as demo_module
from motorprior.pipeline.demo import Demo, run_demo
from motorprior.pipeline.report import build_report, seconds_by_kind
from motorprior.pipeline.stage import MARKER
from motorprior.results import Results

pytestmark = pytest.mark.slow
LOG = "env_real_1_joint_log.csv.gz"
MODELS = ("ideal_pd", "tuned_pd", "one_network", "paper", "rollout", "physical")
CONDITIONS = ("ideal_pd", "paper", "rollout", "oracle")
WITHOUT_LOGS = (
    *(f"{figure}/{model}" for figure in ("bench_impact_rmse", "standing_rmse", "hung_rmse") for model in MODELS),
    *(f"{figure}/{model}" for figure in ("standing_torque_hf", "hung_torque_hf") for model in MODELS),
    *(f"{figure}/{name}" for figure in ("own_speed", "own_upright") for name in CONDITIONS),
    *(f"{figure}/{name}" for figure in ("twin_speed", "twin_upright", "twin_drift") for name in CONDITIONS),
    *("mj_step_share/rollout", "seconds"),
)
MEASURED_AGAIN = re.compile("seconds|.*mj_step_share/.*|control_steps_per_s/.*|.*_over_.*")
WITH_LOGS = ("Your motors",)
CHAPTERS = (
    *("Bench: excitation and response", "Motor prior: what makes motors differ", "Torque fit: open loop, one step"),
    *("Closed loop on the bench", "Closed loop inside the robot", "Real robot logs", "Learning to walk", "Transfer"),
    "Robustness",
    "Where the time goes",
)

STAGES = ("bench", "priors", "validate", "replay", "walk", "transfer", "robustness")


@dataclass(frozen=True)
class Run:
    """A finished demo."""

    config: Demo
    figures: dict[str, float]
    page: str


@pytest.fixture(scope="module")
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
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
    return finished(config)


def finished(config: Demo) -> Run:
    return Run(config, read_json(config.out / "figures.json"), (config.out / "report.html").read_text("utf-8"))


def chapters(page: str) -> list[str]:
    titles = re.findall(r"<h2[^>]*>(.*?)</h2>", page, re.DOTALL)
    return [chapter for chapter in (*WITH_LOGS, *CHAPTERS) if any(chapter in title for title in titles)]


def modified(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_every_figure_is_a_finite_number(demo: Run):
    assert set(WITHOUT_LOGS) <= set(demo.figures)
    assert [name for name, value in demo.figures.items() if type(value) not in (int, float)] == []
    assert [name for name, value in demo.figures.items() if not math.isfinite(value)] == []


def test_real_logs_have_their_figures(demo: Run):
    if demo.config.logs is None:
        pytest.skip("real motor logs are not here")
    assert {f"real_rmse/1_joint/{model}" for model in ("ideal_pd", "physical", "rollout")} <= set(demo.figures)
    assert {f"real_motors_rmse/{model}" for model in ("ideal_pd", "physical", "second_order")} <= set(demo.figures)


def test_shares_are_shares(demo: Run):
    shares = [name for name in demo.figures if name.startswith(("own_upright/", "twin_upright/"))]
    assert [name for name in shares if not 0.0 <= demo.figures[name] <= 1.0] == []


def test_the_page_has_every_chapter(demo: Run):
    first = () if demo.config.logs is None else WITH_LOGS
    assert chapters(demo.page) == [*first, *CHAPTERS]


def test_the_page_needs_nothing_but_itself(demo: Run):
    elsewhere = (
        r"""(?:src|href|srcset|data|action)\s*=\s*["']?\s*(?:https?:)?//|url\(\s*["']?\s*(?:https?:)?//|@import"""
    )
    assert re.findall(elsewhere, demo.page) == []


def test_a_second_run_finds_every_stage_done(demo: Run):
    before = {stage: modified(demo.config.out / stage) for stage in STAGES}
    run_demo(replace(demo.config, workers=1))
    assert {stage: modified(demo.config.out / stage) for stage in STAGES} == before
    again = finished(demo.config).figures
    assert again.keys() == demo.figures.keys()
    changed = {name for name, value in again.items() if value != demo.figures[name]}
    assert [name for name in changed if not MEASURED_AGAIN.fullmatch(name)] == []


def test_stages_one_after_the_other_make_the_bytes_of_stages_side_by_side(moved: Demo):
    assert moved.workers == 2
    folders = ("priors/paper", "priors/paper_wide", "walk/rollout_0", "walk/oracle_0", "transfer", "robustness/paper_0")
    made = ("prior.safetensors", "policy.safetensors", "traces.safetensors", "robustness.safetensors", "results.json")
    files = [path for folder in folders for name in made if (path := moved.out / folder / name).is_file()]
    assert len(files) == 2 + 2 + 2 + 1
    before = {path: content(path) for path in files}
    for folder in folders:
        (moved.out / folder / MARKER).unlink()
    for path in files:
        path.unlink()
    run_demo(replace(moved, workers=1))
    assert {path: content(path) for path in files} == before


def content(path: Path) -> Any:
    """Bytes of every array, since a header may name the place of a prior; everything of another file."""
    if path.suffix != ".safetensors":
        return path.read_bytes()
    return {name: array.tobytes() for name, array in read_tensors(path)[0].items()}


def test_the_page_of_an_unfinished_demo_shows_what_is_there(demo: Run, tmp_path: Path):
    shutil.copytree(demo.config.out / "bench", tmp_path / "bench")
    for name in ("demo.json", "stages.json"):
        shutil.copy(demo.config.out / name, tmp_path)
    found = chapters(build_report(tmp_path).read_text("utf-8"))
    assert CHAPTERS[0] in found and CHAPTERS[1] not in found


@pytest.fixture
def moved(demo: Run, tmp_path: Path) -> Demo:
    """The same demo in a folder of another place."""
    shutil.copytree(demo.config.out, tmp_path / "elsewhere")
    return replace(demo.config, out=tmp_path / "elsewhere")


def test_a_moved_run_folder_is_still_finished_and_keeps_its_seconds(moved: Demo):
    before = {stage: modified(moved.out / stage) for stage in STAGES}
    took = seconds_by_kind(moved.out)
    found = run_demo(moved)
    assert {stage: modified(moved.out / stage) for stage in STAGES} == before
    assert seconds_by_kind(moved.out) == took and min(took.values()) > 0.0
    assert found.seconds.items() >= took.items() and found.seconds["everything else"] > 0.0
    assert found.results.value(quantity="seconds") == pytest.approx(sum(found.seconds.values()))


def test_stages_of_other_settings_are_not_shown(moved: Demo, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as context, pytest.raises(KeyboardInterrupt):
        context.setattr(demo_module, "run_bench", interrupted)
        run_demo(replace(moved, seed=moved.seed + 1, logs=None))
    page = build_report(moved.out).read_text("utf-8")
    assert chapters(page) == ["Real robot logs"] and "Where the time goes" not in page and "None were given" in page


def test_a_replay_of_earlier_logs_is_not_shown_without_logs(moved: Demo):
    run_demo(replace(moved, logs=None))
    page = finished(moved).page
    assert "None were given" in page and "log 1_joint" not in page


def damage_curve(run: Path) -> Path:
    (run / "walk" / "paper_0" / "curve.json").write_text('[{"iteration": 0}]')
    return run / "walk"


def damage_figures(run: Path) -> Path:
    (run / "transfer" / "results.json").write_text("[1]")
    return run / "transfer"


def truncate_figures(run: Path) -> Path:
    (run / "validate" / "results.json").write_text('{"rows": [')
    return run / "validate"


def forget_a_figure(run: Path) -> Path:
    path = run / "transfer" / "results.json"
    rows = Results.load(path).rows
    Results.of(row for row in rows if (row.quantity, row.motors, row.model) != ("speed", "own", "rollout")).save(path)
    return run / "transfer"


def damage_a_map(run: Path) -> Path:
    path = run / "robustness" / "oracle_0" / "robustness.safetensors"
    path.write_bytes(path.read_bytes()[:-8])
    return run / "robustness"


@pytest.mark.parametrize("damage", [damage_curve, damage_figures, truncate_figures, forget_a_figure, damage_a_map])
def test_a_damaged_file_of_a_stage_is_named_with_a_way_out(moved: Demo, damage):
    folder = damage(moved.out)
    with pytest.raises(ConfigError) as error:
        build_report(moved.out)
    assert str(error.value.where).startswith(str(folder))
    assert f"delete {folder} and run" in str(error.value)


def test_damaged_figures_of_the_run_are_named(moved: Demo):
    for text in ("{", "[]", '{"schema_version": 1, "rows": [{"value": "x"}]}', "{}"):
        (moved.out / "results.json").write_text(text)
        with pytest.raises(ConfigError, match="run the same demo again"):
            build_report(moved.out)
