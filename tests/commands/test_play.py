"""`play`: commands of a policy, measures of its walk, and a film of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motorprior.commands.play import Play, run_play
from motorprior.exceptions import MotorPriorError
from motorprior.locomotion.command import Timetable
from motorprior.report import film
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@pytest.fixture(autouse=True)
def stick_figures_in_a_gif(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "can_write_mp4", lambda: False)
    monkeypatch.setenv("MUJOCO_GL", "disable")


def test_two_policies_are_one_under_the_other_in_a_film_that_repeats_exactly(gait_walk: Path, tmp_path: Path):
    config = Play((gait_walk, gait_walk / "policy.safetensors"), tmp_path / "a", forward=0.2, seconds=1.0)
    (first, results), (second, _) = run_play(config), run_play(replace(config, out=tmp_path / "b"))
    assert first.read_bytes() == second.read_bytes()
    with Image.open(first) as image:
        found = image.n_frames, image.size  # pyright: ignore[reportAttributeAccessIssue]
    assert found == (20, (480, 2 * 288))
    rows = [(row.model, row.quantity, row.value) for row in results]
    assert rows == [(name, "upright", 1.0) for name in ("gait_0", "gait_0 (2)")], "too short for the rest"
    assert (tmp_path / "a" / "figures.json").is_file()


def test_a_walk_with_changing_commands_has_no_measures_of_one_command(gait_walk: Path, tmp_path: Path):
    (tmp_path / "s.csv").write_text("time_s,forward_m_s,yaw_rate_rad_s\n0,0.3,0\n1.75,0.1,0\n")
    _, found = run_play(Play((gait_walk,), tmp_path / "out", schedule=tmp_path / "s.csv", seconds=2.5))
    measured = set(found.distinct("quantity"))
    assert not {"lateral_share", "heading_deg_per_m", "speed_error"} & measured
    assert {"slip", "transport", "dragged_steps"} <= measured
    assert 0.0 < found.value(quantity="speed_off") < 0.5


def test_a_turn_on_the_spot_has_no_measures_per_metre(gait_walk: Path, tmp_path: Path):
    _, found = run_play(Play((gait_walk,), tmp_path / "a", forward=0.0, yaw_rate=0.6, seconds=2.5))
    measured = set(found.distinct("quantity"))
    assert not {"speed_error", "speed_off", "heading_deg_per_m", "lateral_share", "slip", "transport"} & measured
    assert {"upright", "speed", "foot_lift_mm"} <= measured


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,fast,0\n", ("row 1", "forward_m_s", "fast")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,9,0\n", ("row 1", "forward_m_s is 9", "-0.2 to 0.5")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n0,0.2,0\n", ("row 1", "time_s is 0", "increase")),
        ("time,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n", ("time_s",)),
    ],
)
def test_an_invalid_schedule_is_rejected_by_file_row_and_value(tmp_path: Path, text: str, words: tuple[str, ...]):
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(MotorPriorError) as error:
        Timetable.read(tmp_path / "plan.csv", PUPPER_V2)
    assert [word for word in ("plan.csv", *words) if word not in str(error.value)] == []


def test_a_schedule_is_read_as_it_is_written(tmp_path: Path):
    (tmp_path / "plan.csv").write_text("time_s,forward_m_s,yaw_rate_rad_s\n0,0.3,0\n1.75,-0.1,0.5\n")
    commands = Timetable.read(tmp_path / "plan.csv", PUPPER_V2).schedule(PUPPER_V2, 0, 200)
    np.testing.assert_array_equal(commands[[0, 174, 175, 199]], [[0.3, 0], [0.3, 0], [-0.1, 0.5], [-0.1, 0.5]])
