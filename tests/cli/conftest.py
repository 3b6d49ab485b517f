"""The command line as a function, and the smallest inputs that its sub-commands accept."""

import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import read_bench
from motorprior.cli.main import main
from motorprior.commands.bench import Bench, run_bench
from motorprior.progress import Task
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@dataclass(frozen=True)
class Outcome:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


Command = Callable[..., Outcome]


@pytest.fixture
def motorprior(capsys: pytest.CaptureFixture[str]) -> Command:
    """The command `motorprior ARGS…`, run in this process."""

    def run(*args: object) -> Outcome:
        code: object = 0
        with patch.object(sys, "argv", ["motorprior", *map(str, args)]):
            try:
                main()
            except SystemExit as stop:
                code = stop.code or 0

        assert isinstance(code, int)

        captured = capsys.readouterr()

        return Outcome(code, captured.out, captured.err)

    return run


def contents(folder: Path) -> dict[Path, bytes]:
    """Bytes of all files in a folder except locks."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {path: path.read_bytes() for path in files}


def assert_one_error(err: str, words: tuple[str, ...]) -> None:
    assert err.count("error:") == 1, err
    assert "Traceback" not in err, err

    message = err[err.index("error:") :].strip()

    assert "\n" not in message, "one line"
    assert " -> " in message, "a remedy"
    assert [word for word in words if word not in message] == [], message


@pytest.fixture
def one_error() -> Callable[[str, tuple[str, ...]], None]:
    """Assert that the output is one error in one line, with a remedy and these words."""
    return assert_one_error


@pytest.fixture
def refused(motorprior: Command, tmp_path: Path) -> Callable[..., None]:
    """Run a command that must fail with these words and change no file."""

    def run(*args: object, words: tuple[str, ...]) -> None:
        original = contents(tmp_path)
        outcome = motorprior(*args)

        assert outcome.code == 2, outcome.err
        assert_one_error(outcome.err, words)
        assert contents(tmp_path) == original

    return run


@pytest.fixture
def ctrl_c(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Send this process SIGINT at the n-th advance of a task from now on, or never (0)."""
    # a process in the background ignores SIGINT
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)

    def at(advance_number: int) -> None:
        calls = 0

        def advance(self: Task, count: int = 1, note: str = "") -> None:
            nonlocal calls
            calls += 1
            if calls == advance_number:
                signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(Task, "advance", advance)

    yield at
    signal.signal(signal.SIGINT, handler)


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bench folder: 12 motors, 300 samples."""
    folder = tmp_path_factory.mktemp("inputs") / "bench"
    run_bench(Bench(folder, motors=PUPPER_V2.num_joints, steps=300))
    return folder


@pytest.fixture(scope="session")
def prior(bench: Path, grey_box: Callable[..., GreyBox]) -> Path:
    """The file of a prior for the motors of `bench`."""
    path = bench.parent / "prior.safetensors"
    settings = read_bench(bench)[1]
    latents = np.zeros((12, 3))
    provenance = {"bench": settings.as_json()}
    motor = settings.fleet.motor

    prior = MotorPrior(grey_box(), latents, latents, "rollout", PUPPER_V2.name, motor, provenance)
    prior.save(path)

    return path
