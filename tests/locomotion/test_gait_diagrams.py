"""The footfall patterns of the gaits, as the generator plans them."""

import numpy as np
import pytest

from gait_diagrams import planned_stance
from motorprior.exceptions import ConfigError
from motorprior.locomotion.gaits import GAITS
from motorprior.robots.pupper_v2.robot import PUPPER_V2

FR, FL, RR, RL = range(4)
TOGETHER = {
    "trot": [{FR, RL}, {FL, RR}],
    "pace": [{FR, RR}, {FL, RL}],
    "bound": [{FR, FL}, {RR, RL}],
    "pronk": [{FR, FL, RR, RL}, set()],
    "walk": [{FR, RR, RL}, {FR, FL, RL}, {FL, RR, RL}, {FR, FL, RR}],
}
"""Feet on the ground in the first part of the cycle, in the second, and so on."""


@pytest.mark.parametrize("gait", GAITS)
def test_the_feet_of_a_gait_are_on_the_ground_together(gait: str):
    stance = planned_stance(PUPPER_V2, gait, cycles=2.0, samples=80)
    wanted = [feet for feet in TOGETHER[gait] for _ in range(80 // len(TOGETHER[gait]))] * 2
    inside = [row for row in range(160) if row % 20 not in (0, 19)]  # a foot that touches down is on either side
    assert [set(np.flatnonzero(stance[row])) for row in inside] == [wanted[row] for row in inside]


def test_a_gait_that_there_is_none_of_is_refused():
    with pytest.raises(ConfigError, match="'gallop' is unknown"):
        planned_stance(PUPPER_V2, "gallop")
