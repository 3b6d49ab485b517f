"""Numbers in plain containers come through; nothing else is even called."""

import os
import pickle
import struct
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.formats import pickle_machine, restricted_unpickler
from motorprior.logs.formats.restricted_unpickler import load_plain

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


class Calls:
    """Pickles as a call of ``function(*arguments)``."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_plain_containers_come_through(protocol):
    shared = [1.5, -2, 3_000_000_000_000_000_000_000]
    value = {"t": [0.1, 1e-300], "x": (True, None, "µ", b"\x00\xff", b""), "3": {"a": shared, "b": shared}}
    assert load_plain(pickle.dumps(value, protocol)) == value


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("dtype", ["f8", ">f8", "f4", "f2", "i8", "<i4", "u1", "?"])
def test_numeric_arrays_come_through(protocol, dtype):
    array = np.arange(12).reshape(3, 4).astype(dtype)
    for given in (array, np.asfortranarray(array), array[:, 1], array[1:1], np.array(3.0)):
        loaded = load_plain(pickle.dumps([given], protocol))[0]
        np.testing.assert_array_equal(loaded, given)
        assert loaded.dtype == given.dtype.newbyteorder("=")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_numpy_scalars_become_python_numbers(protocol):
    loaded = load_plain(pickle.dumps([np.float64(0.1), np.float32(0.5), np.int16(-3), np.bool_(True)], protocol))
    assert loaded == [0.1, 0.5, -3, True]
    assert [type(value) for value in loaded] == [float, float, int, bool]


def test_the_old_module_names_of_numpy_are_known():
    new = pickle.dumps(np.arange(3.0), 2)
    old = new.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    assert old != new
    np.testing.assert_array_equal(load_plain(old), np.arange(3.0))


def test_text_of_python_2_is_latin1():
    raw = struct.pack("<d", -1.25).decode("latin1").encode("latin1")
    state = b"(I1\n(I1\ntcnumpy\ndtype\n(S'f8'\nI0\nI1\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\n"
    python_2 = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR" + state
    python_2 += b"T" + struct.pack("<i", len(raw)) + raw + b"tb."
    np.testing.assert_array_equal(load_plain(python_2), [-1.25])


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("function", [os.system, eval, os.unlink, np.load, getattr, bytearray, list])
def test_a_call_is_refused_by_name_and_not_made(tmp_path: Path, protocol, function):
    victim = tmp_path / "victim"
    victim.touch()
    content = pickle.dumps({"t": Calls(function, f"rm '{victim}'", str(victim))}, protocol)
    with pytest.raises(LogError, match=rf"\b{function.__name__}, which is refused"):
        load_plain(content)
    assert victim.exists()


def test_the_file_is_named(tmp_path):
    path = tmp_path / "bad.txt"
    path.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(LogError, match=r"bad\.txt: the pickle asks for os\.system, which is refused -> "):
        load_plain(path)


@pytest.mark.parametrize("content", [b"(ios\nsystem\n.", b"(cos\nsystem\no.", b"Pid\n.", b"\x82\x01.", b"\x8f."])
def test_other_operations_are_refused(content):
    with pytest.raises(LogError, match=r"(operation \w+|asks for os\.system).* is refused"):
        load_plain(content)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(
    "value",
    [
        np.array([None, 1.0], dtype=object),
        np.array(["a"]),
        np.zeros(2, dtype=[("a", "f8")]),
        np.array([1j]),
        np.datetime64("2020-01-01"),
        OrderedDict(a=1),
        {1, 2},
        1j,
        slice(3),
        Path("x"),
        print,
    ],
)
def test_everything_else_is_refused(protocol, value):
    with pytest.raises(LogError, match="refused"):
        load_plain(pickle.dumps([value], protocol))


@pytest.mark.parametrize(
    "content",
    [
        b"cnumpy\ndtype\n}(S'x'\nI1\nub.",  # new attributes for an allowed name
        b"cnumpy\ndtype\n.",  # an allowed name as a value
        b"cnumpy\nndarray\n(I1000000000\ntR.",  # an array without content
        b"cbuiltins\nbytes\n(I1000000000000\ntR.",  # a terabyte of zeros
        b"c_codecs\nencode\n(Vx\nVzip\ntR.",
        b"cnumpy.core.multiarray\nscalar\n(cnumpy\ndtype\n(S'f8'\ntRVx\ntR.",  # one byte for eight
        b"cnumpy.core.multiarray\n_reconstruct\n(NNNtR.",
        b"]q\x00h\x00a.",  # a list that holds itself
        b"]" * 100 + b"a" * 99 + b".",
        pickle.dumps(1) + pickle.dumps(2),
    ],
)
def test_tricks_end_in_one_error(content):
    with pytest.raises(LogError):
        load_plain(content)


def test_a_short_pickle_cannot_unfold_without_bound(monkeypatch):
    monkeypatch.setattr(restricted_unpickler, "MAX_BYTES", 20_000)
    call = b"c_codecs\nencode\n(h\x00Vlatin1\ntR"
    text = b"V" + b"x" * 5000 + b"\nq\x00"
    assert len(load_plain(b"(" + text + 3 * call + b"t.")) == 4
    with pytest.raises(LogError, match="unfolds to more than 20000 bytes"):
        load_plain(b"(" + text + 5 * call + b"t.")


def test_size_and_operations_are_bounded(monkeypatch, tmp_path):
    path = tmp_path / "long.txt"
    path.write_bytes(pickle.dumps(list(range(1000))))
    monkeypatch.setattr(pickle_machine, "MAX_OPERATIONS", 500)
    with pytest.raises(LogError, match="more than 500 pickle operations"):
        load_plain(path)
    monkeypatch.setattr(restricted_unpickler, "MAX_BYTES", 100)
    with pytest.raises(LogError, match=r"long\.txt: \d+ bytes, more than the 100"):
        load_plain(path)


def test_containers_are_bounded(monkeypatch):
    monkeypatch.setattr(pickle_machine, "MAX_CONTAINERS", 10)
    assert len(load_plain(b"](" + 9 * b"]" + b"e.")) == 9
    for one in (b"]", b"}", b"(l", b"(d", b"(t", b"N\x85", b"NN\x86", b"NNN\x87"):
        with pytest.raises(LogError, match="more than 10 lists, dictionaries and tuples"):
            load_plain(b"](" + 10 * one + b"e.")


def test_of_a_dict_only_what_is_wanted_is_copied(monkeypatch):
    content = b"\x80\x02}(X\x01\x00\x00\x00t]X\x04\x00\x00\x00more" + 100 * b"]" + 99 * b"a" + b"u."
    assert load_plain(content, keys=["t"]) == {"t": []}
    with pytest.raises(LogError, match="nested deeper"):
        load_plain(content)
    monkeypatch.setattr(restricted_unpickler, "_plain", lambda *_: pytest.fail("it was copied"))
    for other, found in ((content, "'t', 'more'"), (b"](" + 9 * b"]" + b"e.", "list")):
        with pytest.raises(LogError, match=rf"expected a dict of \['t', 'x'\], found {found} -> "):
            load_plain(other, keys=["t", "x"])


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_truncation_is_refused(protocol):
    content = pickle.dumps({"t": [0.5, 1.5], "a": np.arange(3.0)}, protocol)
    for length in range(len(content)):
        with pytest.raises(LogError):
            load_plain(content[:length])
