"""Results in order; a failure or an interrupt ends the others at their next step, as an interrupt would."""

import os
import signal
from collections.abc import Callable
from functools import partial
from threading import Barrier, Event
from typing import Any

import pytest

from motorprior.exceptions import SimulationFault
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.side_by_side import side_by_side, threads_here


def patient(ended: list[str], began: Event | None = None, seconds: float = 0.1) -> Callable[[Progress], None]:
    """Work that goes on until it is interrupted, and then takes some seconds to keep what it has."""

    def work(progress: Progress) -> None:
        with progress.start("long", 1) as task:
            if began is not None:
                began.set()
            try:
                while True:
                    Event().wait(0.001)
                    task.advance()
            except KeyboardInterrupt:
                Event().wait(seconds)
                ended.append("kept")
                raise

    return work


class Notes:
    """A `Progress` that keeps its notes."""

    def __init__(self):
        self.start, self.texts = SILENT.start, []

    def note(self, text: str) -> None:
        self.texts.append(text)


def test_threads_beyond_the_machine_are_capped_and_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 5, 6}, raising=False)
    notes = Notes()
    assert [threads_here(workers, notes) for workers in (1, 3)] == [1, 3] and notes.texts == []
    assert threads_here(1000, notes) == 3
    assert notes.texts == ["note: 1000 workers are more than the 3 cores of this machine: 3 are used"]


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order(threads: int):
    works: list[Callable[[Progress], int]] = [lambda progress, n=n: n * n for n in range(5)]
    assert side_by_side(works, threads, SILENT) == [0, 1, 4, 9, 16]


def test_two_threads_work_at_the_same_time():
    meeting = Barrier(2, timeout=60.0)
    assert sorted(side_by_side([lambda progress: meeting.wait()] * 2, 2, SILENT)) == [0, 1]


def test_a_failure_interrupts_the_others_and_is_raised():
    ended: list[str] = []
    began = Event()

    def fail(progress: Progress) -> None:
        began.wait(60.0)
        raise SimulationFault("lost")

    with pytest.raises(SimulationFault, match="lost"):
        side_by_side([patient(ended, began), fail, *[patient(ended)] * 3], 2, SILENT)
    assert ended == ["kept"], "what runs keeps its state, what waits is not begun"


@pytest.mark.parametrize("threads", [2, 3])
def test_an_interrupt_reaches_every_thread(threads: int):
    ended: list[str] = []
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # ignored in what a shell starts in the background

    def interrupt() -> None:
        Event().wait(0.2)  # all threads are started by then, and waited for
        os.kill(os.getpid(), signal.SIGINT)

    meeting = Barrier(threads, action=interrupt, timeout=60.0)

    def work(progress: Progress, seconds: float) -> Any:
        with progress.start("first", 1):
            meeting.wait()
        return patient(ended, seconds=seconds)(progress)

    try:
        with pytest.raises(KeyboardInterrupt):
            side_by_side([partial(work, seconds=0.5 / (n + 1)) for n in range(threads)], threads, SILENT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended == ["kept"] * threads
