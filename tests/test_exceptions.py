"""Whatever a message is made of, it is one short line, and making it takes no time."""

import pytest

from motorprior.exceptions import LogError, cut, shown


@pytest.mark.parametrize("letter", ["x", "é", "\n", "\x1b", "\udc80", "x "])
def test_a_message_is_one_short_line_whatever_it_is_made_of(letter: str):
    long = 1_000_000 * letter
    text = str(LogError(long, where=long, remedy=long))
    assert len(text.encode()) <= 1000 and text.isprintable()


def test_the_end_of_a_long_path_is_kept():
    assert ": it is bad -> mend it" in str(LogError("it is bad", where=100 * "folder/" + "log.csv", remedy="mend it"))
    assert "log.csv: " in str(LogError("it is bad", where=100 * "folder/" + "log.csv"))


def test_a_short_message_stays_as_it_is():
    assert str(LogError("row 3 is é", where="a b/c  d.csv", remedy="x")) == "a b/c  d.csv: row 3 is é -> x"
    assert cut("a  b", 10) == "a b" and len(cut(100 * "é", 50).encode()) <= 50


def test_a_value_is_written_only_if_that_is_short():
    nested: object = 1
    for _ in range(200):
        nested = [nested, nested]
    assert shown(nested) == "list" and shown((nested,)) == "tuple"
    assert shown(10**5000) == "a whole number of 16610 bits"
    assert (shown(1.5), shown("a"), shown(None), shown(-3)) == ("1.5", "'a'", "None", "-3")
    assert len(shown(10**6 * "x").encode()) <= 40
