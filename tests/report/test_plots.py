"""Plots say their units, stay finite, and one model has one colour everywhere."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from motorprior.report.gait_picture import gait_strip
from motorprior.report.latent_directions import (
    Directions,
    principal_directions,
)
from motorprior.report.plots_latent import latent_map
from motorprior.report.plots_motor import closed_loop, excitation_and_response, torque_fit
from motorprior.report.plots_robot import real_replay, robot_traces
from motorprior.report.plots_study import fidelity_bars, learning_curves, transfer_bars
from motorprior.report.plots_style import png_bytes
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.skeleton import Skeleton, skeleton

TIME = np.arange(0.0, 1.0, 0.01)
ANGLE = np.sin(6.0 * TIME)
MODELS = {"paper": ANGLE + 0.1, "rollout": ANGLE * 0.99}


def latents(count: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], Directions | None]:
    random = np.random.default_rng(count)
    mean = random.normal(size=(12, count))
    plane = Directions(np.eye(count)[:, :2], np.array([0.5, 0.2])) if count > 1 else None
    return mean, np.full((12, count), -2.0), {"kp": random.uniform(8, 10, 12), "delay": np.full(12, 0.005)}, plane


def trot(frames: int = 60) -> Skeleton:
    qpos = np.zeros((frames, 19))
    qpos[:, 0] = 0.004 * np.arange(frames)
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height, 1.0, spec.NOMINAL_POSE
    qpos[:, 8] += 0.3 * np.sin(np.arange(frames) / 5.0)
    return skeleton(PUPPER_V2, qpos)


def curves() -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    return {
        "rollout": [
            (np.arange(0, 50, 5), np.linspace(0, 1, 10)),
            (np.arange(0, 40, 4), np.linspace(0, 2, 10)),
        ],
        "paper": [(np.arange(3), np.zeros(3))],
    }


FIDELITY = {
    "closed loop, steps [rad]": {"paper": 0.02, "rollout": 0.01},
    "robot, hung [rad]": {"paper": float("inf"), "rollout": 0.012},
    "torque above 20 Hz [N·m]": {"paper": 1.3},
}
OWN, TWIN = {"rollout": (0.4, 1.0), "paper": (-0.1, 0.3)}, {"rollout": (0.38, 0.99), "tuned_pd": (0.1, 0.9)}
MAKERS: dict[str, Callable[[], Figure]] = {
    "excitation": lambda: excitation_and_response(TIME, ANGLE, ANGLE, ANGLE, ANGLE, ANGLE, "motor 1"),
    "excitation_bare": lambda: excitation_and_response(TIME, ANGLE, ANGLE, None, None, None, "motor 1"),
    "torque_fit": lambda: torque_fit(TIME, ANGLE, MODELS),
    "latent_0": lambda: latent_map(*latents(0)),
    "latent_1": lambda: latent_map(*latents(1)),
    "latent_2": lambda: latent_map(*latents(2)),
    "latent_4": lambda: latent_map(*latents(4)),
    "closed_loop": lambda: closed_loop(TIME, ANGLE, ANGLE, MODELS, "motor 1"),
    "robot": lambda: robot_traces(TIME, ANGLE, MODELS, ANGLE, MODELS, "FR_knee", "on the ground"),
    "curves": lambda: learning_curves(curves()),
    "fidelity": lambda: fidelity_bars(FIDELITY),
    "transfer": lambda: transfer_bars(OWN, TWIN),
    "real": lambda: real_replay(TIME, ANGLE, ANGLE, MODELS, (ANGLE - 0.1, ANGLE + 0.1), "FR_hip", "log"),
    "real_bare": lambda: real_replay(TIME, ANGLE, ANGLE, MODELS, None, "FR_hip", "log"),
    "strip": lambda: gait_strip(trot(), 0.01, "trot"),
}


@pytest.mark.parametrize("name", MAKERS)
def test_axes_have_units_and_finite_limits(name: str):
    figure = MAKERS[name]()
    axes = [each for each in figure.axes if each.axison and each.get_label() != "<colorbar>"]
    labels = [label for each in axes for label in (each.get_xlabel(), each.get_ylabel()) if label]
    assert all("[" in label and "]" in label for label in labels if label != "trained on")
    assert bool(labels) == bool(axes)
    for each in axes:
        assert np.all(np.isfinite([*each.get_xlim(), *each.get_ylim()]))
    assert png_bytes(figure, dpi=40).startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["closed_loop", "latent_4", "strip"])
def test_the_same_arrays_give_the_same_bytes(name: str):
    first, second = png_bytes(MAKERS[name](), dpi=50), png_bytes(MAKERS[name](), dpi=50)
    assert first == second
    assert b"matplotlib" not in first.lower()


def test_a_model_that_diverges_does_not_flatten_the_truth():
    wild = {"paper": ANGLE * np.exp(20 * TIME), "rollout": np.where(TIME > 0.5, np.nan, ANGLE)}
    figure = closed_loop(TIME, ANGLE, ANGLE, wild, "motor 1")
    low, high = figure.axes[0].get_ylim()
    assert np.ptp(ANGLE) <= high - low < 3 * np.ptp(ANGLE)
    labels = [str(line.get_label()) for line in figure.axes[0].lines]
    assert "paper, RMSE diverged" in labels and "rollout, RMSE diverged" in labels


def test_the_median_curve_covers_what_all_seeds_share():
    figure = learning_curves(curves())
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "rollout, 2 seeds"]
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert x[0] == 0 and x[-1] == 36
    assert y[-1] == pytest.approx((36 / 45 + 2.0) / 2)


def test_the_directions_are_those_that_change_the_features_most():
    random = np.random.default_rng(3)
    turn = np.linalg.qr(random.normal(size=(4, 4)))[0]
    # five features along one direction, three along another, one that nothing moves; of very different units
    slopes = np.concatenate([np.repeat(turn[:1], 5, axis=0), np.repeat(turn[1:2], 3, axis=0), np.zeros((1, 4))])
    found = principal_directions(slopes * np.geomspace(1e-4, 1e3, 9)[:, None])
    np.testing.assert_allclose(found.axes.T @ found.axes, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(np.abs(turn[:2] @ found.axes), np.eye(2), atol=1e-9)
    np.testing.assert_allclose(found.share, [5 / 8, 3 / 8])
    assert np.all(np.isfinite(principal_directions(np.zeros((3, 2))).axes))
