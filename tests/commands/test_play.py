"""`play`: commands of a policy, measures of its walk, and a film of it."""

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


def test_two_policies_are_one_under_the_other_in_a_film_that_repeats_exactly(
    gait_walk: Path, tmp_path: Path
):
    config = Play(
        (gait_walk, gait_walk / "policy.safetensors"), tmp_path / "a", forward=0.2, seconds=1.0
    )
    (first, results), (second, _) = run_play(config), run_play(replace(config, out=tmp_path / "b"))
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as image:
        found = image.n_frames, image.size, image.info["loop"]  # pyright: ignore[reportAttributeAccessIssue]
    assert found == (20, (480, 2 * 288), 0)
    rows = [(row.model, row.quantity, row.value) for row in results]
    assert rows == [(name, "upright", 1.0) for name in ("gait_0", "gait_0 (2)")], (
        "too short for the rest"
    )
    assert (tmp_path / "a" / "figures.json").is_file()


def test_a_turn_on_the_spot_has_no_measures_per_metre(gait_walk: Path, tmp_path: Path):
    _, found = run_play(Play((gait_walk,), tmp_path / "a", forward=0.0, yaw_rate=0.6, seconds=2.5))
    measured = set(found.distinct("quantity"))
    assert (
        not {"speed_error", "heading_deg_per_m", "lateral_share", "slip", "cost_of_transport"}
        & measured
    )
    assert {"upright", "speed", "foot_lift_mm"} <= measured
