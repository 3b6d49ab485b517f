"""Artefacts are complete or absent, and nothing half-understood is ever read."""

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from motorprior.artifacts import atomic_path, dotted, read_json, read_tensors, require_keys, write_json, write_tensors
from motorprior.exceptions import ArtifactError


@pytest.mark.parametrize("already_there", [False, True])
def test_a_failure_while_writing_leaves_what_was_there(tmp_path: Path, already_there: bool):
    final = tmp_path / "prior.safetensors"
    if already_there:
        final.write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_path(final) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(final.name, "old")] * already_there


def test_a_value_that_cannot_be_written_leaves_nothing(tmp_path: Path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "run.json", {"loss": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        write_tensors(tmp_path / "prior", {"x": np.zeros(2)}, {"loss": float("inf")})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named_with_a_remedy(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    final = tmp_path / "file" / "run" / "prior"
    with pytest.raises(ArtifactError, match="another folder") as error:
        write_json(final, {})
    assert error.value.where == final
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_a_file_in_a_new_folder_is_readable_by_all_and_alone(tmp_path: Path):
    write_json(tmp_path / "deep" / "run" / "a.json", {"b": [1, 2.5], "a": "ü"})
    assert read_json(tmp_path / "deep" / "run" / "a.json") == {"a": "ü", "b": [1, 2.5]}
    assert [file.name for file in (tmp_path / "deep" / "run").iterdir()] == ["a.json"]
    assert (tmp_path / "deep" / "run" / "a.json").stat().st_mode & 0o777 == 0o644


TENSORS = {
    "matrix": np.arange(6.0).reshape(2, 3)[:, ::-1],  # not contiguous
    "float32": np.array([1e-30, np.pi], np.float32),
    "scalar": np.array(2.5),
    "count": np.array(7, np.int64),
    "empty": np.zeros((0, 4)),
}


@pytest.mark.parametrize("name", TENSORS)
def test_tensors_and_header_come_back_as_they_were(tmp_path: Path, name: str):
    header = {"kind": "prior", "taps": [0, 1], "nested": {"name": "ü"}}
    write_tensors(tmp_path / "prior", TENSORS, header)
    tensors, read_header = read_tensors(tmp_path / "prior")
    assert read_header == header and tensors.keys() == TENSORS.keys()
    assert (tensors[name].dtype, tensors[name].shape) == (TENSORS[name].dtype, TENSORS[name].shape)
    np.testing.assert_array_equal(tensors[name], TENSORS[name])


def test_same_tensors_same_bytes(tmp_path: Path):
    for name, tensors in (("a", TENSORS), ("b", dict(reversed(TENSORS.items())))):
        write_tensors(tmp_path / name, tensors, {"y": 1, "x": 2} if name == "a" else {"x": 2, "y": 1})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_by_name_and_place(tmp_path: Path, bad: float):
    weights = np.ones((2, 3))
    weights[1, 2] = bad
    write_tensors(tmp_path / "prior", {"w1": weights}, {})
    with pytest.raises(ArtifactError, match=r"w1\[1, 2\] is not finite") as error:
        read_tensors(tmp_path / "prior")
    assert error.value.where == tmp_path / "prior"


@pytest.mark.parametrize("bad", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_a_number_that_json_does_not_have_is_refused_in_every_header(tmp_path: Path, bad: str):
    text = f'{{"provenance": {{"minutes": [{bad}]}}}}'
    (tmp_path / "prior").write_bytes(save({"x": np.zeros(2)}, metadata={"motorprior": text}))
    with pytest.raises(ArtifactError, match=f"not JSON .{bad} is not a finite number") as error:
        read_tensors(tmp_path / "prior")
    assert error.value.where == tmp_path / "prior" and error.value.remedy
    outer = f'{{"x": {{"dtype": "F64", "shape": [1], "data_offsets": [0, 8], "scale": {bad}}}}}'.encode()
    (tmp_path / "outer").write_bytes(len(outer).to_bytes(8, "little") + outer + bytes(8))
    with pytest.raises(ArtifactError, match="not a complete safetensors file"):
        read_tensors(tmp_path / "outer")
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(ArtifactError, match=f"{bad} is not a finite number"):
        read_json(tmp_path / "run.json")


@pytest.mark.parametrize("kept", [0.0, 0.05, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path: Path, kept: float):
    write_tensors(tmp_path / "prior", {"x": np.zeros(100)}, {})
    whole = (tmp_path / "prior").read_bytes()
    (tmp_path / "prior").write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(ArtifactError, match="not a complete"):
        read_tensors(tmp_path / "prior")


@pytest.mark.parametrize("metadata", [None, {"format": "pt"}, {"motorprior": "{"}])
def test_a_file_somebody_else_wrote_is_refused(tmp_path: Path, metadata: dict[str, str] | None):
    (tmp_path / "model").write_bytes(save({"x": np.zeros(2)}, metadata=metadata))
    with pytest.raises(ArtifactError) as error:
        read_tensors(tmp_path / "model")
    assert error.value.where == tmp_path / "model"


def test_a_missing_file_is_named(tmp_path: Path):
    for read in (read_tensors, read_json):
        with pytest.raises(ArtifactError, match="nowhere"):
            read(tmp_path / "nowhere")


@pytest.mark.parametrize("content", [b"{", b"\xff\xfe", b"", json.dumps({"a": 1})[:-1].encode()])
def test_what_is_not_json_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"not (valid JSON|a text file)"):
        read_json(tmp_path / "run.json")


def test_a_table_of_tables_is_one_of_dotted_names():
    table = {"a": {"b": {"c": 1}, "d": [{"e": 2}], "f": {}}, "g": None}
    assert dotted(table) == {"a.b.c": 1, "a.d": [{"e": 2}], "a.f": {}, "g": None}


def test_keys_too_many_and_too_few_are_both_named():
    require_keys({"a": 1, "b": 2}, ("b", "a"), "header")
    with pytest.raises(ArtifactError, match=r"header: unknown keys \['c'\] and missing keys \['a'\]"):
        require_keys({"b", "c"}, {"a", "b"}, "header")
