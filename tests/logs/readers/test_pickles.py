"""Third-party pickles: numbers are exact, and no code runs."""

import os
import pickle
import time
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs import pickled_arrays as reader
from motorprior.logs.pickled_arrays import pickled_arrays
from motorprior.logs.pickles import load_pickle


@pytest.mark.parametrize("protocol", [0, 2, pickle.HIGHEST_PROTOCOL])
def test_plain_containers_and_arrays_are_loaded_exactly(protocol: int):
    value = {
        "t": [0.1, 1e-300, True, None, "µ", b"\xff"],
        "x": np.arange(6.0).reshape(2, 3),
        "y": np.float32(0.5),
    }
    loaded = load_pickle(pickle.dumps(value, protocol))

    assert loaded["t"] == value["t"]
    assert loaded["y"] == 0.5
    np.testing.assert_array_equal(loaded["x"], value["x"])


@pytest.mark.parametrize("function", [os.system, np.load])
def test_a_pickle_cannot_call_other_functions(tmp_path: Path, function):
    class Call:
        def __reduce__(self):
            return function, (str(victim),)

    victim = tmp_path / "victim"
    victim.touch()

    with pytest.raises(LogError, match=function.__name__):
        load_pickle(pickle.dumps({"t": Call()}))
    assert victim.exists()


@pytest.mark.parametrize(
    "pickled",
    [
        b"cbuiltins\nbytes\n(I1000000000000\ntR.",
        b"ctorch._utils\n_rebuild_tensor_v2\n(cnumpy.core.numeric\n_frombuffer\n(c_codecs\nencode\n(Vaaaaaaaa\nVlatin1\ntR"
        # one number a million times
        b"cnumpy\ndtype\n(Vf8\ntR(I1\ntVC\ntRI0\n(I1000000\nt(I0\nttR.",
    ],
)
def test_a_small_pickle_cannot_ask_for_much_memory(pickled: bytes):
    with pytest.raises(LogError):
        load_pickle(pickled)
    assert load_pickle(b"c_codecs\nencode\n(Vff\nVhex\ntR.") == b"ff", "no encoding that grows"


def test_a_truncated_pickle_is_refused():
    with pytest.raises(LogError, match="pickle"):
        load_pickle(pickle.dumps([1.0, 2.0])[:-3])


def test_raw_bytes_never_become_addresses_of_objects():
    class Forged:
        def __reduce__(self):
            dtype = np.dtype("O8")
            return (
                np.zeros(0).__reduce__()[0],
                (np.ndarray, (0,), b"b"),
                (1, (1,), dtype, False, 8 * b"A"),
            )

    with pytest.raises(LogError, match="'O8'"):
        load_pickle(pickle.dumps({"t": Forged()}))


def slow_hash() -> bytes:
    """A pickled table whose key takes 2**40 steps to hash."""
    key = ()
    for _ in range(40):
        key = (key, key)
    return b"\x80\x02}" + pickle.dumps(key, 2)[2:-1] + b"K\x01s."


@pytest.mark.parametrize(
    ("bomb", "problem"),
    [
        (slow_hash(), "3 s"),
        (b"\x80\x04" + 20_000_000 * b"]" + b".", "memory"),
    ],
)
def test_a_pickle_that_takes_much_time_or_memory_is_refused_soon(
    tmp_path: Path, bomb: bytes, problem: str
):
    path = tmp_path / "bomb.pkl"
    path.write_bytes(bomb)
    began = time.process_time()

    with pytest.raises(LogError, match=problem) as refusal:
        pickled_arrays(path)
    assert refusal.value.where == path
    assert refusal.value.remedy
    assert time.process_time() - began < 2.0, "the child process works, not this one"


def test_lists_without_numbers_are_no_arrays(tmp_path: Path):
    path = tmp_path / "lists.pkl"
    path.write_bytes(pickle.dumps([[] for _ in range(1000)]))
    assert pickled_arrays(path) == {}


def test_a_child_process_that_fails_is_reported_with_its_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "log.pkl"
    path.write_bytes(pickle.dumps({"t": np.arange(3.0)}))
    # a package of this name that cannot be imported
    broken = tmp_path / "src" / "motorprior" / "logs"
    broken.mkdir(parents=True)
    (broken.parent / "__init__.py").write_text("raise ImportError('no such library')")
    monkeypatch.setattr(reader, "__file__", str(broken / "pickled_arrays.py"))
    with pytest.raises(LogError, match=r"return code 1 .*no such library") as refusal:
        pickled_arrays(path)
    assert "more than" not in str(refusal.value)


def test_arrays_of_the_child_process_are_those_of_the_pickle(tmp_path: Path):
    rng = np.random.default_rng(0)
    big_endian = np.arange(4, dtype=">i4")
    content = {
        "run": [{"q": rng.random((3, 2))}, {"q": rng.random((3, 2))}],
        "x": np.asfortranarray(rng.random((4, 2))),
        "n": big_endian,
        "µ/..": [True, False],
        "text": "not read",
    }
    path = tmp_path / "log.pkl"
    path.write_bytes(pickle.dumps(content))
    arrays = pickled_arrays(path)

    assert set(arrays) == {"run.q", "x", "n", "µ/.."}
    np.testing.assert_array_equal(arrays["run.q"], [step["q"] for step in content["run"]])
    np.testing.assert_array_equal(arrays["x"], content["x"])
    assert arrays["n"].tolist() == big_endian.tolist()
    assert arrays["µ/.."].tolist() == [True, False]
