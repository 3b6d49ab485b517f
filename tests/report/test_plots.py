"""Plots say their units, stay finite, and one model has one colour everywhere."""

from collections.abc import Callable
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from motorprior.report.gait_picture import gait_animation, gait_strip
from motorprior.report.latent_directions import (
    Directions,
    behaviour_directions,
    best_explained,
    principal_directions,
)
from motorprior.report.plots_latent import latent_map
from motorprior.report.plots_motor import closed_loop, excitation_and_response, torque_fit
from motorprior.report.plots_robot import real_replay, robot_traces
from motorprior.report.plots_study import fidelity_bars, learning_curves, transfer_bars
from motorprior.report.plots_style import MODEL_COLORS, model_color, model_label, png_bytes
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


def test_a_model_has_the_same_colour_in_every_trace():
    for name in ("torque_fit", "closed_loop", "robot", "curves"):
        lines = [line for axes in MAKERS[name]().axes for line in axes.lines if str(line.get_label())[:5] == "paper"]
        assert lines
        assert {to_rgb(line.get_color()) for line in lines} == {to_rgb(MODEL_COLORS["paper"])}


def test_a_file_keeps_white_and_a_models_colour():
    image = Image.open(BytesIO(png_bytes(MAKERS["transfer"](), dpi=60))).convert("RGB")
    pixels = np.asarray(image).reshape(-1, 3)
    for color in ("white", MODEL_COLORS["rollout"]):
        wanted = np.round(np.array(to_rgb(color)) * 255)
        assert np.count_nonzero(np.all(pixels == wanted, axis=1)) > 100


def test_variants_and_unknown_models_have_a_colour_and_a_name():
    assert model_color("rollout_adapted") == MODEL_COLORS["rollout"]
    assert model_label("rollout_adapted") == "rollout adapted"
    assert model_label("ideal_pd") == "ideal PD"
    assert model_color("something_else") not in MODEL_COLORS.values()
    assert model_label("something_else") == "something else"


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


def test_the_latent_that_makes_motors_differ_is_the_first_direction(grey_network):
    network = grey_network(latents=3)
    motor = replace(network.motor, slope=network.motor.slope * np.array([[0.05], [1.0], [0.05]]))
    found = behaviour_directions(replace(network, motor=motor))
    assert abs(found.axes[1, 0]) > 0.95 and found.share[0] > 0.8


def test_constants_are_shown_in_the_order_in_which_the_map_tells_them():
    random = np.random.default_rng(5)
    points, noise = random.normal(size=(40, 2)), random.normal(size=(3, 40))
    values = {"same": np.ones(40), "noise": noise[0], "plain": points @ [1.0, -2.0], "vague": points[:, 0] + noise[1]}
    assert list(best_explained(points, values, 6)) == ["plain", "vague", "noise"]
    assert list(best_explained(points, values, 1)) == ["plain"]


def test_the_animation_is_small_repeats_exactly_and_runs_in_real_time():
    first = gait_animation(trot(), 0.01, "trot")
    assert first == gait_animation(trot(), 0.01, "trot")
    assert len(first) < 400_000
    image = Image.open(BytesIO(first))
    assert image.n_frames == 12  # pyright: ignore[reportAttributeAccessIssue]
    assert image.info["duration"] == 50
    assert image.info["loop"] == 0
