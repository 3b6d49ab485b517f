"""Notebooks as pages: run them, and write their cells and outputs as Markdown."""

import base64
import html
import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

CELL_SECONDS = 300  # longest time of a cell [s]
# a progress line that later ones overwrite, and colours of a terminal
OVERWRITTEN = re.compile(r"^.*\r(?!\n)", re.MULTILINE)
# place and code line of a Python warning, which are those of the computer that builds the site
WARNING = re.compile(r"^\S+\.py:\d+: (\w*Warning: .*)\n +.*\n?", re.MULTILINE)
ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")


def run_notebook(path: Path, folder: Path) -> Any:
    """The notebook with its outputs; it runs in ``folder``, and stops at the first error."""
    shutil.rmtree(
        folder, ignore_errors=True
    )  # results of an earlier run would be taken as they are
    folder.mkdir(parents=True)
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=CELL_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return notebook


def missing_packages(path: Path) -> list[str]:
    """Packages that the metadata of a notebook lists under ``packages`` and that are not installed.

    They are the extras of the library that the notebook is about.
    """
    packages = nbformat.read(path, as_version=4).metadata.get("packages", [])
    return [name for name in packages if find_spec(name) is None]


def notebook_page(path: Path, page: Path, run: bool) -> str:
    """Markdown of a notebook; pictures are written next to ``page``.

    A notebook whose packages are not installed is shown without output, which the page states.
    """
    notebook = nbformat.read(path, as_version=4)
    missing = missing_packages(path)
    if run and not missing:
        notebook = run_notebook(path, page.parents[2] / "tutorial_runs" / path.stem)

    parts = []
    for number, cell in enumerate(notebook.cells):
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            if number == 0:
                parts.append(_origin(path, missing))
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for index, output in enumerate(_joined(cell.outputs)):
            name = f"{path.stem}_{number}_{index}.png"
            parts.append(_output(output, page.parent / name))
    return "\n\n".join(part for part in parts if part) + "\n"


def _origin(path: Path, missing: list[str]) -> str:
    text = f"*This page is the notebook* `tutorials/{path.name}`."
    if missing:
        text += f" *It is shown without output: {', '.join(missing)} is not installed here.*"
    return text


def _joined(outputs: list[Any]) -> list[Any]:
    """The outputs, with texts that follow each other as one: progress comes line by line."""
    joined: list[Any] = []
    for output in outputs:
        is_text = output.output_type == "stream"
        if is_text and joined and joined[-1].output_type == "stream":
            text = joined[-1].text + output.text
            joined[-1] = nbformat.v4.new_output("stream", text=text)
        else:
            joined.append(output)
    return joined


def _output(output: Any, picture: Path) -> str:
    """Markdown of one output of a cell."""
    if output.output_type == "stream":
        text = ESCAPES.sub("", OVERWRITTEN.sub("", output.text))
        text = WARNING.sub(r"\1\n", text)
        return f"```text\n{text.rstrip()}\n```" if text.strip() else ""

    data = output.get("data", {})
    if "image/png" in data:
        picture.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(base64.b64decode(data["image/png"]))
        caption = html.escape(output.get("metadata", {}).get("alt", "Picture of the cell above"))
        return f"![{caption}]({picture.name})"
    if "text/html" in data:
        # blank lines would end the block of HTML
        lines = [line for line in data["text/html"].splitlines() if line.strip()]
        return '<div class="output">\n' + "\n".join(lines) + "\n</div>"
    if "text/plain" in data:
        return f"```text\n{data['text/plain']}\n```"
    return ""
