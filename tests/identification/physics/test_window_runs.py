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
    residuals = runs.residuals(grey_boxes(box), Z, MOTORS)

    # 6 segments of 400 rows, a warm-up of 60 and windows of 32
    windows = 6 * ((400 - 1 - 60) // 32)
    assert residuals.shape == (3, windows, 3, 32)
    assert (runs.windows, runs.channels) == (windows, 3)

    # Rows are float32: contact, sticking or slipping may be one step late, in a few windows.
    assert np.mean(np.abs(residuals)) < 1e-3
    assert np.quantile(np.abs(residuals), 0.99) < 0.01

    permuted = runs.residuals(grey_boxes(box), Z[[1, 2, 0]], MOTORS)

    assert np.mean(np.abs(permuted)) > 0.1


def test_windows_do_not_cross_segments(grey_box: Networks, decoder_data: Data):
    box = grey_box()
    data = decoder_data(box, Z, segments=3, rows=200)
    # only the middle segment differs
    broken = replace(data, series=data.series.copy())
    broken.series[:, 200:400] += 1.0

    runs = WindowRuns(data, PRESET)
    residuals = runs.residuals(grey_boxes(box), Z, MOTORS)
    broken_residuals = WindowRuns(broken, PRESET).residuals(grey_boxes(box), Z, MOTORS)

    same = runs.segment_indices() != 1
    np.testing.assert_array_equal(residuals[:, same], broken_residuals[:, same])


def test_a_segment_that_is_too_short_has_no_window(grey_box: Networks, decoder_data: Data):
    data = decoder_data(grey_box(), Z, segments=3, rows=200)
    short = replace(data, segments=(slice(0, 200), slice(200, 250), slice(250, 600)))
    runs = WindowRuns(short, PRESET)

    # (200 - 1 - 60) // 32 = 4 windows, none, and (350 - 1 - 60) // 32 = 9 windows
    np.testing.assert_array_equal(runs.segment_indices(), [0] * 4 + [1] * 9)


def test_lanes_do_not_affect_each_other_on_any_number_of_threads(
    grey_box: Networks, decoder_data: Data, monkeypatch: pytest.MonkeyPatch
):
    box = grey_box(terms=("profile", "presliding"))
    runs = WindowRuns(decoder_data(box, Z, segments=2, rows=200), PRESET)
    rng = np.random.default_rng(0)
    z = rng.standard_normal((600, 3))
    motor = rng.integers(0, 3, 600)
    many = runs.residuals(grey_boxes(box), z, motor)

    for lane in (0, 255, 256, 599):
        alone = runs.residuals(grey_boxes(box), z[[lane]], motor[[lane]])[0]
        np.testing.assert_array_equal(many[lane], alone)

    for num_threads in (1, 3):
        with ThreadPoolExecutor(num_threads) as pool:
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

    assert not alive
    assert child.exitcode == 0
