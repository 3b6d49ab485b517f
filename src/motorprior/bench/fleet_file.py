"""A fleet as the TOML file that `fleet.load_fleet` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from motorprior.artifacts import write_text
from motorprior.bench.families import FAMILIES
from motorprior.bench.fleet import Fleet


def write_fleet(path: Path, fleet: Fleet, sources: Mapping[str, str], heading: str) -> None:
    """Write every parameter with its unit and source.

    Args:
        path: of the .toml file.
        fleet: what to write.
        sources: where the numbers come from, per parameter.
        heading: one line on top.

    Raises:
        ArtifactError: it cannot be written.
    """
    texts = {"name": fleet.name, "motor": fleet.motor, "robot": fleet.robot, "family": fleet.family}
    lines = [f"# {heading}", *(f"{key} = {_text(value)}" for key, value in texts.items())]
    for name, distribution in fleet.parameters.items():
        lines += ["", f"[{name}]", f"unit = {_text(FAMILIES[fleet.family].units[name])}"]
        lines += [f"distribution = {_text(distribution.kind)}"]
        lines += [f"{key} = {value!r}" for key, value in distribution.values.items()]
        lines += [f"source = {_text(sources[name])}"]
    write_text(path, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    """A JSON string without escapes beyond ASCII is a TOML basic string."""
    return json.dumps(value, ensure_ascii=False)
