"""A fleet that was written is the fleet that is read."""

from pathlib import Path

import pytest

from motorprior.bench.fleet import load_fleet, write_fleet
from motorprior.robots.shipped import SHIPPED

NAMES = [name for robot in SHIPPED for name, _ in robot.fleets]


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_fleet_comes_back(tmp_path: Path, name: str):
    fleet, path = load_fleet(name), tmp_path / "fleet.toml"
    sources = dict.fromkeys(fleet.parameters, 'a log called "µ \\ 1"')
    write_fleet(path, fleet, sources, "by a test")
    assert load_fleet(path) == fleet
    assert path.read_text("utf-8").startswith("# by a test\n")
