"""Samples of a fleet have the distributions in its file; a bad file is rejected by name."""

import json
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import fleet_path, load_fleet, write_fleet
from motorprior.bench.bench_folder import bench_from_json, read_bench
from motorprior.commands.bench import Bench, run_bench
from motorprior.exceptions import ArtifactError
from motorprior.robots.shipped import SHIPPED

NAMES = sorted(name for robot in SHIPPED for name, _ in robot.fleets)
SHIPPED_TEXT = fleet_path("pupper_v2").read_text(encoding="utf-8")


def with_table(tmp_path: Path, parameter: str, body: str) -> Path:
    """The shipped fleet with the table of one parameter replaced."""
    tables = SHIPPED_TEXT.split("\n[")
    changed = [
        f"{parameter}]\n{body}\n" if table.startswith(f"{parameter}]") else table
        for table in tables
    ]
    assert changed != tables
    path = tmp_path / "mine.toml"
    path.write_text("\n[".join(changed), encoding="utf-8")

    return path


KP = 'unit = "N·m/rad"\nsource = "test"\n'


@pytest.mark.parametrize("name", NAMES)
def test_samples_have_the_median_and_spread_of_the_file(name):
    fleet = load_fleet(name)
    count = 20000
    motors = fleet.sample(count, np.random.default_rng(0))
    values = {field: getattr(motors, field) for field in fleet.parameters if field != "kd_over_kp"}
    values["kd_over_kp"] = motors.kd / motors.kp

    for field, distribution in fleet.parameters.items():
        numbers = distribution.values
        # one sigma either side
        low, middle, high = np.quantile(values[field], [0.1587, 0.5, 0.8413])
        if distribution.form == "constant":
            np.testing.assert_allclose(values[field], numbers["center"])
        elif distribution.form == "uniform":
            width = numbers["high"] - numbers["low"]
            assert numbers["low"] <= values[field].min()
            assert values[field].max() <= numbers["high"]
            expected = numbers["low"] + width * np.array([0.1587, 0.5, 0.8413])
            np.testing.assert_allclose([low, middle, high], expected, atol=0.015 * width)
        else:
            # the quantiles' own standard error is 0.009-0.011 sigma for 20000 samples; 0.04 is four
            # of them
            sigma = np.hypot(numbers["spread"], numbers["center_uncertainty"])
            log = np.log if distribution.form == "lognormal" else np.asarray
            center = log(numbers["center"])
            assert log(middle) == pytest.approx(center, abs=0.04 * sigma), field
            assert log(high) == pytest.approx(center + sigma, abs=0.04 * sigma), field
            if "minimum" not in numbers:
                assert log(low) == pytest.approx(center - sigma, abs=0.04 * sigma), field


def test_the_generator_decides_the_motors():
    fleet = load_fleet("pupper_v2")

    def coulomb(seed: int) -> np.ndarray:
        return require_geared(fleet.sample(5, np.random.default_rng(seed))).coulomb

    np.testing.assert_array_equal(coulomb(seed=3), coulomb(seed=3))
    assert np.any(coulomb(seed=3) != coulomb(seed=4))


def test_the_center_of_a_fleet_is_the_median_of_its_file():

    center = load_fleet("pupper_v2").center(2)

    assert center.kp.tolist() == [8.8, 8.8]
    np.testing.assert_allclose(center.kd, 8.8 * 0.095)  # kd = kp · kd_over_kp


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (KP + 'distribution = "constant"\ncenter = 8.0\nspraed = 1.0', "spraed"),
        (KP + 'distribution = "gaussian"\ncenter = 8.0', "gaussian"),
        (KP + 'distribution = "constant"\ncenter = -8.0', "center = -8"),
        (KP + 'distribution = "uniform"\nlow = 9.0\nhigh = 8.0', "low 9.0"),
        ('source = "x"\nunit = "A/rad"\ndistribution = "constant"\ncenter = 50.0', "A/rad"),
        ('unit = "N·m/rad"\ndistribution = "constant"\ncenter = 8.0', "source"),
    ],
)
def test_a_wrong_table_is_rejected_by_name(tmp_path, body, problem):
    with pytest.raises(ArtifactError) as refusal:
        load_fleet(str(with_table(tmp_path, "kp", body)))

    assert problem in str(refusal.value)
    assert str(refusal.value.where).endswith("mine.toml[kp]")
    assert refusal.value.remedy


@pytest.mark.parametrize("name", NAMES)
def test_a_written_fleet_is_read_unchanged(tmp_path: Path, name: str):
    fleet = load_fleet(name)
    path = tmp_path / "fleet.toml"
    write_fleet(path, fleet, dict.fromkeys(fleet.parameters, 'a log called "µ \\ 1"'), "by a test")
    assert load_fleet(path) == fleet


@pytest.mark.parametrize("name", ["foreign_direct", "mixed"])
def test_a_bench_folder_keeps_its_fleet_and_motors(tmp_path, name):
    run_bench(Bench(tmp_path, name, "rollout", 3, 1200, 5))
    log, bench = read_bench(tmp_path)
    fleet = load_fleet(name)

    assert bench.fleet == fleet
    assert (log.num_joints, log.num_rows) == (3, 1200)
    assert log.motor == fleet.motor

    drawn = bench.physical_motors()
    again = bench_from_json(bench.as_json(), "here").physical_motors()

    np.testing.assert_array_equal(drawn.kp, again.kp)

    text = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))

    assert text.get("family", "geared") == fleet.family
    assert ("family" in text) == (name != "mixed")
