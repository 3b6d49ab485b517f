"""`transfer --study` trains its own policies; its options are for it alone."""

from collections.abc import Callable
from pathlib import Path


def test_without_walks_there_is_nothing_to_transfer(motorprior: Callable, tmp_path: Path):
    done = motorprior("transfer", "--out", tmp_path / "out")
    assert done.code == 2 and "no policy given" in done.err
