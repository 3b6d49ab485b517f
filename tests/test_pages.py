"""Every Python block of a page runs, after the blocks above it."""

import ast
import re
import shutil
from contextlib import chdir
from importlib.util import find_spec
from pathlib import Path

import pytest

from motorprior.actuator.motor_prior import card_file

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# README's library section trains for minutes; test_readme runs it in a small size
PAGES = sorted((ROOT / "docs").rglob("*.md"))
# packages that a page names and the tests do without; blocks that import them are compiled only
NOT_INSTALLED = {"isaaclab", "mjlab", "newton"}


def blocks(page: Path) -> list[str]:
    return BLOCK.findall(page.read_text("utf-8"))


def missing_packages(block: str) -> set[str]:
    """Packages of NOT_INSTALLED that a block imports and that are not installed here."""
    names = set()
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            # our own modules for other simulators, such as motorprior.exports.newton
            names |= {node.module.partition(".")[0], node.module.rpartition(".")[2]}
    return {name for name in names & NOT_INSTALLED if find_spec(name) is None}


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, id=page.relative_to(ROOT).as_posix()) for page in PAGES if blocks(page)],
)
def test_the_python_of_a_page_runs(page: Path, tmp_path: Path):
    # the prior that pages use as one that the reader has identified
    prior = tmp_path / "runs" / "prior" / "prior.safetensors"
    prior.parent.mkdir(parents=True)
    shipped = card_file("pupper_v2")
    assert shipped is not None
    shutil.copy(shipped, prior)

    names: dict = {}
    with chdir(tmp_path):
        for number, block in enumerate(blocks(page), 1):
            code = compile(block, f"{page.name}, block {number}", "exec")
            if not missing_packages(block):
                exec(code, names)

    for value in names.values():
        if hasattr(value, "close_extras"):  # environments in processes of their own
            value.close()


def test_a_block_that_does_not_run_is_found(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("```python\nimport motorprior as mp\n\nmp.missing\n```\n", "utf-8")
    with pytest.raises(AttributeError, match="missing"):
        exec(blocks(page)[0], {})
