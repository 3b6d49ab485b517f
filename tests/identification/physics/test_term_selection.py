"""Optional terms that motors have are selected, and few others."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.optional_terms import INITIAL, SIGNED
from motorprior.identification.physics.motor_problem import encoded, grey_box, initial_center
from motorprior.identification.physics.term_selection import (
    MAX_MOTORS,
    SELECTABLE_TERMS,
    blocks_of,
    select_terms,
    some_motors,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import KP, POS, TORQUE, VEL, TrainingData

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
    """Free runs over logs with noise, of motors that have these terms."""
    constants = INITIAL | {
        "profile_speed": 1.5,
        "profile_acceleration": 25.0,
        "output_damping": 0.03,
    }
    without_terms = initial_center(())
    of_terms = encoded(constants, terms)[len(without_terms) :]
    center = np.concatenate([without_terms, of_terms])
    box = grey_box(center, terms, PRESET)
    z = 0.15 * np.random.default_rng(3).standard_normal((motors, len(center)))
    data = decoder_data(box, z, segments=segments, rows=rows)
    return WindowRuns(with_noise(data), PRESET)


def with_noise(data: TrainingData) -> TrainingData:
    """The data with noise of angle, velocity and torque."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((*data.series.shape[:2], 3)) * [3e-4, 0.02, 0.02]
    series = data.series.copy()
    series[..., [POS, VEL, TORQUE]] += noise.astype(np.float32)
    return replace(data, series=series)


CASES = pytest.mark.parametrize("terms", [("profile",), ()], ids=["profile", "none"])


def require_selected(
    decoder_data: Data,
    terms: tuple[str, ...],
    spurious: int,
    selectable: tuple[str, ...] = SELECTABLE_TERMS,
) -> None:
    """Assert that the terms are selected.

    For motors with a term, ``spurious`` others may be selected too: the test has a level of 20 %.
    """
    selection = select_terms(logs(decoder_data, terms), 0, selectable=selectable)

    max_terms = len(terms) + spurious * len(terms)
    assert set(terms) <= set(selection.terms), selection.saved
    assert len(selection.terms) <= max_terms, selection.saved
    for name in terms:
        assert selection.saved[name] > 0.0


@CASES
def test_a_term_is_selected_if_and_only_if_motors_have_it(
    decoder_data: Data, terms: tuple[str, ...]
):
    require_selected(decoder_data, terms, 1, ("profile", "dead_zone"))


def test_a_term_is_selected_with_one_motor_and_four_segments(decoder_data: Data):
    runs = logs(decoder_data, ("profile",), segments=4, rows=700, motors=1)
    assert select_terms(runs, 0, selectable=("profile",)).terms == ("profile",)


def test_each_of_few_segments_has_training_and_test_windows(decoder_data: Data):
    runs = logs(decoder_data, ())

    # windows of even blocks train, and those of odd blocks test
    is_test = blocks_of(runs) % 2
    for segment in range(6):
        assert set(is_test[runs.segment_indices() == segment]) == {0, 1}


def test_every_second_gain_is_held_out(decoder_data: Data):
    center = initial_center(())
    data = decoder_data(grey_box(center, (), PRESET), np.zeros((1, len(center))))
    series = data.series.copy()
    for segment, kp in zip(data.segments, (1.0, 2.0, 3.0) * 2, strict=True):
        series[:, segment, KP] = kp
    runs = WindowRuns(replace(data, series=series), PRESET)

    is_test = blocks_of(runs) % 2 == 1

    kp_of_segments = np.array([segment.gains[0, 0] for segment in runs.segments])
    np.testing.assert_array_equal(is_test, kp_of_segments[runs.segment_indices()] == 2.0)


def runs_of_two_classes(decoder_data: Data) -> WindowRuns:
    """Free runs of two hips, and of two calves whose friction depends on the angle."""
    terms = ("angle_friction",)
    names = parameters_of(terms)
    center = initial_center(terms)
    center[names.index("coulomb")] = np.log(0.2)
    z = 0.05 * np.random.default_rng(3).standard_normal((4, len(center)))
    z[:, names.index("friction_slope")] = np.array([0.0, 0.0, 1.5, 1.5]) / SIGNED["friction_slope"]
    data = decoder_data(grey_box(center, terms, PRESET), z, segments=8, rows=600)
    classes = ("hip", "hip", "calf", "calf")
    return WindowRuns(replace(with_noise(data), joint_classes=classes), PRESET)


def test_one_class_of_joints_is_enough_for_a_term_of_its_mechanism(decoder_data: Data):
    runs = runs_of_two_classes(decoder_data)

    selection = select_terms(runs, 0, selectable=("angle_friction",))

    assert selection.terms == ("angle_friction",), selection.saved


def test_terms_are_selected_on_equally_many_motors_of_each_class():
    legs = ("hip", "thigh", "calf") * 4
    motors = some_motors(legs, 12)

    assert [legs[motor] for motor in motors].count("calf") == 2
    assert len(motors) == 6
    np.testing.assert_array_equal(some_motors((), 3), [0, 1, 2])
    assert len(some_motors((), 32)) == MAX_MOTORS


@pytest.mark.slow
@CASES
def test_at_most_two_spurious_terms_are_selected_among_all(
    decoder_data: Data, terms: tuple[str, ...]
):
    require_selected(decoder_data, terms, 2)
