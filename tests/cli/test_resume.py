"""After Ctrl-C the same command continues and ends at the bytes of an uninterrupted one."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.actuator.fleet import fleet_path
from motorprior.artifacts import read_json
from motorprior.priors.fit_prior import CHECKPOINT, PRIOR_FILE

Command = Callable[..., Any]
RESULTS = ("policy.safetensors", "curve.json", "metrics.jsonl")
MARKER = "stage.json"
WALK = ("walk", "--motors", "pd", "--episode-steps", 20, "--iterations", 12)  # with two evaluations


def results(folder: Path) -> list[Any]:
    """Bytes of the result files, and the marker of the stage without its seconds."""
    marker = read_json(folder / MARKER)

    assert marker.pop("seconds") > 0.0

    return [*((folder / name).read_bytes() for name in RESULTS), marker]


@pytest.fixture(scope="module")
def whole_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk without interruption."""
    folder = tmp_path_factory.mktemp("whole") / "walk"
    options = [str(word) for word in WALK]
    options += ["--workers", "1", "--out", str(folder)]
    command = [sys.executable, "-m", "motorprior", *options]
    subprocess.run(command, check=True, capture_output=True)

    return folder


def test_a_checkpoint_of_other_settings_is_not_continued(
    motorprior: Command, ctrl_c: Callable, tmp_path: Path
):
    line = ("walk", "--episode-steps", 20, "--workers", 1, "--iterations", 4)
    ctrl_c(3)

    assert motorprior(*line, "--motors", "pd:kp=9", "--out", tmp_path / "mixed").code == 130

    ctrl_c(0)

    for name in ("mixed", "fresh"):
        done = motorprior(*line, "--motors", "pd:kp=8", "--out", tmp_path / name)
        assert done.code == 0
        assert "continues" not in done.err

    assert results(tmp_path / "mixed") == results(tmp_path / "fresh")


@pytest.mark.usefixtures("whole_walk")  # compiled once: the process ends between two compilations
def test_ctrl_c_ends_the_process_with_130_at_once_also_with_parallel_trainings(tmp_path: Path):
    # ignored in the background
    signals = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{signals}\nfrom motorprior.__main__ import main\nmain()"
    sizes = ("--iterations", 1_000_000, "--seeds", 2)
    words = [sys.executable, "-c", code, *WALK, *sizes, "--out", tmp_path / "walk"]
    process = subprocess.Popen([str(word) for word in words], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for _ in range(2):  # both trainings have begun
        assert "1000000 iterations" in process.stderr.readline()

    process.send_signal(signal.SIGINT)

    try:
        err = process.communicate(timeout=300.0)[1]
    finally:
        process.kill()

    assert process.returncode == 130, err
    assert err.splitlines()[-1].endswith("run the same command again")
    assert "Traceback" not in err


def modified(folder: Path) -> dict[Path, int]:
    """Time of the last change of all files in a folder except locks."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {path: path.stat().st_mtime_ns for path in files}


def test_a_command_runs_again_if_the_values_of_its_input_changed(
    motorprior: Command, tmp_path: Path
):
    fleet = tmp_path / "mine.toml"
    out = tmp_path / "bench"
    text = fleet_path("pupper_v2").read_text("utf-8")
    line = ("bench", "--motors", 1, "--steps", 10, "--fleet", fleet, "--out", out)
    fleet.write_text(text, "utf-8")

    assert motorprior(*line).code == 0

    first_run = modified(out)

    fleet.write_text(text + "\n# the same numbers\n", "utf-8")

    assert motorprior(*line).code == 0
    assert modified(out) == first_run

    fleet.write_text(text.replace("center = 8.8", "center = 8.9"), "utf-8")

    assert motorprior(*line).code == 0
    assert set(first_run.items()).isdisjoint(modified(out).items())


@pytest.mark.slow
def test_an_interrupted_identification_ends_at_the_same_bytes(
    motorprior: Command, ctrl_c: Callable[[int], None], tmp_path: Path
):
    bench = tmp_path / "bench"
    out = tmp_path / "prior"

    assert motorprior("bench", "--motors", 2, "--steps", 1500, "--out", bench).code == 0

    line = ("identify", bench, "--out")

    assert motorprior(*line, tmp_path / "whole").code == 0

    ctrl_c(4)  # while terms are selected

    first = motorprior(*line, out)
    assert first.code == 130
    assert "continues" not in first.err

    saved = modified(out)

    assert not (out / PRIOR_FILE).exists()
    assert list(out.glob(CHECKPOINT.format("*")))

    ctrl_c(8)  # while motors are fitted

    assert motorprior(*line, out).code == 130
    assert saved.items() <= modified(out).items(), "finished searches are not repeated"

    ctrl_c(0)

    done = motorprior(*line, out)
    assert done.code == 0
    assert "continues the interrupted fit" in done.err
    assert (out / PRIOR_FILE).read_bytes() == (tmp_path / "whole" / PRIOR_FILE).read_bytes()
    assert not list(out.glob(CHECKPOINT.format("*")))
