"""`transfer --study` trains its own policies; its options are for it alone."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest

from motorprior.cli.transfer import _command
from motorprior.pipeline.transfer_study.study_settings import Study


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--seeds", 3), ("--seeds is for the study",)),
        (("--quick",), ("--quick is for the study",)),
        (("--study", "--engine", "pybullet"), ("trains its own policies", "engine")),
        (("--study", "--draws", 0), ("draws 0", "1")),
        (("--study", "--conditions", "nobody"), ("no condition 'nobody'", "prior_adapted")),
        (("--study", "--conditions"), ("conditions are missing", "prior_adapted")),
        (("--study", "--foreign", "nobodys"), ("no fleet", "foreign_direct")),
    ],
    ids=str,
)
def test_what_does_not_belong_together_is_refused(
    motorprior: Callable, tmp_path: Path, options: tuple, words: tuple[str, ...]
):
    done = motorprior("transfer", *options, "--out", tmp_path / "out")
    assert done.code == 2 and all(word in done.err for word in words), done.err
    assert not (tmp_path / "out").exists()


def test_a_study_takes_no_walks(motorprior: Callable, walk: Path, tmp_path: Path):
    done = motorprior("transfer", walk, "--study", "--out", tmp_path / "out")
    assert done.code == 2 and "neither walks" in done.err


def test_without_walks_there_is_nothing_to_transfer(motorprior: Callable, tmp_path: Path):
    done = motorprior("transfer", "--out", tmp_path / "out")
    assert done.code == 2 and "no policy given" in done.err


def test_the_command_of_a_page_has_every_option_that_was_given():
    given = {field.name: field.default for field in fields(Study)} | {"out": Path("a b"), "quick": True, "seeds": 3}
    assert _command(given) == "motorprior transfer --study --out 'a b' --seeds 3 --quick"
    given |= {"conditions": ("prior", "oracle")}
    assert _command(given) == "motorprior transfer --study --out 'a b' --conditions prior oracle --seeds 3 --quick"
