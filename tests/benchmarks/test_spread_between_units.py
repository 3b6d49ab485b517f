"""Fleets whose units differ more or less, and means over policies with paired differences."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.families import TrueMotors
from motorprior.actuator.fleet import Fleet, load_fleet
from motorprior.robots.load import load_robot
from motorprior.studies.statistics import WalkRow
from spread_between_units import Settings, fleets_of, studies_of, summary

CALIBRATED = "pupper_v2"


@pytest.fixture(scope="module")
def fleets() -> dict[str, Fleet]:
    return fleets_of(Settings(Path("unused")), load_robot(CALIBRATED))


def robots_motors(fleet: Fleet, seed: int) -> TrueMotors:
    """Many motors of one robot."""
    return fleet.sample(400, np.random.default_rng(seed), of_one_robot=True)


def test_without_spread_the_motors_of_a_robot_are_equal_and_robots_differ(fleets):
    first = robots_motors(fleets["spread_0"], 0)
    second = robots_motors(fleets["spread_0"], 1)

    for name in ("kp", "armature", "coulomb", "backlash", "delay", "encoder_zero"):
        assert np.ptp(getattr(first, name)) == pytest.approx(0.0, abs=1e-12), name
    assert first.kp[0] != second.kp[0]


def test_the_spread_scales_the_deviation_of_the_logarithm(fleets):
    deviations = [np.log(robots_motors(fleets[f"spread_{n}"], 0).kp).std() for n in (1, 2, 4)]
    assert deviations == pytest.approx([0.1, 0.2, 0.4], rel=0.15)


def test_a_spread_of_one_is_the_calibrated_fleet(fleets):
    for name, distribution in load_fleet(CALIBRATED).parameters.items():
        assert fleets["spread_1"].parameters[name].values == pytest.approx(distribution.values)


def test_fleets_are_written_as_files_that_load(tmp_path: Path):
    for name, study in studies_of(Settings(tmp_path)).items():
        study.require_valid()
        assert study.fleet is not None
        assert load_fleet(study.fleet).name == name


def test_differences_are_between_policies_of_the_same_bench_and_seed():
    upright = {"central_motor": 0.7, "random_pd": 0.8, "sampled_prior": 0.9}
    walks: list[WalkRow] = []
    for condition, bench, seed, number in product(upright, (0, 1), (0, 1), range(3)):
        of_bench = 0.05 * bench + 0.02 * seed  # shared by the conditions
        walks.append(
            {
                "bench": bench,
                "environment": "hard",
                "condition": condition,
                "seed": seed,
                "walk": number,
                "upright": upright[condition] + of_bench,
                "speed": 0.5,
            }
        )

    figures = summary({"spread_1": walks})

    cell = "spread_1/hard/sampled_prior"
    assert figures[f"{cell}/policies"] == 4
    difference = f"{cell}/minus_central_motor"
    assert figures[difference] == pytest.approx(0.2)
    assert figures[f"{difference}/low"] == pytest.approx(0.2)
    assert figures[f"{cell}/bench_1"] == pytest.approx(0.96)
    # two policies of each of two benches, 0.02 apart: t(2 degrees of freedom) · 0.02/2/√2
    assert figures[f"{cell}/upright"] - figures[f"{cell}/upright/low"] == pytest.approx(
        0.0304, 0.01
    )
