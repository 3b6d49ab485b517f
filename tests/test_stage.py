"""A finished stage is not repeated, an interrupted one is, and a folder has one writer."""

import subprocess
import sys
from pathlib import Path

import pytest

from motorprior.progress import SILENT, in_parallel
from motorprior.stage import MARKER, description, is_finished, locked, working

STAGE = {"stage": "walk", "config": {"seed": 0}}


def test_a_stage_is_finished_once_it_ends_without_error(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt), working(tmp_path, STAGE):
        raise KeyboardInterrupt
    assert not is_finished(tmp_path, STAGE)

    with working(tmp_path, STAGE):
        assert not is_finished(tmp_path, STAGE)

    assert is_finished(tmp_path, STAGE)
    assert not is_finished(tmp_path, {"stage": "walk", "config": {"seed": 1}})


def test_a_stage_that_writes_nothing_leaves_no_folder(tmp_path: Path):
    with (
        pytest.raises(ZeroDivisionError),
        locked(tmp_path / "out"),
        working(tmp_path / "out", STAGE),
    ):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_stage_with_a_damaged_marker_is_not_finished(tmp_path: Path):
    for text in ("{", "[]"):
        (tmp_path / MARKER).write_text(text)
        assert not is_finished(tmp_path, STAGE)


def test_a_stage_is_described_by_the_content_of_its_inputs_not_by_their_paths(tmp_path: Path):
    for name, text in (("a/log", "1"), ("b/log", "1"), ("c/log", "2")):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)

    original, moved, changed = (
        description("fit", {"seed": 0, "log": tmp_path / name}, [tmp_path / name])
        for name in ("a/log", "b/log", "c/log")
    )

    assert original == moved
    assert original != changed


def test_another_process_cannot_write_to_a_locked_folder(tmp_path: Path):
    code = "import sys; from pathlib import Path; from motorprior.stage import locked\n"
    code += "with locked(Path(sys.argv[1])): pass"
    command = [sys.executable, "-c", code, str(tmp_path)]
    with locked(tmp_path), locked(tmp_path):
        refused = subprocess.run(command, capture_output=True, text=True, check=False)
        assert refused.returncode == 1
        assert "another command writes there" in refused.stderr

    subprocess.run(command, check=True)


def test_parallel_results_are_in_order_and_errors_reach_the_caller():
    assert in_parallel([lambda _, n=n: n * n for n in range(5)], 2, SILENT) == [0, 1, 4, 9, 16]
    with pytest.raises(ZeroDivisionError):
        in_parallel([lambda _: 1 / 0, lambda _: 1.0], 2, SILENT)
