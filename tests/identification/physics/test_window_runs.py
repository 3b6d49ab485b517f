"""Motors that made a log replay it in compiled free runs, whose lanes are independent."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import TERMS
from motorprior.identification.physics import window_runs
from motorprior.identification.physics.window_runs import WindowRuns, grey_boxes
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import threads
from motorprior.identification.windows import TrainingData

Networks = Callable[..., GreyBox]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["rollout"], warm_up=60, window=32)
SERVO = (
    "dead_zone",
    "integral",
    "torque_speed",
    "current",
    "asymmetry",
    "presliding",
    "output_damping",
    "heat",
)
CASES = pytest.mark.parametrize("terms", [(), SERVO, tuple(TERMS)], ids=len)
Z = np.array([[0.5, -1.0, 0.3], [0.0, 0.3, -0.8], [-1.2, 0.8, 0.1]])
MOTORS = np.arange(len(Z))


@CASES
def test_motors_that_made_a_log_replay_it(
    grey_box: Networks, decoder_data: Data, terms: tuple[str, ...]
):
    box = grey_box(terms=terms)
    data = decoder_data(box, Z)
    runs = WindowRuns(data, PRESET)
    found = runs.residuals(grey_boxes(box), Z, MOTORS)
    assert (
        found.shape
        == (3, 6 * ((400 - 1 - 60) // 32), 3, 32)
        == (3, runs.windows, runs.channels, 32)
    )
    # rows are float32, and what touches, sticks or slips within rounding is one step off: no window
    # but a few
    assert np.mean(np.abs(found)) < 1e-3 and np.quantile(np.abs(found), 0.99) < 0.01
    others = runs.residuals(grey_boxes(box), Z[[1, 2, 0]], MOTORS)
    assert np.mean(np.abs(others)) > 0.1


def test_windows_are_those_of_a_fit_and_do_not_cross_segments(
    grey_box: Networks, decoder_data: Data
):
    box = grey_box()
    data = decoder_data(box, Z, segments=3, rows=200)
    # the middle segment is of another machine: neighbours must not see it
    broken = replace(data, series=data.series.copy())
    broken.series[:, 200:400] += 1.0
    before, after = (
        WindowRuns(one, PRESET).residuals(grey_boxes(box), Z, MOTORS) for one in (data, broken)
    )
    same = WindowRuns(data, PRESET).segment_indices() != 1
    np.testing.assert_array_equal(before[:, same], after[:, same])
    short = replace(data, segments=(slice(0, 200), slice(200, 250), slice(250, 600)))
    runs = WindowRuns(short, PRESET)
    # a segment without a window counts for nothing
    np.testing.assert_array_equal(runs.segment_indices(), [0] * 4 + [1] * 9)


def test_lanes_do_not_affect_each_other(
    grey_box: Networks, decoder_data: Data, monkeypatch: pytest.MonkeyPatch
):
    box = grey_box(terms=("profile", "presliding"))
    runs = WindowRuns(decoder_data(box, Z, segments=2, rows=200), PRESET)
    rng = np.random.default_rng(0)
    z = rng.standard_normal((600, 3))
    motor = rng.integers(0, 3, 600)
    many = runs.residuals(grey_boxes(box), z, motor)
    for lane in (0, 255, 256, 599):
        np.testing.assert_array_equal(
            many[lane], runs.residuals(grey_boxes(box), z[[lane]], motor[[lane]])[0]
        )
    for pool in (ThreadPoolExecutor(1), ThreadPoolExecutor(3)):
        monkeypatch.setattr(window_runs, "threads", lambda pool=pool: pool)
        np.testing.assert_array_equal(runs.residuals(grey_boxes(box), z, motor), many)


def test_a_forked_process_has_threads_of_its_own():
    def works() -> None:
        assert list(threads().map(abs, [-1])) == [1]

    works()
    child = multiprocessing.get_context("fork").Process(target=works)
    child.start()
    child.join(30)
    alive = child.is_alive()
    child.kill()
    assert not alive and child.exitcode == 0
