"""Whatever bytes an artefact is made of, it is read as it was written or refused in words."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save

from motorprior.artifacts import read_tensors
from motorprior.exceptions import ArtifactError

ARRAYS = {
    "weights": np.arange(6.0).reshape(2, 3),
    "float32": np.array([1e-30, np.pi], np.float32),
    "scalar": np.array(2.5),
    "count": np.array([7], np.int64),
    "flags": np.array([True, False]),
    "empty": np.zeros((0, 4)),
}
DATA = save(ARRAYS, metadata={"motorprior": '{"kind": "test"}'})
F64 = {"dtype": "F64", "shape": [2], "data_offsets": [0, 16]}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged") / "x.safetensors"


def test_arrays_can_be_written_to(path: Path):
    path.write_bytes(DATA)
    assert all(value.flags.writeable for value in read_tensors(path)[0].values())


@given(st.lists(st.tuples(st.integers(0, len(DATA) - 1), st.integers(0, 255)), min_size=1, max_size=4), st.booleans())
@settings(max_examples=500, deadline=None)
def test_damaged_bytes_are_read_or_refused(path: Path, damage: list[tuple[int, int]], cut: bool):
    data = bytearray(DATA)
    for place, byte in damage:
        data[place] = byte
    path.write_bytes(bytes(data[: damage[0][0]] if cut else data))
    try:
        tensors, header = read_tensors(path)
    except ArtifactError as error:
        assert error.where == path and error.remedy and len(str(error).encode()) < 1024
    else:
        assert isinstance(header, dict) and all(np.all(np.isfinite(value)) for value in tensors.values())


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_no_bytes_are_an_accident(path: Path, data: bytes):
    path.write_bytes(data)
    with pytest.raises(ArtifactError):
        read_tensors(path)


HEADERS = [
    [],
    {"x": F64 | {"data_offsets": [0, 8]}},
    {"x": F64 | {"shape": [1], "data_offsets": [8, 16]}},
    {"x": F64 | {"shape": [1], "data_offsets": [0, 8]}},
    {name: F64 | {"shape": [1], "data_offsets": [at, at + 8]} for name, at in (("x", 0), ("y", 4))},
    *({"x": F64 | {"dtype": dtype}} for dtype in (["F64"], {}, "F128")),
    {"x": {"dtype": "BF16", "shape": [8], "data_offsets": [0, 16]}},
    {"x": {"dtype": "F8_E4M3", "shape": [16], "data_offsets": [0, 16]}},
    *({"x": F64 | {"shape": shape}} for shape in ([-2], [True], [2.0], [2**62, 4])),
    {"x": {"shape": [], "data_offsets": [0, 8]}},
    {"x": 3},
    {"x": F64, "__metadata__": [1]},
]


@pytest.mark.parametrize("header", HEADERS, ids=str)
def test_a_header_that_makes_no_sense_is_refused(path: Path, header: object):
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + bytes(16))
    with pytest.raises(ArtifactError, match=r"safetensors file|a tensor is of type"):
        read_tensors(path)


@pytest.mark.parametrize("size", [10**12, 99_000_000, 3])
def test_a_header_of_another_length_is_refused(path: Path, size: int):
    path.write_bytes(size.to_bytes(8, "little") + b"{}")
    with pytest.raises(ArtifactError, match="not a complete safetensors file"):
        read_tensors(path)


def test_a_header_nested_too_deeply_is_refused(path: Path):
    text = b'{"x":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    path.write_bytes(len(text).to_bytes(8, "little") + text)
    with pytest.raises(ArtifactError, match="not a complete safetensors file"):
        read_tensors(path)
