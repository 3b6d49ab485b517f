"""The tutorials run from a user's side, and are stored without output."""

from pathlib import Path

import nbformat
import pytest

from notebooks import missing_packages, notebook_page, run_notebook

TUTORIALS = sorted((Path(__file__).resolve().parents[1] / "tutorials").glob("*.ipynb"))


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_stored_without_output(path: Path):
    for cell in nbformat.read(path, as_version=4).cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_a_page_shows_a_warning_without_the_place_in_the_code(tmp_path: Path):
    text = "before\n/home/me/fit.py:24: UserWarning: a limit is unknown\n  report(note)\nafter\n"
    cell = nbformat.v4.new_code_cell("fit()")
    cell.outputs = [nbformat.v4.new_output("stream", name="stderr", text=text)]
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / "fit.ipynb")

    page = notebook_page(tmp_path / "fit.ipynb", tmp_path / "a" / "b" / "fit.md", run=False)

    assert "before\nUserWarning: a limit is unknown\nafter\n" in page


@pytest.mark.slow
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs(path: Path, tmp_path: Path):
    missing = missing_packages(path)
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    run_notebook(path, tmp_path / "run")


@pytest.mark.slow
def test_a_cell_that_fails_fails_the_tutorial(tmp_path: Path):
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")])
    nbformat.write(notebook, tmp_path / "bad.ipynb")
    with pytest.raises(Exception, match="ZeroDivisionError"):
        run_notebook(tmp_path / "bad.ipynb", tmp_path / "run")
