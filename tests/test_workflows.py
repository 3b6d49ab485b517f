"""Workflows name tests, targets of make and extras that exist."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_what_a_workflow_names_exists(path: Path):
    text = path.read_text("utf-8")
    makefile = (ROOT / "Makefile").read_text("utf-8")

    for test in re.findall(r"tests/[\w./]+(?:::\w+)?", text):
        name, _, function = test.partition("::")
        assert (ROOT / name).exists(), name
        assert not function or f"def {function}(" in (ROOT / name).read_text("utf-8"), test

    for target in re.findall(r"run: make (\S+)", text):
        assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), target

    for extra in re.findall(r"- extra: (\w+)", text):
        assert extra in PROJECT["optional-dependencies"]


def test_all_supported_versions_of_python_are_tested():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text("utf-8")
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))

    assert f"python: {versions}".replace("'", '"') in text
