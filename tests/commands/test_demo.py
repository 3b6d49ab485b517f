"""A minimal demo has every figure and every section; a second run repeats no stage."""

import math
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import read_json
from motorprior.commands.demo import CONDITIONS, FILM, Demo, run_demo
from motorprior.report.demo_page import headline, leads, robustness, steps_section
from motorprior.studies.statistics import StudyStatistics, summarise

LOG = "env_real_1_joint_log.csv.gz"
SECTIONS = (
    "Results",
    "In the simulation of the training",
    "Robustness on held-out robots",
    "Steps",
    "Bench: excitation and response",
    "Learning to walk",
)
ENVIRONMENTS = ("own", "fleet", "hard")
# step frequency [Hz] of invented walks
FREQUENCIES = dict.fromkeys(CONDITIONS, 2.5) | {"sampled_prior": 2.1}


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
    assert len(page) < 4_000_000  # most of it is the film
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


def summary_of(prior: float, friction_pd: float) -> StudyStatistics:
    """Statistics of two policies per condition, with these mean times upright in `hard`.

    In the other environments all conditions are upright for 95 % of the time.
    """
    rng = np.random.default_rng(0)
    means = {"ideal_pd": 0.3, "friction_pd": friction_pd, "paper": 0.2}
    means |= {"sampled_prior": prior, "adapted_prior": prior}
    walks = []
    for environment, condition, seed, number in product(ENVIRONMENTS, means, range(2), range(12)):
        mean = means[condition] if environment == "hard" else 0.95
        walks.append(
            {
                "bench": 0,
                "environment": environment,
                "condition": condition,
                "seed": seed,
                "walk": number,
                "speed": 0.6,
                "upright": mean + 0.01 * rng.standard_normal(),
                "step_frequency": FREQUENCIES[condition] + 0.01 * rng.standard_normal(),
                "foot_lift_mm": 25.0 + number % 3,
            }
        )
    return summarise(walks)


@pytest.mark.parametrize(
    ("prior", "friction_pd", "first_words"),
    [
        (
            0.9,
            0.6,
            "The sampled prior is ahead of the best baseline, the PD with friction, in hard.",
        ),
        (
            0.6,
            0.9,
            "The best baseline, the PD with friction, is ahead of the sampled prior in hard.",
        ),
        (0.9, 0.9, "The sampled prior and the best baseline, the PD with friction, are equal"),
    ],
)
def test_the_first_line_follows_from_the_walks(prior: float, friction_pd: float, first_words: str):
    text = headline(summary_of(prior, friction_pd))

    assert text.startswith(first_words)
    assert f"sampled prior 95 % (fleet) and {100 * prior:.0f} % (hard)" in text


def test_a_condition_leads_only_if_all_its_policies_do():
    summary = summary_of(prior=0.9, friction_pd=0.6)
    assert leads(summary, "hard", "friction_pd") == 1
    assert leads(summary, "fleet", "friction_pd") == 0

    summary.upright["hard", "friction_pd"][0, 0] = 1.0

    assert leads(summary, "hard", "friction_pd") == 0


def test_steps_are_compared_by_their_intervals():
    _, *places, _ = steps_section(summary_of(0.9, 0.9)).text

    assert len(places) == 2, "own simulation and held-out robots"
    for place in places:
        assert "a lower step frequency than the ideal PD (2.10 and 2.50 Hz)" in place
        assert "a foot lift not distinguishable from the ideal PD" in place
        assert "than the PD with friction" in place


def test_a_map_states_in_how_many_cells_each_condition_is_ahead():
    prior = np.full((4, 4), 0.8)
    baseline = prior.copy()
    baseline[0, :3] = 0.9
    baseline[1:3] = 0.3

    section = robustness({"friction_pd": baseline, "sampled_prior": prior})

    comparison = section.text[1]
    assert comparison.startswith("Of 16 cells, the sampled prior is ahead of the PD with friction")
    assert "in 8 and behind in 3" in comparison
