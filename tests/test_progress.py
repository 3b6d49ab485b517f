"""Lines of long work state the time that is left."""

from io import StringIO

import pytest

from motorprior import progress
from motorprior.progress import Lines, duration_text


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time [s] that `progress` reads; a test moves it."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def lines_of(clock: list[float], parts: list[int], total: int) -> list[str]:
    """Lines of a unit of work that finishes these parts, one entry every eleven seconds."""
    stream = StringIO()
    with Lines(stream).start("work", total) as task:
        for count in parts:
            clock[0] += 11.0
            task.advance(count)
    return stream.getvalue().splitlines()[1:-1]


def test_the_time_left_is_the_rest_at_the_speed_of_the_work(clock: list[float]):
    # 10 of 100 parts in 11 s: 70 parts are left after 33 s, which take 77 s
    assert lines_of(clock, [10, 10, 10], 100)[-1] == "  work: 30/100, about 2 min left"


def test_parts_that_an_interrupted_run_has_finished_do_not_count_as_fast(clock: list[float]):
    lines = lines_of(clock, [500, 1, 1], 600)

    assert lines[0] == "  work: 500/600"
    # 98 parts at 11 s each
    assert lines[-1] == "  work: 502/600, about 18 min left"


def test_work_that_stands_still_states_no_time(clock: list[float]):
    assert lines_of(clock, [5, 0, 0], 10)[-1] == "  work: 5/10"


@pytest.mark.parametrize(
    ("seconds", "text"), [(1.0, "10 s"), (41.0, "50 s"), (61.0, "2 min"), (5400.0, "1.5 h")]
)
def test_durations_are_rounded_up_to_what_a_person_plans_with(seconds: float, text: str):
    assert duration_text(seconds) == text
