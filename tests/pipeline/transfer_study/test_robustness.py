"""Robustness maps: what differs in a cell is what its axes say, and a map does not depend on the threads."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.artifacts import write_tensors
from motorprior.exceptions import ArtifactError
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.stage import MARKER
from motorprior.pipeline.transfer_study import robustness as stage
from motorprior.pipeline.watching.walk_report import build_walk_report
from motorprior.report.plots_robustness import robustness_maps
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.transfer import robustness
from motorprior.transfer.robustness import MAPS, Scale, UprightMap, grids, load_maps, save_maps, upright_row


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short episodes, few of them."""
    for module in (robustness, stage):
        monkeypatch.setattr(module, "DURATION_STEPS", 120)
    monkeypatch.setattr(robustness, "ROBUSTNESS_DRAWS", 2)
    monkeypatch.setattr(robustness, "MASSES", (0.8, 1.0, 1.2, 4.0))


def test_a_cell_has_the_values_of_its_axes():
    shoved, late = grids(PUPPER_V2)
    push, mu = shoved.rows.values[-1], shoved.columns.values[0]
    conditions = shoved.cell(push, mu).conditions(PUPPER_V2, 3, 300)
    assert conditions.friction * PUPPER_V2.foot_friction == pytest.approx(mu)
    impulse = np.linalg.norm(conditions.push, axis=1).max() * PUPPER_V2.control_dt
    assert 0.0 < impulse <= push
    heavy = late.cell(20.0, 1.2).conditions(PUPPER_V2, 3, 300)
    assert heavy.command_delay == pytest.approx(0.02) and heavy.mass == pytest.approx(1.2)
    nominal = late.cell(0.0, 1.0).conditions(PUPPER_V2, 3, 300)
    assert nominal.command_delay == 0.0 and (nominal.mass == 1.0).all() and len(nominal.push) == 0


def test_the_share_counts_the_time_before_a_fall(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(robustness, "DURATION_STEPS", 100)
    monkeypatch.setattr(robustness, "ROBUSTNESS_DRAWS", 2)
    seeds: list[int] = []

    def simulator(*ends: tuple[int, int]) -> Any:
        left = iter(ends)

        def run(policy: object, seed: int) -> SimpleNamespace:
            seeds.append(seed)
            steps, fault = next(left)
            return SimpleNamespace(steps=steps, fault=fault)

        return SimpleNamespace(run=run)

    policy: Any = SimpleNamespace(arrays=lambda: None)
    cells = [simulator((100, 0), (51, 0)), simulator((100, 1), (1, 0))]
    np.testing.assert_allclose(upright_row(policy, cells), [(1.0 + 0.5) / 2, (0.99 + 0.0) / 2])
    assert seeds[:2] == seeds[2:] and len(set(seeds)) == 2


def test_a_map_does_not_depend_on_the_threads_and_ends_where_the_robot_is_too_heavy(gait_walk: Path, small: None):
    one = stage.robustness(gait_walk / "policy.safetensors", PUPPER_V2, 1)
    two = stage.robustness(gait_walk / "policy.safetensors", PUPPER_V2, 2)
    assert [shown.share.shape for shown in one] == [(4, 4), (4, 4)]
    for first, second in zip(one, two, strict=True):
        np.testing.assert_array_equal(first.share, second.share)
    shoved, late = one
    assert shoved.share[0, -1] == 1.0 and late.share[0, 1] == 1.0
    assert late.share[:, -1].max() < 1.0


def test_the_numbers_are_in_the_cells():
    share = np.arange(6.0).reshape(2, 3) / 10.0
    shown = UprightMap(Scale("push [N·s]", (0.0, 1.0)), Scale("friction [-]", (0.3, 0.5, 1.0)), share)
    (axes,) = robustness_maps([shown]).axes
    assert [text.get_text() for text in axes.texts] == ["0", "10", "20", "30", "40", "50"]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0.3", "0.5", "1"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("friction [-]", "push [N·s]")


def test_maps_are_read_as_they_were_written(tmp_path: Path):
    shown = UprightMap(Scale("a", (0.0, 0.1)), Scale("b", (0.3, 0.5, 1.0)), np.arange(6.0).reshape(2, 3) / 10.0)
    other = UprightMap(Scale("c", (1.0,)), Scale("d", (2.0,)), np.array([[0.25]]))
    save_maps(tmp_path / MAPS, [shown, other])
    found = load_maps(tmp_path / MAPS)
    assert [(each.rows, each.columns) for each in found] == [(each.rows, each.columns) for each in (shown, other)]
    for each, written in zip(found, (shown, other), strict=True):
        np.testing.assert_array_equal(each.share, written.share)


@pytest.mark.parametrize(
    ("titles", "left_out", "words"),
    [
        ([["a", "b"]], "0/share", r"map 0 has shape \(\), its 2 axes \(2,\) and \(3,\)"),
        ([["a", "b"], ["c", "d"]], "", "map 1 has shape"),
        ([["a", "b", "c"]], "", "its 3 axes"),
        ([], "", "titles"),
        (5, "", "titles"),
        ([[1, 2]], "", "titles"),
    ],
)
def test_damaged_maps_are_refused(tmp_path: Path, titles: Any, left_out: str, words: str):
    tensors = {"0/rows": np.arange(2.0), "0/columns": np.arange(3.0), "0/share": np.zeros((2, 3))}
    tensors.pop(left_out, None)
    write_tensors(tmp_path / MAPS, tensors, {"titles": titles})
    with pytest.raises(ArtifactError, match=words):
        load_maps(tmp_path / MAPS)


def test_maps_are_kept_until_the_policy_is_another(gait_walk: Path, small: None, tmp_path: Path):
    walk, maps = tmp_path / "walk", tmp_path / "maps"
    shutil.copytree(gait_walk, walk)
    kept = stage.Robustness(walk, maps, workers=1)
    stage.run_robustness(kept)
    before = [(maps / name).read_bytes() for name in (MARKER, MAPS)]
    stage.run_robustness(replace(kept, workers=2))
    assert [(maps / name).read_bytes() for name in (MARKER, MAPS)] == before
    policy = Policy.load(walk / "policy.safetensors")
    replace(policy, weights=policy.weights + 1.0).save(walk / "policy.safetensors")
    stage.run_robustness(kept)
    assert [(maps / name).read_bytes() for name in (MARKER, MAPS)] != before
    assert load_maps(maps / MAPS)[0].share[0, -1] < 1.0


def test_the_page_of_a_walk_has_them_unless_they_are_not_wanted(gait_walk: Path, small: None):
    plain = build_walk_report(gait_walk, "pupper_v2", "motorprior report", False).read_text("utf-8")
    full = build_walk_report(gait_walk, "pupper_v2", "motorprior report").read_text("utf-8")
    assert "Robustness" not in plain and "Robustness" in full and "time upright" in full.lower()
