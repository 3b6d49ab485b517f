"""`motorprior identify` stopped by Ctrl-C continues to the same bytes."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_tensors
from motorprior.identification.fit_prior import CHECKPOINT, PRIOR

Command = Callable[..., Any]
STEPS = 1200  # checkpoints at 500 and 1000


def words(bench: Path, out: Path, seed: int = 0) -> list[str]:
    return [*map(str, ("identify", bench, "--preset", "paper_wide", "--steps", STEPS, "--seed", seed, "--out", out))]


@pytest.fixture(scope="module")
def whole(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Identified without interruption."""
    out = tmp_path_factory.mktemp("whole") / "prior"
    subprocess.run([sys.executable, "-m", "motorprior.cli.main", *words(bench, out)], check=True, capture_output=True)
    return out


def test_ctrl_c_and_the_same_command_again_end_at_the_same_bytes(
    motorprior: Command, ctrl_c: Callable[[int], None], bench: Path, whole: Path, tmp_path: Path
):
    out = tmp_path / "prior"
    for checkpoints in (5, 10):
        ctrl_c(6)
        outcome = motorprior(*words(bench, out))
        assert outcome.code == 130 and "run the same command again to continue" in outcome.err
        assert not (out / PRIOR).exists() and len(read_tensors(out / CHECKPOINT)[0]["losses"]) == checkpoints
    ctrl_c(0)
    assert motorprior(*words(bench, out)).code == 0
    assert (out / PRIOR).read_bytes() == (whole / PRIOR).read_bytes() and not (out / CHECKPOINT).exists()
