"""``motorprior diff``: what is different between two priors, in words and numbers that say something."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_json
from motorprior.bench import fleet
from motorprior.cli.console import table

DIFFERENT = 1
"""Exit code."""
UNITS = {name: fleet.UNITS[name] for name in PARAMETERS}
_FLEET_DRAWS = 256
"""Motors of N(0, I) whose constants give the spread of a prior's fleet."""
_NOTHING = "-"
"""Shown where one of the two has no such entry."""


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


@dataclass(frozen=True)
class Difference:
    """What is not the same in two priors.

    Attributes:
        header: dotted key -> (value in A, value in B), of all keys that differ; None where one has no such key.
        constants: constant -> its median and spread in A and in B, [unit of UNITS]; empty unless both are grey boxes.
        motors: figure -> (value in A, value in B), of the training motors.
        tensors: tensor -> largest and RMS difference, or the two shapes where these differ; only those that differ.
    """

    header: dict[str, tuple[Any, Any]]
    constants: dict[str, dict[str, float]]
    motors: dict[str, tuple[float, float]]
    tensors: dict[str, dict[str, Any]]

    @property
    def is_empty(self) -> bool:
        """Whether the two files have the same content."""
        return not self.header and not self.tensors


def flattened(value: Any, key: str = "") -> dict[str, Any]:
    """Tables in tables as one table with dotted keys; lists are values."""
    if not isinstance(value, dict) or not value:
        return {key: value}
    return {
        name: leaf
        for entry, inner in value.items()
        for name, leaf in flattened(inner, f"{key}.{entry}" if key else str(entry)).items()
    }


def header_difference(a: dict[str, Any], b: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Entries of two headers that are not equal, by dotted key."""
    one, other = flattened(a), flattened(b)
    keys = [*one, *(key for key in other if key not in one)]
    return {key: (one.get(key), other.get(key)) for key in keys if one.get(key, ...) != other.get(key, ...)}


def tensor_difference(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> dict[str, dict[str, Any]]:
    """Largest and RMS difference of the tensors that are not equal, or their shapes where these differ."""
    found: dict[str, dict[str, Any]] = {}
    for name in sorted(a.keys() | b.keys()):
        shapes = [list(tensors[name].shape) if name in tensors else None for tensors in (a, b)]
        if shapes[0] != shapes[1]:
            found[name] = {"shape_a": shapes[0], "shape_b": shapes[1]}
        elif not np.array_equal(a[name], b[name]):
            apart = a[name] - b[name]
            found[name] = {"largest": float(np.abs(apart).max()), "rms": float(np.sqrt(np.mean(apart**2)))}
    return found


def fleet_constants(prior: MotorPrior) -> dict[str, tuple[float, float]]:
    """Constant of a grey box's central motor (z = 0) and half the distance from the 16th to the 84th percentile."""
    if prior.network.motor is None:
        return {}
    latents = prior.network.num_latents
    drawn = prior.network.constants(np.random.default_rng(0).standard_normal((_FLEET_DRAWS, latents)))
    central = prior.network.constants(np.zeros((1, latents)))
    low_high = {name: np.percentile(drawn[name], [16, 84]) for name in PARAMETERS}
    return {name: (float(central[name][0]), float(0.5 * np.ptp(low_high[name]))) for name in PARAMETERS}


def _constants_side_by_side(a: MotorPrior, b: MotorPrior) -> dict[str, dict[str, float]]:
    one, other = fleet_constants(a), fleet_constants(b)
    names = ("center_a", "spread_a", "center_b", "spread_b")
    return {name: dict(zip(names, (*one[name], *other[name]), strict=True)) for name in one if name in other}


def _motor_figures(prior: MotorPrior) -> dict[str, float]:
    """How many training motors, and how far their means are from the center; |z| of N(0, I) is about √latents."""
    length = np.linalg.norm(prior.mean, axis=1)
    return {"training motors": float(len(length)), "mean |z|": float(length.mean())}


def compare(a: Path, b: Path) -> Difference:
    """Read and compare two priors.

    Raises:
        ArtifactError: a file that is no prior.
    """
    priors, contents = [MotorPrior.load(path) for path in (a, b)], [read_tensors(path) for path in (a, b)]
    one, other = (_motor_figures(prior) for prior in priors)
    return Difference(
        header_difference(contents[0][1], contents[1][1]),
        _constants_side_by_side(*priors),
        {name: (one[name], other[name]) for name in one},
        tensor_difference(contents[0][0], contents[1][0]),
    )


def run_diff(config: Diff) -> None:
    """Print the differences.

    Raises:
        ArtifactError: a file that is no prior.
        SystemExit: code DIFFERENT if the contents differ.
    """
    found = compare(config.a, config.b)
    _show(found, str(config.a), str(config.b))
    if config.json is not None:
        write_json(config.json, vars(found) | {"equal": found.is_empty})
    if not found.is_empty:
        raise SystemExit(DIFFERENT)


def _show(found: Difference, a: str, b: str) -> None:
    sides = ["A", "B"]
    print(f"A: {a}\nB: {b}")
    if found.is_empty:
        print("The two priors are equal in content.")
        return
    if found.header:
        rows = [[key, _text(one), _text(other), _change(one, other)] for key, (one, other) in found.header.items()]
        table("Header", ["key", *sides, "change"], rows)
    if found.constants:
        rows = [[f"{name} [{UNITS[name]}]", *_beside(entry)] for name, entry in found.constants.items()]
        table("Central motor (z = 0) ± spread of the fleet", ["constant", *sides, "change"], rows)
    rows = [[name, *map(_text, pair), _change(*pair)] for name, pair in found.motors.items()]
    table("Training motors", ["figure", *sides, "change"], rows)
    if found.tensors:
        table("Tensors", ["tensor", "largest difference", "RMS difference"], _tensor_rows(found.tensors))


def _beside(entry: dict[str, float]) -> list[str]:
    one, other = entry["center_a"], entry["center_b"]
    return [f"{one:.4g} ± {entry['spread_a']:.2g}", f"{other:.4g} ± {entry['spread_b']:.2g}", _change(one, other)]


def _tensor_rows(tensors: dict[str, dict[str, Any]]) -> list[list[str]]:
    rows = []
    for name, entry in tensors.items():
        if "largest" in entry:
            rows.append([name, f"{entry['largest']:.3g}", f"{entry['rms']:.3g}"])
        else:
            rows.append([name, f"shapes {_text(entry['shape_a'])} and {_text(entry['shape_b'])}", _NOTHING])
    return rows


def _text(value: Any) -> str:
    if value is None:
        return _NOTHING
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _change(one: Any, other: Any) -> str:
    """Of two numbers, relative to the first."""
    numbers = [isinstance(value, int | float) and not isinstance(value, bool) for value in (one, other)]
    if not all(numbers) or one == 0:
        return ""
    return f"{100 * (other - one) / abs(one):+.1f} %"
