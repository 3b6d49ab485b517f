"""``motorprior diff``: the differences between two priors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from motorprior.artifacts import write_json
from motorprior.bench.families import UNITS
from motorprior.cli.console import table
from motorprior.report.prior_difference import difference

_UNITS = UNITS | {"integral_rate": "1/s"}  # no true motor has one
DIFFERENT = 1
"""Exit code for priors that differ."""


@dataclass(frozen=True)
class Diff:
    """Compare two motor priors: header, constants, motors, weights.

    Exit code 0 if their contents are equal, 1 if they differ, 2 on bad input.
    """

    a: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="A")]
    """Prior that `motorprior identify` wrote."""
    b: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="B")]
    """The other prior."""
    json: Path | None = None
    """File for everything that is shown."""


def run_diff(config: Diff) -> None:
    """Print the differences.

    Raises:
        ArtifactError: a file that is no prior.
        SystemExit: code DIFFERENT if the contents differ.
    """
    found = difference(config.a, config.b)
    if config.json is not None:
        write_json(config.json, asdict(found) | {"equal": found.is_empty})
    print(f"A: {config.a}\nB: {config.b}")
    if found.is_empty:
        print("The two priors are equal in content.")
        return
    motors = {f"{name} [{_UNITS[key]}]" if (key := name.split()[-1]) in _UNITS else name: pair
              for name, pair in found.motors.items()}  # fmt: skip
    _show("Motors: constants of the central one (z = 0) and their spread", motors)
    _show("Header", found.header)
    table("Tensors", ["tensor", "largest difference or shapes"], [[*map(_text, row)] for row in found.tensors.items()])
    raise SystemExit(DIFFERENT)


def _show(title: str, pairs: dict[str, tuple[Any, Any]]) -> None:
    rows = [[key, _text(one), _text(other), _change(one, other)] for key, (one, other) in pairs.items()]
    table(title, ["", "A", "B", "change"], rows)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _change(one: Any, other: Any) -> str:
    """Change between two numbers, relative to the first."""
    numbers = [isinstance(value, int | float) and not isinstance(value, bool) for value in (one, other)]
    return f"{100 * (other - one) / abs(one):+.1f} %" if all(numbers) and one else ""
