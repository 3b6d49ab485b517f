"""A minimal demo has every figure and every section; a second run repeats no stage."""

import math
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.demo import CONDITIONS, FILM, Demo, run_demo
from motorprior.report.demo_page import headline
from motorprior.studies.statistics import summarise

LOG = "env_real_1_joint_log.csv.gz"
SECTIONS = (
    "Results",
    "Robustness on held-out robots",
    "In the simulation of the training",
    "Bench: excitation and response",
    "Learning to walk",
)
ENVIRONMENTS = ("own", "fleet", "hard")


@pytest.fixture(scope="module")
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """The settings of a finished demo, with one of the real logs where they exist."""
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
    values = figures(demo)

    for environment, condition in product(ENVIRONMENTS, CONDITIONS):
        for quantity, end in product(("upright", "speed"), ("", "/low", "/high")):
            assert f"{environment}/{condition}/{quantity}{end}" in values
    assert "seconds" in values
    for name, value in values.items():
        assert type(value) in (int, float), name
        assert math.isfinite(value), name

    sections: list[str] = list(SECTIONS)

    if demo.logs is not None:
        sections.insert(0, "Your motors")
        assert {"real_motors_rmse/pure_delay", "real_motors_rmse/second_order"} <= set(values)

    page = (demo.out / "report.html").read_text("utf-8")
    titles = re.findall(r"<h2[^>]*>(.*?)</h2>", page)

    assert [title for title in titles if title != "Settings"] == sections
    assert "not complete" not in page
    assert len(page) < 1_500_000
    assert page.count("<img") <= 12
    assert (demo.out / FILM).read_bytes()[:3] == b"GIF"


@pytest.mark.slow
def test_a_second_run_repeats_no_stage(demo: Demo):
    def modified() -> dict[Path, int]:
        paths = [*(demo.out / f"bench_{demo.seed}").rglob("*")]
        paths += (demo.out / "real_motors").rglob("*")
        return {path: path.stat().st_mtime_ns for path in paths if path.is_file()}

    first_times = modified()
    first_figures = figures(demo)

    run_demo(replace(demo, workers=1))

    assert modified() == first_times
    assert {**figures(demo), "seconds": 0.0} == {**first_figures, "seconds": 0.0}


@pytest.mark.parametrize(("baseline", "is_as_good"), [(0.6, False), (0.95, True)])
def test_the_page_states_first_whether_a_baseline_is_as_good(baseline: float, is_as_good: bool):
    shares = dict.fromkeys(CONDITIONS, 0.95)
    shares |= dict.fromkeys(("ideal_pd", "friction_pd", "random_pd", "paper"), 0.4)
    shares["friction_pd"] = baseline

    walks = []
    for environment, condition, seed, number in product(ENVIRONMENTS, shares, range(2), range(2)):
        walks.append(
            {
                "bench": 0,
                "environment": environment,
                "condition": condition,
                "seed": seed,
                "walk": number,
                "speed": 0.6,
                "upright": shares[condition],
            }
        )

    text = headline(summarise(walks))

    assert "95 % (fleet)" in text
    assert f"{100 * baseline:.0f} % (hard)" in text
    assert (text.index("PD with friction") < text.index("95 %")) is is_as_good
