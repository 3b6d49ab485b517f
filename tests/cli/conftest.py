"""The command line as a function, and the smallest inputs that its sub-commands accept."""

import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from third_party_files import csv_columns

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import read_bench
from motorprior.cli.console import Bar
from motorprior.cli.main import main
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.walk import Walk, run_walk
from motorprior.robots.pupper_v2 import spec


@dataclass(frozen=True)
class Outcome:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


Command = Callable[..., Outcome]


@pytest.fixture
def motorprior(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """`motorprior ARGS…`, in this process."""

    def run(*args: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["motorprior", *map(str, args)])
        code: object = 0
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
        assert isinstance(code, int)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


def assert_one_error(err: str, words: tuple[str, ...]) -> None:
    assert err.count("error:") == 1 and "Traceback" not in err, err
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
        before = contents(tmp_path)
        outcome = motorprior(*args)
        assert outcome.code == 2, outcome.err
        assert_one_error(outcome.err, words)
        assert contents(tmp_path) == before

    return run


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also where the tests run in the background and it is ignored."""
    old = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, old)


@pytest.fixture
def ctrl_c(monkeypatch: pytest.MonkeyPatch, interruptible: None) -> Callable[[int], None]:
    """Send this process SIGINT at the n-th advance of a progress bar from now on; 0 for never again."""

    def at(advance_number: int) -> None:
        calls = 0

        def advance(self: Bar, count: int = 1, note: str = "") -> None:
            nonlocal calls
            calls += 1
            if calls == advance_number:
                signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(Bar, "advance", advance)

    return at


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bench folder: 12 motors, 300 samples."""
    folder = tmp_path_factory.mktemp("inputs") / "bench"
    run_bench(Bench(folder, motors=spec.NUM_JOINTS, steps=300))
    return folder


@pytest.fixture(scope="session")
def prior_of_bench(bench: Path) -> MotorPrior:
    """An untrained network for the motors of `bench`."""
    return tiny_prior(bench)


@pytest.fixture(scope="session")
def prior(bench: Path, prior_of_bench: MotorPrior) -> Path:
    """Its file."""
    path = bench.parent / "prior.safetensors"
    prior_of_bench.save(path)
    return path


@pytest.fixture(scope="session")
def walk(bench: Path) -> Path:
    """A walk folder: one iteration on an ideal PD."""
    folder = bench.parent / "walk"
    run_walk(Walk(out=folder, motors="pd", iterations=1, episode_steps=5, workers=1))
    return folder


@pytest.fixture
def pupper_logs(tmp_path: Path) -> Path:
    """A folder with one small log in the format of the real robot's."""
    folder = tmp_path / "logs"
    folder.mkdir()
    write_pupper_csv(folder / "env_real_tiny_log.csv")
    return folder


def tiny_prior(bench: Path) -> MotorPrior:
    """Zero torque for any z: enough for everything but walking."""
    settings = read_bench(bench)[1]
    taps, latents, neurons = (0, 1), 2, 4
    network = LatentNetwork(
        w1=np.zeros((2 * len(taps), neurons)),
        v1=np.zeros((latents, neurons)),
        b1=np.zeros(neurons),
        w2=np.zeros((neurons, neurons)),
        b2=np.zeros(neurons),
        w3=np.zeros(neurons),
        b3=np.zeros(()),
        log_armature=np.array(-6.0),
        armature_slope=np.zeros(latents),
        taps=taps,
        period=spec.PHYSICS_DT,
        error_scale=0.1,
        velocity_scale=1.0,
        torque_scale=1.0,
        torque_limit=3.0,
        has_armature=True,
    )
    motors = np.zeros((settings.motors, latents))
    provenance = {"bench": settings.as_json()}
    return MotorPrior(network, motors, motors, "rollout", spec.ROBOT_NAME, settings.fleet.motor, provenance, {})


def write_pupper_csv(path: Path, rows: int = 40) -> None:
    """Every joint follows a slow sine, 20 ms late."""
    time = 0.01 * np.arange(rows)
    command, angle = (spec.NOMINAL_POSE + 0.1 * np.sin(2 * np.pi * (time - late))[:, None] for late in (0.0, 0.02))
    table = np.column_stack([time, command, angle, np.zeros((rows, 4))])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(csv_columns(spec.NUM_JOINTS)), comments="")
