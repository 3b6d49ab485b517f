"""Files are written completely or not at all, and invalid values are never read."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import atomic_path, read_json, read_tensors, write_json, write_tensors
from motorprior.exceptions import ArtifactError


@pytest.mark.parametrize("name", ["old", "new"])
def test_a_failure_while_writing_leaves_the_folder_as_it_was(tmp_path: Path, name: str):
    (tmp_path / "old").write_text("whole")

    with pytest.raises(ZeroDivisionError), atomic_path(tmp_path / name) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError

    assert list(tmp_path.iterdir()) == [tmp_path / "old"]
    assert (tmp_path / "old").read_text() == "whole"


def test_a_value_that_cannot_be_written_leaves_no_file(tmp_path: Path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "run.json", {"loss": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        write_tensors(tmp_path / "prior", {"x": np.zeros(2)}, {"loss": float("inf")})
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_a_new_folder_is_readable_by_all_users_and_the_only_one(tmp_path: Path):
    path = tmp_path / "deep" / "run" / "a.json"
    write_json(path, {"b": [1, 2.5], "a": "ü"})

    assert read_json(path) == {"a": "ü", "b": [1, 2.5]}
    assert list(path.parent.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644


TENSORS = {
    "matrix": np.arange(6.0).reshape(2, 3)[:, ::-1],  # not contiguous
    "float32": np.array([1e-30, np.pi], np.float32),
    "scalar": np.array(2.5),
    "count": np.array(7, np.int64),
    "empty": np.zeros((0, 4)),
}


def test_tensors_and_header_are_read_as_written_and_have_the_same_bytes_in_any_order(
    tmp_path: Path,
):
    header = {"kind": "prior", "taps": [0, 1], "nested": {"name": "ü"}}
    write_tensors(tmp_path / "a", TENSORS, header)
    write_tensors(tmp_path / "b", dict(reversed(TENSORS.items())), dict(reversed(header.items())))

    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()

    tensors, read_header = read_tensors(tmp_path / "a")

    assert read_header == header
    assert tensors.keys() == TENSORS.keys()
    for name, value in TENSORS.items():
        assert tensors[name].dtype == value.dtype
        np.testing.assert_array_equal(tensors[name], value)


def test_a_value_that_is_not_finite_is_refused_by_name_and_place(tmp_path: Path):
    weights = np.ones((2, 3))
    weights[1, 2] = -np.inf
    write_tensors(tmp_path / "prior", {"w1": weights}, {})

    with pytest.raises(ArtifactError, match=r"w1\[1, 2\]") as error:
        read_tensors(tmp_path / "prior")
    assert error.value.where == tmp_path / "prior"
