"""Collect all pages of the site as plain Markdown in one folder, which the generator then builds.

The pages are README, docs/, the tutorials with their output, and a reference that is written from
the package itself: public names, commands and their help, constants of a motor. Links between files
of the repository become links between pages. Mathematics becomes MathML, which browsers draw
without a script.

    python website/assemble.py build/pages                 # runs the tutorials, minutes
    python website/assemble.py build/pages --no-outputs    # tutorials as they are stored
"""

import argparse
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from latex2mathml.converter import convert

import reference
from notebooks import notebook_page

ROOT = Path(__file__).resolve().parents[1]
# file of the repository -> its page; docs/ and tutorials/ follow by their names
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
}
LANGUAGES = {".py": "python", ".toml": "toml", ".ipynb": "json"}
FENCED = re.compile(r"^( *)(```+|~~~+)[^\n]*\n.*?^\1\2 *$\n?", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s]+)\)")
MATH_BLOCK = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE_MATH = re.compile(r"\$`([^`]+)`\$")
# comment in a page -> what the site shows in its place, written from the package
GENERATED = {"<!-- cards -->": reference.card_table}


def assemble(out: Path, outputs: bool = True) -> None:
    """Write all pages to ``out``, which is emptied first.

    Args:
        out: folder for the pages.
        outputs: whether the tutorials are run, so that the pages show what they print and draw.
    """
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(ROOT / "docs", out)
    shutil.copytree(ROOT / "website" / "assets", out / "assets")
    pages = pages_of_files()

    for source, page in pages.items():
        text = (ROOT / source).read_text("utf-8")
        if source.endswith(".ipynb"):
            text = notebook_page(ROOT / source, out / page, run=outputs)
        for comment, write in GENERATED.items():
            if comment in text:
                text = text.replace(comment, write())
        _write_page(out, source, page, text, pages)

    for page, text in reference.pages().items():
        # written as files of docs/, so links to these find them
        _write_page(out, f"docs/{page}", page, text, pages)


def pages_of_files() -> dict[str, str]:
    """Page of the site by file of the repository, both as relative paths with slashes."""
    pages = dict(PAGES)
    for path in sorted((ROOT / "docs").rglob("*.md")):
        pages[path.relative_to(ROOT).as_posix()] = path.relative_to(ROOT / "docs").as_posix()
    for path in sorted((ROOT / "tutorials").glob("*.ipynb")):
        pages[path.relative_to(ROOT).as_posix()] = f"tutorials/{path.stem}.md"
    return pages


def _write_page(out: Path, source: str, page: str, text: str, pages: dict[str, str]) -> None:
    linked_files: list[str] = []
    text = _outside_code(with_math(text), lambda part: _relinked(part, source, page, linked_files))
    path = out / page
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")

    for name in linked_files:
        _write_source_page(out, name, pages)


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """The text with all parts outside fenced blocks changed."""
    pieces = []
    end = 0
    for block in FENCED.finditer(text):
        pieces += [change(text[end : block.start()]), block[0]]
        end = block.end()
    return "".join([*pieces, change(text[end:])])


def _relinked(text: str, source: str, page: str, linked_files: list[str]) -> str:
    """The text of a page with links that lead to pages; appends linked files without a page.

    A link to a file that does not exist stays as it is, and the generator reports it.
    """
    pages = pages_of_files()

    def relink(match: re.Match) -> str:
        words, target = match.groups()
        path, hash_sign, anchor = target.partition("#")
        if not path or ":" in path:
            return match[0]

        name = os.path.normpath(PurePosixPath(source).parent / path)
        if name in pages:
            linked_page = pages[name]
        elif name.startswith("docs/"):  # pictures, and pages of the reference
            linked_page = name.removeprefix("docs/")
        elif (ROOT / name).exists():
            linked_files.append(name)
            linked_page = source_page(name)
        else:
            return match[0]

        relative = os.path.relpath(linked_page, PurePosixPath(page).parent)
        return f"{words}({relative}{hash_sign}{anchor})"

    return LINK.sub(relink, text)


def source_page(name: str) -> str:
    """Page that shows a file or a folder of the repository."""
    return f"files/{name.rstrip('/')}.md"


def _write_source_page(out: Path, name: str, pages: dict[str, str]) -> None:
    page = source_page(name)
    if (out / page).exists():
        return

    path = ROOT / name
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix in LANGUAGES)
        text = "\n".join(f"- [{file.name}]({path.name}/{file.name})" for file in files)
        source = str(PurePosixPath(name))
        _write_page(out, source, page, f"# {name}\n\n{text}\n", pages)
        return

    code = path.read_text("utf-8")
    text = f"# {path.name}\n\n`{name}`\n\n~~~{LANGUAGES.get(path.suffix, 'text')}\n{code}~~~\n"
    (out / page).parent.mkdir(parents=True, exist_ok=True)
    (out / page).write_text(text, "utf-8")


def with_math(text: str) -> str:
    r"""The text with ```math blocks and $`…`$ as MathML."""

    def block(match: re.Match) -> str:
        lines = [line for line in match[1].split("\n\n") if line.strip()]
        formulas = "\n".join(convert(" ".join(line.split()), display="block") for line in lines)
        return f'<div class="formula">\n{formulas}\n</div>'

    text = MATH_BLOCK.sub(block, text)
    # without the span, a formula at the start of a line is a block and ends the paragraph
    return INLINE_MATH.sub(lambda match: f"<span>{convert(match[1])}</span>", text)


def main() -> None:
    """Assemble the pages from the command line."""
    parser = argparse.ArgumentParser(description="Collect the pages of the site.")
    parser.add_argument("out", type=Path, help="folder for the pages")
    parser.add_argument("--no-outputs", action="store_true", help="do not run the tutorials")
    arguments = parser.parse_args()
    assemble(arguments.out, outputs=not arguments.no_outputs)


if __name__ == "__main__":
    main()
