"""Values that are not as declared are refused with file, key, value and bound."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.bounds import BOOLEAN, TABLE, TEXT, exactly, integer, many, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema, Tensor, check_tensors

PATH = Path("mine.file")
REMEDY = "write it again"
FIELDS = {
    "share": number(0.0, 1.0),
    "gain": number(above=0.0, unit="N·m/rad"),
    "count": integer(1, 5),
    "name": TEXT,
    "on": BOOLEAN,
    "more": TABLE,
    "kind": one_of("this", "that"),
    "sign": exactly([1, 2]),
    "names": many(TEXT, minimum=1),
}
VALID: dict[str, Any] = {
    "share": 0.5,
    "gain": 2,
    "count": 3,
    "name": "a",
    "on": False,
    "more": {},
    "kind": "that",
    "sign": [1, 2],
    "names": ["x"],
}


def refusal(**changes: Any) -> str:
    """The problem that the error names when these values are not as declared."""
    with pytest.raises(ArtifactError) as error:
        Schema(FIELDS, REMEDY).check(VALID | changes, PATH)
    assert error.value.where == PATH
    assert error.value.remedy == REMEDY

    return error.value.problem


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("share", 1.5, "share = 1.5 is not a finite number from 0 to 1"),
        ("gain", 0.0, "gain = 0 is not a finite number above 0 N·m/rad"),
        ("count", 6, "count = 6 is not an integer from 1 to 5"),
        ("on", 1, "on = 1 is not true or false"),
        ("kind", "other", "kind = 'other' is not this or that"),
        ("sign", [1, 2, 3], "sign = [1, 2, 3] is not [1, 2]"),
        ("names", [], "names = [] is not a list of 1 or more, each a text"),
    ],
)
def test_a_value_that_is_not_as_declared_is_named_with_its_bound(
    key: str, value: object, words: str
):
    assert words in refusal(**{key: value})


def test_an_unknown_key_is_refused():
    assert "'colour'" in refusal(colour=1)


def test_a_list_in_place_of_a_table_is_refused():
    with pytest.raises(ArtifactError, match=r"mine.file\[recipe\]: content = \[\]"):
        Schema(FIELDS, REMEDY, name="recipe").check([], PATH)


DECLARED = {
    "mean": Tensor(("motors", "latents")),
    "std": Tensor(("latents",), above=0.0),
    "bias": Tensor(()),
}
ARRAYS = {"mean": np.zeros((5, 3)), "std": np.ones(3), "bias": np.array(0.0)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"std": np.ones(4)}, r"std .*float64\(4,\).*float64\(3,\)"),
        ({"bias": np.zeros((), np.float32)}, r"bias .*float32\(\).*float64\(\)"),
        ({"std": np.zeros(3)}, "std .*0.* above 0"),
        ({"extra": np.zeros(1)}, "'extra'"),
    ],
)
def test_a_tensor_that_is_not_the_declared_one_is_named(changes: dict[str, np.ndarray], words: str):
    with pytest.raises(ArtifactError, match=words) as error:
        check_tensors(ARRAYS | changes, DECLARED, PATH, REMEDY, {"motors": 5})
    assert error.value.where == PATH
    assert error.value.remedy == REMEDY
