"""What a module imports, at its top or later, and what these import in turn; read from the source, nothing is run.

A module that imports importlib.resources reads data files of its folder: these count with it.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from threading import Lock

RESOURCES, DATA = "importlib.resources", "*.toml"
_PARSING = Lock()  # stages run in threads, and ast.parse of Python 3.11 fails in two at a time (CPython issue 106905)


def imported(tree: ast.AST, package: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Line and absolute dotted name of everything imported at any depth, and of what ``python -m`` is told to run.

    Args:
        tree: of a module.
        package: names of the packages that it is in, the outermost first; relative imports start there.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*start, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and _last_name(node.func) in ("import_module", "__import__"):
            yield from ((node.lineno, str(arg.value)) for arg in node.args[:1] if isinstance(arg, ast.Constant))
        elif isinstance(node, ast.List | ast.Tuple):
            words = [str(each.value) if isinstance(each, ast.Constant) else "" for each in node.elts]
            yield from ((node.lineno, module) for flag, module in pairwise(words) if flag == "-m" and module)


def _last_name(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def sources(file: Path, package: Path, left_out: Collection[str] = ()) -> dict[str, bytes]:
    """Name -> text of a file and of all modules that it needs: of the package, and of the folder of a file outside.

    Among them are the .toml files in and below the folder of a module of the package that reads resources.

    Args:
        file: of a module of the package, or of a script that imports some.
        package: folder; the public names in its own __init__.py count where some of them are imported.
        left_out: dotted names of modules, of packages with all that is in them, and of names in modules. They are
            not looked into: what they alone import is left out as well.
    """
    found: dict[str, bytes] = {}
    waiting, public, looked_up = [file], package / "__init__.py", set[str]()
    while waiting:
        path = waiting.pop()
        inside = path.is_relative_to(package)
        inner = path.relative_to(package.parent if inside else file.parent)
        if inner.as_posix() in found:
            continue
        found[inner.as_posix()] = text = path.read_bytes()
        names = _names(text, inner.parent.parts)
        if inside and any(name.startswith(RESOURCES) for name in names):
            data = path.parent.rglob(DATA)
            found |= {each.relative_to(package.parent).as_posix(): each.read_bytes() for each in data}
        for name in names - looked_up:
            ours = name.split(".")[0] == package.name
            if ours or not inside:
                looked_up.add(name)
                needed = _files(name.split("."), package.parent if ours else file.parent, left_out)
                waiting += needed if needed == [public] else [each for each in needed if each != public]
    return found


@cache
def _names(text: bytes, package: tuple[str, ...]) -> frozenset[str]:
    with _PARSING:
        tree = ast.parse(text)
    return frozenset(name for _, name in imported(tree, package))


def _files(name: Sequence[str], root: Path, left_out: Collection[str]) -> list[Path]:
    """Of a module, or the module of a name in it, and of the packages around it; none if it is left out."""
    found: list[Path] = []
    for depth in range(1, len(name) + 1):
        if ".".join(name[:depth]) in left_out:
            return []
        stem = root.joinpath(*name[:depth])
        found += [path for path in (stem / "__init__.py", stem.with_suffix(".py")) if path.is_file()]
    return found
