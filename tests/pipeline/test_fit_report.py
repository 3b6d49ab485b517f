"""What a user is told of conditions that a prior does not know."""

from dataclasses import replace

import numpy as np
import pytest
from motorprior.pipeline.fit_report import other_conditions
from swinging_load import swinging_load

from motorprior.identification.presets import PRESETS, with_what_is_stated

TWO = np.repeat([0, 1], 400)
KNOWN = swinging_load(800, segment=TWO, supply_voltage=np.where(TWO == 0, 12.0, 9.6)[:, None])
RECIPE = with_what_is_stated(PRESETS["long_runs"], KNOWN)


def at(*volts: float) -> np.ndarray:
    return np.repeat(volts, 800 // len(volts))[:, None]


@pytest.mark.parametrize("terms", [(), ("supply",)])
def test_voltages_between_those_of_the_priors_logs_are_nothing_to_tell(terms: tuple[str, ...]):
    for volts in ((10.0,), (12.2,), (12.0, 9.6)):
        assert (
            other_conditions(replace(RECIPE, terms=terms), swinging_load(800, segment=TWO, supply_voltage=at(*volts)))
            == []
        )


@pytest.mark.parametrize(("terms", "effect"), [((), "is not known"), (("supply",), "is extrapolated")])
def test_a_voltage_beyond_them_in_any_segment_is_told_with_both(terms: tuple[str, ...], effect: str):
    (line,) = other_conditions(
        replace(RECIPE, terms=terms), swinging_load(800, segment=TWO, supply_voltage=at(24.0, 11.0))
    )
    assert "supply_voltage is 11 to 24 V, in the prior's logs 9.6 to 12 V" in line and effect in line


def test_a_log_that_states_none_has_the_usual_one_where_it_counts():
    (line,) = other_conditions(replace(RECIPE, terms=("supply",)), swinging_load(800))
    assert "the log states no supply_voltage: taken as the prior's usual one, 10.8 V" in line
    assert other_conditions(RECIPE, swinging_load(800)) == []
    assert other_conditions(replace(RECIPE, terms=("supply",), conditions=()), swinging_load(800)) == []
