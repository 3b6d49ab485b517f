"""The terms that motors have are found in their logs, and no others."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.optional_terms import INITIAL
from motorprior.identification.physics.motor_problem import encoded, grey_box, initial_center
from motorprior.identification.physics.term_selection import (
    SELECTABLE_TERMS,
    blocks_of,
    select_terms,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import POS, TORQUE, VEL, TrainingData

Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60)
MOTORS = 5


def logs(
    decoder_data: Data,
    terms: tuple[str, ...],
    segments: int = 6,
    rows: int = 300,
    motors: int = MOTORS,
) -> WindowRuns:
    """Logs of motors that have these terms."""
    constants = INITIAL | {
        "profile_speed": 1.5,
        "profile_acceleration": 25.0,
        "output_damping": 0.03,
    }
    center = (
        initial_center(()).tolist() + encoded(constants, terms)[len(initial_center(())) :].tolist()
    )
    box = grey_box(np.array(center), terms, PRESET)
    z = 0.15 * np.random.default_rng(3).standard_normal((motors, len(center)))
    rng = np.random.default_rng(5)
    data = decoder_data(box, z, segments=segments, rows=rows)
    noise = rng.standard_normal((*data.series.shape[:2], 3)) * [3e-4, 0.02, 0.02]
    series = data.series.copy()
    series[..., [POS, VEL, TORQUE]] += noise.astype(np.float32)
    return WindowRuns(replace(data, series=series), PRESET)


CASES = pytest.mark.parametrize("terms", [("profile",), ()], ids=["profile", "none"])


def assert_found(
    decoder_data: Data,
    terms: tuple[str, ...],
    others: int,
    selectable: tuple[str, ...] = SELECTABLE_TERMS,
) -> None:
    """The terms are selected; for motors with a term, some others may be, by the test at 20 %."""
    found = select_terms(logs(decoder_data, terms), 0, selectable=selectable)
    assert set(terms) <= set(found.terms) and len(found.terms) <= len(terms) + others * len(
        terms
    ), found.saved
    assert all(found.saved[name] > 0.0 for name in terms)


@CASES
def test_a_term_is_selected_if_motors_have_it(decoder_data: Data, terms: tuple[str, ...]):
    assert_found(decoder_data, terms, 1, ("profile", "dead_zone"))


def test_a_term_is_selected_with_one_motor_and_four_segments(decoder_data: Data):
    runs = logs(decoder_data, ("profile",), segments=4, rows=700, motors=1)
    assert select_terms(runs, 0, selectable=("profile",)).terms == ("profile",)


def test_few_segments_are_all_trained_and_tested_on(decoder_data: Data):
    runs = logs(decoder_data, ())
    assert all(
        set(blocks_of(runs)[runs.segment_indices() == segment] % 2) == {0, 1}
        for segment in range(6)
    )


@pytest.mark.slow
@CASES
def test_the_terms_that_motors_have_are_found_and_no_others(
    decoder_data: Data, terms: tuple[str, ...]
):
    assert_found(decoder_data, terms, 2)
