"""A folder has one writer at a time, and a process that is killed leaves neither a lock nor half-written files."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from motorprior.artifacts import atomic_path, write_text
from motorprior.exceptions import ArtifactError, SimulationFault
from motorprior.pipeline.folder_lock import HOLDER, LOCK, taken
from motorprior.pipeline.stage import MARKER, is_finished, working

WANTED = {"stage": "walk", "config": {"seed": 0}}
AT_WORK = """
import sys, time
from pathlib import Path
from motorprior.artifacts import atomic_path
from motorprior.pipeline.stage import working
folder = Path(sys.argv[1])
with working(folder, {"stage": "walk", "config": {"seed": 1}}), atomic_path(folder / "policy.safetensors") as half:
    half.write_text("half")
    print("at work", flush=True)
    time.sleep(60)
"""


@contextmanager
def another_process(folder: Path) -> Iterator[subprocess.Popen]:
    """A process at work in the folder, with a file half written."""
    process = subprocess.Popen([sys.executable, "-c", AT_WORK, str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None and process.stdout.readline() == "at work\n"
        yield process
    finally:
        process.kill()
        process.wait()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_second_command_is_refused_while_the_first_runs_and_changes_nothing(tmp_path: Path):
    with another_process(tmp_path) as first:
        before = names(tmp_path)
        with pytest.raises(ArtifactError) as refused, working(tmp_path, WANTED):
            pytest.fail("both write")
        assert names(tmp_path) == before and LOCK in before and HOLDER in before
    said = refused.value.on_command_line()
    assert said.startswith(f"{tmp_path}: another command writes there: process {first.pid} on ")
    assert said.endswith(" -> wait until it ends, or choose another folder") and len(said) < 1000


def test_a_folder_inside_of_one_where_another_process_writes_is_refused(tmp_path: Path):
    with another_process(tmp_path / "run") as first:
        with pytest.raises(ArtifactError) as refused, taken(tmp_path / "run" / "walk" / "a"):
            pytest.fail("both write")
        assert not (tmp_path / "run" / "walk").exists()
        with taken(tmp_path / "beside"):
            pass
    said = refused.value.on_command_line()
    assert said.startswith(f"{tmp_path / 'run'}: another command writes there: process {first.pid} on ")
    with taken(tmp_path / "run" / "walk"):  # its lock ended with it
        pass


def test_threads_of_one_process_may_each_take_a_folder_inside_of_its_own(tmp_path: Path):
    def stage() -> None:
        with taken(tmp_path / "walk"):
            pass

    with taken(tmp_path), ThreadPoolExecutor(1) as threads:
        threads.submit(stage).result()


def test_a_killed_process_leaves_no_lock_and_its_half_written_files_go_with_the_next_run(tmp_path: Path):
    with another_process(tmp_path) as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
        assert len(names(tmp_path)) == 3, "lock, holder, half a policy"
        with working(tmp_path, WANTED):
            assert names(tmp_path) == [LOCK, HOLDER]
    assert names(tmp_path) == [MARKER] and is_finished(tmp_path, WANTED)


def test_a_killed_writer_of_one_file_leaves_it_until_that_file_is_written_again(tmp_path: Path):
    with another_process(tmp_path):
        pass
    assert len(names(tmp_path)) == 3
    write_text(tmp_path / "curve.json", "{}")
    assert len(names(tmp_path)) == 4, "it may be of use to who looks for the cause"
    write_text(tmp_path / "policy.safetensors", "whole")
    assert names(tmp_path) == [LOCK, HOLDER, "curve.json", "policy.safetensors"]


def test_files_that_a_living_process_is_writing_stay(tmp_path: Path):
    with atomic_path(tmp_path / "a") as first:
        first.write_text("1")
        with atomic_path(tmp_path / "a") as second:
            second.write_text("2")
        with working(tmp_path, WANTED):
            assert first.exists()
    assert (tmp_path / "a").read_text() == "1" and names(tmp_path) == ["a", MARKER]


@pytest.mark.parametrize("name", ["x" * 240, "ü" * 110, "a.b c\n[*]", "-rf"])
def test_odd_names_are_written_and_cleared(tmp_path: Path, name: str):
    with atomic_path(tmp_path / name) as half:
        half.write_text("half")
        kept = half.name
    left = tmp_path / kept.replace(f"-{os.getpid()}.tmp", "-999999999.tmp")
    left.touch()
    write_text(tmp_path / name, "whole")
    assert names(tmp_path) == [name]


def test_two_threads_of_one_process_cannot_share_a_folder(tmp_path: Path):
    found: list[BaseException] = []

    def second() -> None:
        try:
            with taken(tmp_path):
                pass
        except ArtifactError as error:
            found.append(error)

    with taken(tmp_path):
        thread = threading.Thread(target=second)
        thread.start()
        thread.join()
    assert len(found) == 1 and f"process {os.getpid()} " in str(found[0])
    second()
    assert len(found) == 1, "it is free again"


def test_folders_nest_and_a_thread_may_take_its_own_again(tmp_path: Path):
    run = tmp_path / "run"
    with taken(run):
        for stage in ("bench", "walk"):
            with taken(run / stage), working(run / stage, WANTED):
                pass
        with taken(run / ".." / "run"):
            assert (run / LOCK).exists()
        assert (run / LOCK).exists(), "the inner one does not end the outer one"
    assert names(run) == ["bench", "walk"] and names(run / "bench") == [MARKER]


def test_a_folder_made_for_nothing_goes_again(tmp_path: Path):
    with pytest.raises(SimulationFault), taken(tmp_path / "runs" / "walk"):
        raise SimulationFault("lost")
    assert names(tmp_path) == []


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(ArtifactError, match="choose another folder"), taken(tmp_path / "file" / "out"):
        pytest.fail("there is no folder")
