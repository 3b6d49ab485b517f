"""`motorprior identify` stopped by Ctrl-C or killed continues to the same bytes."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json, read_tensors
from motorprior.identification.fit_prior import CHECKPOINT, PRIOR
from motorprior.stage import MARKER

Command = Callable[..., Any]
STEPS = 1200  # checkpoints at 500 and 1000
# A command that ends at its first checkpoint, as by kill -9.
KILLED = """
import os, signal
from motorprior.cli.main import main
from motorprior.identification import fit_prior as identify

save = identify._Checkpoint.save

def save_and_die(*args):
    save(*args)
    os.kill(os.getpid(), signal.SIGKILL)

identify._Checkpoint.save = save_and_die
main()
"""


def words(bench: Path, out: Path, seed: int = 0) -> list[str]:
    return [*map(str, ("identify", bench, "--preset", "paper_wide", "--steps", STEPS, "--seed", seed, "--out", out))]


@pytest.fixture(scope="module")
def whole(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Identified without interruption."""
    out = tmp_path_factory.mktemp("whole") / "prior"
    subprocess.run([sys.executable, "-m", "motorprior.cli.main", *words(bench, out)], check=True, capture_output=True)
    return out


def assert_finished_like(out: Path, whole: Path) -> None:
    assert (out / PRIOR).read_bytes() == (whole / PRIOR).read_bytes()
    one, other = (read_json(folder / MARKER) for folder in (out, whole))
    assert {name for name in one.keys() | other.keys() if one[name] != other[name]} <= {"seconds"}
    assert not (out / CHECKPOINT).exists()


@pytest.mark.parametrize("stops", [(7,), (6, 6)], ids=str)  # after one checkpoint, and after two
def test_ctrl_c_and_the_same_command_again_end_at_the_same_bytes(
    motorprior: Command, ctrl_c: Callable[[int], None], bench: Path, whole: Path, tmp_path: Path,
    stops: tuple[int, ...],
):  # fmt: skip
    out = tmp_path / "prior"
    for stop in stops:
        ctrl_c(stop)
        outcome = motorprior(*words(bench, out))
        assert outcome.code == 130 and "run the same command again to continue" in outcome.err
        assert not (out / PRIOR).exists()
    assert len(read_tensors(out / CHECKPOINT)[0]["losses"]) == sum(stop // 5 * 5 for stop in stops)
    ctrl_c(0)
    assert motorprior(*words(bench, out)).code == 0
    assert_finished_like(out, whole)


def test_a_killed_process_is_continued_from_its_checkpoint(
    motorprior: Command, bench: Path, whole: Path, tmp_path: Path
):
    out = tmp_path / "prior"
    done = subprocess.run([sys.executable, "-c", KILLED, *words(bench, out)], stderr=subprocess.DEVNULL, check=False)
    assert done.returncode == -signal.SIGKILL and (out / CHECKPOINT).exists()
    assert motorprior(*words(bench, out)).code == 0
    assert_finished_like(out, whole)
