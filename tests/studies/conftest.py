"""The fleet of the simulated robots that studies recover."""

import pytest

from motorprior.actuator.fleet import Fleet, load_fleet


@pytest.fixture(scope="session")
def fleet() -> Fleet:
    return load_fleet("pupper_v2")
