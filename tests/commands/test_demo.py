"""A minimal demo: every figure and every section; a second run repeats no stage."""

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.demo import CONDITIONS, FILM, Demo, run_demo
from motorprior.report.demo_page import headline
from motorprior.studies.statistics import summarise

LOG = "env_real_1_joint_log.csv.gz"
SECTIONS = (
    *("Results", "Robustness on held-out robots", "In the simulation of the training"),
    *("Bench: excitation and response", "Learning to walk"),
)


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
        folder / "run",
        logs=logs,
        motors=12,
        bench_steps=1500,
        adam_steps=30,
        iterations=1,
        directions=2,
        seeds=2,
        walks=2,
    )
    run_demo(config)
    return config


def figures(config: Demo) -> dict[str, float]:
    return read_json(config.out / "figures.json")


@pytest.mark.slow
def test_every_figure_is_a_finite_number_and_the_page_has_every_chapter(demo: Demo):
    found = figures(demo)
    wanted = {
        f"{environment}/{name}/{measure}{end}"
        for environment in ("own", "fleet", "hard")
        for name in CONDITIONS
        for measure in ("upright", "speed")
        for end in ("", "/low", "/high")
    }
    assert {*wanted, "seconds"} <= set(found)
    assert [
        name
        for name, value in found.items()
        if type(value) not in (int, float) or not math.isfinite(value)
    ] == []
    if demo.logs is not None:
        assert {f"real_motors_rmse/{model}" for model in ("pure_delay", "second_order")} <= set(
            found
        )
    page = (demo.out / "report.html").read_text("utf-8")
    titles = [title for title in re.findall(r"<h2[^>]*>(.*?)</h2>", page) if title != "Settings"]
    assert (
        titles == [*([] if demo.logs is None else ["Your motors"]), *SECTIONS]
        and "not complete" not in page
    )
    assert len(page) < 1_500_000 and page.count("<img") <= 12
    assert (demo.out / FILM).read_bytes()[:3] == b"GIF"


@pytest.mark.slow
def test_a_second_run_finds_every_stage_done(demo: Demo):
    def modified() -> dict[Path, int]:
        folders = [demo.out / f"bench_{demo.seed}", demo.out / "real_motors"]
        return {
            path: path.stat().st_mtime_ns
            for each in folders
            for path in each.rglob("*")
            if path.is_file()
        }

    before = modified()
    found = figures(demo)
    run_demo(replace(demo, workers=1))
    assert modified() == before
    assert {**figures(demo), "seconds": 0.0} == {**found, "seconds": 0.0}


@pytest.mark.parametrize(("baseline", "is_as_good"), [(0.6, False), (0.95, True)])
def test_the_page_says_first_if_a_baseline_is_as_good(baseline: float, is_as_good: bool):
    shares = dict.fromkeys(CONDITIONS, 0.95) | dict.fromkeys(
        ("ideal_pd", "friction_pd", "random_pd", "paper"), 0.4
    )
    shares["friction_pd"] = baseline
    walks = [
        {"bench": 0, "environment": environment, "condition": name, "seed": seed, "walk": draw}
        | {"speed": 0.6, "upright": share}
        for environment in ("own", "fleet", "hard")
        for name, share in shares.items()
        for seed in range(2)
        for draw in range(2)
    ]
    text = headline(summarise(walks))
    assert "95 % (fleet)" in text and f"{100 * baseline:.0f} % (hard)" in text
    assert (text.index("PD with friction") < text.index("95 %")) is is_as_good
