"""Tables and picture of graded priors, on walks that nobody measured."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_walks import PLACES, invented

import grades
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.families import FAMILIES
from motorprior.bench.fleet import load_fleet
from motorprior.simulation.randomization import Randomization
from motorprior.transfer.walk_table import WalkRow, WalkTable

NAMES = tuple(grades.GRADES)


@pytest.fixture(scope="module")
def figures() -> dict[str, float]:
    walks = list(invented(NAMES).walks)
    lost = ("pybullet", "spread_0")
    walks = [
        WalkRow(w.place, w.condition, w.seed, w.draw, {**w.measures, "drift": np.nan})
        if (w.place, w.condition) == lost else w
        for w in walks
    ]  # fmt: skip
    errors = {(name, each): 0.02 + 0.001 * n for n, name in enumerate(NAMES) for each in ("fleet", "foreign")}
    return grades.figures_of(WalkTable.of(walks), errors)


def test_figures_have_fidelity_by_population_and_measures_by_place(figures):
    assert figures["reference/fleet/fidelity"] == 0.02 and figures["narrow/foreign/fidelity"] > 0.02
    for name in NAMES:
        assert "ratio" not in [key.split("/")[2] for key in figures if key.startswith(f"{name}/own/")]
        for place in PLACES:
            low, value, high = (figures[f"{name}/{place}/speed{end}"] for end in ("/low", "", "/high"))
            assert low <= value <= high
    assert "spread_0/pybullet/drift" not in figures


def test_the_table_has_a_row_per_grade_and_says_what_is_not_known(figures):
    lines = grades.markdown(figures, list(NAMES), list(PLACES)).splitlines()
    assert len(lines) == 2 + len(NAMES) and {line.count("|") for line in lines} == {3 + len(PLACES)}
    (lost,) = [line for line in lines if line.startswith("| G: spread_0 |")]
    assert lost.count("nan m") == 1 and "(× " in lost


def test_ranks_are_of_the_grades_that_walk_at_home_and_of_the_error_of_the_twins_own_population():
    figures = {}
    for name, error, upright in (("a", 0.01, 0.9), ("b", 0.02, 0.8), ("c", 0.03, 0.85), ("falls", 0.04, 0.99)):
        figures |= {f"{name}/fleet/fidelity": error, f"{name}/foreign/fidelity": 1.0 - error}
        for place in ("fleet", "foreign"):
            figures |= {f"{name}/{place}/{each}": upright for each in ("speed", "upright")}
            figures |= {f"{name}/{place}/ratio": upright} if name != "falls" else {}
    found = grades.correlations(figures, ["a", "b", "c", "falls"], ["own", "fleet", "foreign"])
    assert found["rank_correlation/fleet/upright"] == pytest.approx(-0.5)
    assert found["rank_correlation/foreign/ratio"] == pytest.approx(0.5)
    assert grades.correlations(figures, ["a", "b"], ["own", "fleet"]) == {}


def test_the_picture_is_drawn_with_what_is_known(figures, tmp_path: Path):
    grades.draw(figures, list(NAMES), list(PLACES), tmp_path / "grades.png")
    assert (tmp_path / "grades.png").read_bytes().startswith(b"\x89PNG")


def test_every_grade_names_fleets_that_there_are_and_differs_from_the_reference_in_one_thing():
    reference = grades.GRADES["reference"]
    for name, grade in grades.GRADES.items():
        changed = [key for key, value in vars(grade).items() if value != getattr(reference, key)]
        two = name.endswith("validated") or grade.friction_alone
        assert len(changed) == (0 if name == "reference" else 2 if two else 1)
        for fleet in (grade.fleet, grade.validation):
            assert fleet is None or load_fleet(fleet).family in FAMILIES


def test_friction_alone_differs_by_what_the_prior_draws(grey_network: Any, tmp_path: Path):
    z = np.zeros((1, 3))
    prior = MotorPrior(grey_network(), z, z, "pace", "pupper_v2", "m", {}, {})
    drawn = prior.network.constants(np.random.default_rng(0).standard_normal((4000, 3)))["coulomb"]
    low, high = grades.friction_of(prior)
    central = prior.network.constants(z)["coulomb"]
    assert np.mean((drawn > low * central) & (drawn < high * central)) == pytest.approx(0.9, abs=0.03)
    prior.save(tmp_path / "prior.safetensors")
    alone, others = (
        grades.condition_of(name, tmp_path / "prior.safetensors") for name in ("friction_alone", "spread_0")
    )
    assert alone.randomization == Randomization(coulomb=(low, high)) and others.randomization == Randomization()
    assert alone.motors.latent_spread == others.motors.latent_spread == 0.0
