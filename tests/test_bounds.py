"""A value out of bounds is refused by the name of its argument, which a command line writes as its option."""

from collections.abc import Callable

import numpy as np
import pytest

from motorprior.bounds import LARGEST_SEED, require_count, require_number, require_seed
from motorprior.exceptions import ConfigError, MotorPriorError, RobotFault


@pytest.mark.parametrize("value", [1, 4, np.int64(2)])
def test_a_count_at_its_bounds_passes(value: int):
    require_count("motors", value, 1, 4)


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (lambda: require_count("motors", 5, 1, 4), "motors 5 is not a whole number from 1 to 4"),
        (lambda: require_count("motors", 0), "motors 0 is not a whole number of at least 1"),
        (lambda: require_count("motors", 2.0), "motors 2.0 is not a whole number"),
        (lambda: require_count("motors", True), "motors True is not a whole number"),
        (lambda: require_number("motors", 1.5, most=1.0), "motors 1.5 is not a finite number from 0 to 1"),
        (lambda: require_number("motors", float("nan")), "motors nan is not a finite number of at least 0"),
    ],
)
def test_what_is_out_of_bounds_is_named(check: Callable[[], None], words: str):
    with pytest.raises(ConfigError, match=words) as error:
        check()
    assert error.value.argument == "motors" and error.value.on_command_line().startswith("--motors ")


@pytest.mark.parametrize("seed", [-1, LARGEST_SEED + 1, 0.5])
def test_a_seed_no_generator_takes_is_refused(seed: object):
    with pytest.raises(ConfigError, match="seed"):
        require_seed(seed)


@pytest.mark.parametrize(
    ("error", "shown"),
    [
        (ConfigError("task.yaw_rate nan is bad", argument="task.yaw_rate"), "--task.yaw-rate nan is bad"),
        (ConfigError("rate 5 is no rate", remedy="give a rate", argument="rate"), "--rate 5 is no rate -> give a rate"),
        (ConfigError("nobody", remedy="give yes", argument="yes"), "nobody -> give --yes"),
        (ConfigError("its seed is bad", where="seed.json", argument="seed"), "seed.json: its --seed is bad"),
        (ConfigError("half seeds", argument="seed"), "half seeds"),
        (MotorPriorError("seed 1"), "seed 1"),
        (RobotFault("no IMU", "x", remedy="give without_imu", argument="without_imu"),
         "robot fault 'no IMU': x -> give --without-imu"),
    ],
)  # fmt: skip
def test_a_command_line_writes_the_argument_as_its_option(error: MotorPriorError, shown: str):
    assert error.on_command_line() == shown
    assert "--" not in str(error)
