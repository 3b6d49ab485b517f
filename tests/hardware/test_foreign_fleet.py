"""A robot behind a wire has geared motors, whose gains its firmware sets."""

import pytest

from motorprior.exceptions import ConfigError
from motorprior.pipeline.virtual.virtual_robot import Virtual, make
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def test_a_virtual_robot_with_foreign_motors_is_refused():
    with pytest.raises(ConfigError, match="the fleet's motors are foreign, not geared") as error:
        make(PUPPER_V2, Virtual(fleet="foreign_servo"))
    assert error.value.remedy and error.value.argument == "fleet"
