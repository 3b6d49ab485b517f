"""The page of some policies: which of them are seeds of one training, and what it says of them."""

from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.watching.walk_report import build_walk_report, kinds_of
from motorprior.search.ars import ArsConfig
from motorprior.simulation.randomization import Randomization


def walk(folder: Path, seed: int = 0, **changes: Any) -> Walk:
    search = ArsConfig(seed=seed, num_directions=2, num_top_directions=2)
    return replace(Walk(folder, MotorChoice("pd"), iterations=1, episode_steps=5, workers=1, search=search), **changes)


def named(*folders: Path) -> list[str]:
    return kinds_of([("ideal_pd", Policy.load(folder / POLICY)) for folder in folders])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of trainings that differ in one thing each from the first, or in the seed alone."""
    folder = tmp_path_factory.mktemp("walks")
    run_walk(walk(folder / "trot"))
    run_walk(walk(folder / "other_seed", seed=1))
    run_walk(walk(folder / "pace", gait="pace", hidden_units=2))
    run_walk(walk(folder / "plain", randomization=Randomization(push=0.3)))
    return folder


def test_policies_that_differ_in_their_seed_alone_have_one_name(trained: Path):
    assert named(trained / "trot", trained / "other_seed") == ["ideal_pd", "ideal_pd"]


def test_others_are_named_by_how_their_trainings_differ(trained: Path):
    found = named(trained / "trot", trained / "pace", trained / "other_seed")
    assert found == ["ideal_pd (gait trot, hidden units 0)", "ideal_pd (gait pace, hidden units 2)", found[0]]
    first, second = named(trained / "trot", trained / "plain")
    assert first != second and first.startswith("ideal_pd (") and "friction 0.7 to 1.6" in first


def test_the_page_says_what_was_trained(trained: Path, tmp_path: Path):
    for name in ("trot", "pace", "plain"):
        (tmp_path / name).symlink_to(trained / name)
    page = unescape(build_walk_report(tmp_path, "pupper_v2", "motorprior report", False).read_text("utf-8"))
    assert "on a linear policy or a policy with 2 hidden units that modulates a pace or a trot." in page
    assert "not the same varied in all trainings" in page and "the paper's motors" not in page
    one, other = (
        unescape(build_walk_report(trained / name, "pupper_v2", "x", False).read_text("utf-8"))
        for name in ("plain", "pace")
    )
    assert "training varied push." in one and "on a linear policy that modulates a trot." in one
    assert "training varied friction, mass, com, " in other and "a linear policy" not in other
