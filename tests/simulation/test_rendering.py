"""Films of a walk: MuJoCo's renderer in a process of its own, and its window."""

# pyright: reportAttributeAccessIssue=false
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pytest

from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.build_model import build_model
from motorprior.simulation.camera import prepare
from motorprior.simulation.rendering import HEIGHT, WIDTH, rendered
from motorprior.simulation.viewer import show


def standing(frames: int) -> np.ndarray:
    qpos = np.zeros((frames, 19))
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = PUPPER_V2.standing_height, 1.0, PUPPER_V2.nominal_pose
    return qpos


def test_the_robot_is_in_the_picture_and_moves():
    walk = standing(3)
    walk[1:, 0] = 0.05
    walk[2, 8] += 0.5
    try:
        with rendered(PUPPER_V2.name, [walk, standing(3)]) as frames:
            pictures = list(frames)
    except ConfigError as error:
        pytest.skip(f"no OpenGL: {error.problem}")
    assert [picture.shape for picture in pictures] == [(2 * HEIGHT, WIDTH, 3)] * 3
    upper, lower = (
        np.array([picture[part] for picture in pictures], int) for part in (slice(HEIGHT), slice(HEIGHT, None))
    )

    def apart(one: np.ndarray, other: np.ndarray) -> int:
        return np.abs(one - other).max()

    assert apart(lower[0], lower[1]) < 10 and apart(upper[0], lower[0]) < 10  # a GPU rounds as it likes
    assert apart(upper[0], upper[1]) > 40 and apart(upper[1], upper[2]) > 40


def test_a_process_that_cannot_draw_is_an_error_with_its_reason(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    with pytest.raises(ConfigError, match="nothing") as error, rendered(PUPPER_V2.name, [standing(1)]):
        pass
    assert error.value.remedy and "EGL" in error.value.remedy


@contextmanager
def window_of(seen: list[np.ndarray], data: mujoco.MjData, most: int) -> Iterator[SimpleNamespace]:
    """A window that is closed after some frames."""
    yield SimpleNamespace(
        cam=SimpleNamespace(), opt=mujoco.MjvOption(), lock=nullcontext, sync=lambda: seen.append(data.qpos.copy()),
        is_running=lambda: len(seen) < most,
    )  # fmt: skip


def test_the_window_shows_one_walk_after_the_other_until_it_is_closed(monkeypatch: pytest.MonkeyPatch):
    seen: list[np.ndarray] = []
    fake: ModuleType = ModuleType("mujoco.viewer")
    fake.launch_passive = lambda model, data, **_: window_of(seen, data, 5)  # pyright: ignore
    monkeypatch.setitem(sys.modules, "mujoco.viewer", fake)
    monkeypatch.setattr(mujoco, "viewer", fake, raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(time, "monotonic", lambda: 0.0)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    first, second = standing(2), standing(1)
    first[:, 0], second[:, 0] = (1.0, 2.0), 3.0
    show(PUPPER_V2, [first, second], 0.01)
    assert [row[0] for row in seen] == [1.0, 2.0, 3.0, 1.0, 2.0]


def test_a_window_that_does_not_open_is_an_error(monkeypatch: pytest.MonkeyPatch):
    fake: ModuleType = ModuleType("mujoco.viewer")

    def launch_passive(*_: object, **__: object) -> None:
        raise RuntimeError("could not initialize GLFW")

    fake.launch_passive = launch_passive  # pyright: ignore
    monkeypatch.setitem(sys.modules, "mujoco.viewer", fake)
    monkeypatch.setattr(mujoco, "viewer", fake, raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(ConfigError, match="could not initialize GLFW"):
        show(PUPPER_V2, [standing(1)], 0.01)


def test_a_robot_of_collision_shapes_alone_is_seen():
    model = build_model(PUPPER_V2)
    for group, shown in ((0, 0), (2, 0), (3, 1)):
        model.geom_group[1:], option = group, mujoco.MjvOption()
        prepare(model, option)
        assert option.geomgroup[3] == shown
    model.geom_group[1] = 0  # one that is shown is enough
    option = mujoco.MjvOption()
    prepare(model, option)
    assert option.geomgroup[3] == 0
