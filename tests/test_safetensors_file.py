"""Our reader of safetensors agrees with the library, and any bytes are either read or refused."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import SafetensorError
from safetensors.numpy import load, save

from motorprior.safetensors_file import parse_safetensors

ARRAYS = {
    "weights": np.arange(6.0).reshape(2, 3),
    "float32": np.array([1e-30, np.pi], np.float32),
    "scalar": np.array(2.5),
    "count": np.array([7], np.int64),
    "flags": np.array([True, False]),
    "empty": np.zeros((0, 4)),
}
DATA = save(ARRAYS, metadata={"motorprior": '{"kind": "test"}'})


def test_what_the_library_writes_is_read():
    text, found = parse_safetensors(DATA)
    assert text == '{"kind": "test"}' and found.keys() == ARRAYS.keys()
    for name, value in ARRAYS.items():
        assert found[name].dtype == value.dtype and np.array_equal(found[name], value) and found[name].flags.writeable


@given(st.lists(st.tuples(st.integers(0, len(DATA) - 1), st.integers(0, 255)), min_size=1, max_size=4), st.booleans())
@settings(max_examples=500, deadline=None)
def test_damaged_bytes_are_read_as_the_library_does_or_refused(damage: list[tuple[int, int]], cut: bool):
    data = bytearray(DATA)
    for place, byte in damage:
        data[place] = byte
    damaged = bytes(data[: damage[0][0]] if cut else data)
    try:
        _, found = parse_safetensors(damaged)
    except ValueError:
        return
    expected = load(damaged)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value)


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_no_bytes_are_an_accident(data: bytes):
    with pytest.raises(ValueError):
        parse_safetensors(data)


@pytest.mark.parametrize(
    "header",
    [
        [],
        {"x": {"dtype": "F64", "shape": [2], "data_offsets": [0, 8]}},
        {"x": {"dtype": "F64", "shape": [1], "data_offsets": [8, 16]}},
        {name: {"dtype": "F64", "shape": [1], "data_offsets": [at, at + 8]} for name, at in (("x", 0), ("y", 4))},
        {"x": {"dtype": ["F64"], "shape": [2], "data_offsets": [0, 16]}},
        {"x": {"dtype": {}, "shape": [2], "data_offsets": [0, 16]}},
        {"x": {"dtype": "F128", "shape": [1], "data_offsets": [0, 16]}},
        {"x": {"dtype": "F64", "shape": [-1], "data_offsets": [0, 8]}},
        {"x": {"dtype": "F64", "shape": [True], "data_offsets": [0, 8]}},
        {"x": {"shape": [], "data_offsets": [0, 8]}},
        {"x": 3},
    ],
    ids=str,
)  # fmt: skip
def test_a_header_that_makes_no_sense_is_refused_as_by_the_library(header: object):
    text = json.dumps(header).encode()
    data = len(text).to_bytes(8, "little") + text + bytes(16)
    with pytest.raises(ValueError):
        parse_safetensors(data)
    with pytest.raises(SafetensorError):
        load(data)
