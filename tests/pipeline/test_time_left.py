"""What is left of many works, from the time that those before took."""

from collections.abc import Callable

from motorprior.pipeline.time_left import TimeLeft


def clock(*times: float) -> Callable[[], float]:
    """Gives one of these times [s] after the other."""
    following = iter(times)
    return lambda: next(following)


def test_what_is_left_takes_the_mean_of_what_was_seen_on_so_many_threads():
    left = TimeLeft(5, 2, clock(0.0, 10.0, 100.0, 130.0, 160.0))
    first, second = left.begun(), left.begun()
    assert left.ended(first) == "about 3 min left"  # 4 of 100 s, two at a time
    assert left.ended(second) == "about 3 min left"  # 3 of 110 s: 165 s
    assert left.ended(100.0) == "about 2 min left"  # 2 of 93.3 s, both at once


def test_works_that_an_earlier_run_finished_say_nothing():
    left = TimeLeft(3, 1, clock(0.0, 0.2, 1.0, 41.0, 50.0, 70.0))
    assert left.ended(left.begun()) == ""
    assert left.ended(left.begun()) == "about 40 s left"
    assert left.ended(left.begun()) == "", "nothing is"
