"""A word that a command does not know is refused with what the user may have meant."""

from collections.abc import Callable
from typing import Any

import pytest

from motorprior.cli import main as command_line

OUT = ("--out", "x")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        # a robot after a flag, and a file of one
        (("record", "--virtual", "so101", *OUT), ("'so101'", "--virtual", "--robot so101")),
        (("doctor", "--virtual", "arm.toml"), ("'arm.toml'", "--robot arm.toml")),
        # a typing error, also of a flag that is switched off, and of an option within a group
        (("identify", "a.parquet", *OUT, "--presett=quick"), ("--presett", "mean --preset?")),
        (("walk", "--motors", "pd", *OUT, "--no-symetric"), ("mean --no-symmetric?",)),
        (("walk", "--motors", "pd", *OUT, "--task.aliv", "1"), ("mean --task.alive?",)),
        # a setting that is given without its name
        (("identify", "--logs", "a.parquet", *OUT), ("--logs", "without --logs")),
        # an option of other commands
        (("identify", "a.parquet", *OUT, "--virtual"), ("--virtual", "record", "deploy")),
        # neither
        (("demo", *OUT, "--windows"), ("--windows", "--help-all")),
        (("demo", *OUT, "more"), ("'more'", "--help-all")),
    ],
)
def test_an_unknown_word_is_refused_with_a_remedy(
    refused: Callable[..., None], words: tuple[str, ...], expected: tuple[str, ...]
):
    refused(*words, words=expected)


def test_a_command_of_robots_names_the_systems_that_it_needs(
    motorprior: Callable[..., Any],
    one_error: Callable[[str, tuple[str, ...]], None],
    monkeypatch: pytest.MonkeyPatch,
):
    def parse(words: list[str]) -> None:
        raise ModuleNotFoundError("No module named 'termios'", name="termios")

    monkeypatch.setattr(command_line, "parse", parse)
    outcome = motorprior("doctor")

    assert outcome.code == 2
    one_error(outcome.err, ("Linux", "macOS", "WSL"))
