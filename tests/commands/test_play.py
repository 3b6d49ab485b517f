"""`play` walks with policies at a command, evaluates the walks and films them."""

from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from motorprior.commands.play import Play, run_play
from motorprior.report import film


@pytest.fixture(autouse=True)
def stick_figures_in_a_gif(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "can_write_mp4", lambda: False)
    monkeypatch.setenv("MUJOCO_GL", "disable")


def test_a_film_of_two_policies_is_the_same_bytes_twice(gait_walk: Path, tmp_path: Path):
    config = Play(
        (gait_walk, gait_walk / "policy.safetensors"), tmp_path / "a", forward=0.2, seconds=1.0
    )

    film_path, results = run_play(config)
    repeated_path, _ = run_play(replace(config, out=tmp_path / "b"))

    assert film_path.read_bytes() == repeated_path.read_bytes()

    with Image.open(film_path) as image:
        assert image.n_frames == 20  # pyright: ignore[reportAttributeAccessIssue]
        assert image.size == (480, 2 * 288)
        assert image.info["loop"] == 0, "endless"

    rows = [(row.model, row.quantity, row.value) for row in results]

    assert rows == [("gait_0", "upright", 1.0), ("gait_0 (2)", "upright", 1.0)], (
        "one second is too short for other quantities"
    )
    assert (tmp_path / "a" / "figures.json").is_file()


def test_a_turn_on_the_spot_has_no_quantities_per_metre(gait_walk: Path, tmp_path: Path):
    config = Play((gait_walk,), tmp_path / "a", forward=0.0, yaw_rate=0.6, seconds=2.5)

    _, results = run_play(config)

    quantities = set(results.distinct("quantity"))
    per_metre = {"speed_error", "heading_deg_per_m", "lateral_share", "slip", "cost_of_transport"}

    assert not per_metre & quantities
    assert {"upright", "speed", "foot_lift_mm"} <= quantities
