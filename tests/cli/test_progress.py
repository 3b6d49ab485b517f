"""A bar ends where its work ends."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.cli.console import Bar
from motorprior.identification import train


@pytest.mark.parametrize("steps", [1, 4, 10, 11])
def test_the_steps_of_an_identification_add_up(
    motorprior: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, bench: Path, steps: int
):
    done: list[int] = []
    monkeypatch.setattr(train, "CHUNK", 4)
    monkeypatch.setattr(Bar, "advance", lambda self, count=1, note="": done.append(count))
    assert (
        motorprior("identify", bench, "--preset", "paper_wide", "--steps", steps, "--out", tmp_path / "out").code == 0
    )
    assert sum(done) == steps
