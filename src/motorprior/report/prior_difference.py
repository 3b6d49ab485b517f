"""Differences between two motor priors: header, constants, motors, weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.geared_motor_constants import named_multiples
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import dotted, read_tensors

_FLEET_DRAWS = 256
"""Motors of N(0, I) whose constants give the spread of a prior's fleet."""


@dataclass(frozen=True)
class Difference:
    """Differences between two priors, A and B.

    Attributes:
        header: dotted key -> (value in A, value in B) of all entries that differ; None where one has no such entry.
        motors: figure -> (in A, in B): number of training motors and their mean |z|; of grey boxes also each constant
            of the central motor (z = 0), those of the terms of its servo's firmware too, and its spread in the fleet,
            as `spread of NAME`; multiples of stated gains have names of their own (`named_multiples`).
        tensors: name -> largest difference, or the two shapes where these differ; only those that differ.
    """

    header: dict[str, tuple[Any, Any]]
    motors: dict[str, tuple[Any, Any]]
    tensors: dict[str, Any]

    @property
    def is_empty(self) -> bool:
        """Whether the two files have the same content."""
        return not self.header and not self.tensors


def difference(a: Path, b: Path) -> Difference:
    """Read and compare two priors.

    Raises:
        ArtifactError: a file that is no prior.
    """
    figures = [_motor_figures(MotorPrior.load(path)) for path in (a, b)]
    (tensors, header), (other_tensors, other_header) = (read_tensors(path) for path in (a, b))
    pairs = _pairs(dotted(header), dotted(other_header))
    apart = {name: _apart(*pair) for name, pair in _pairs(tensors, other_tensors).items() if not np.array_equal(*pair)}
    return Difference({key: pair for key, pair in pairs.items() if pair[0] != pair[1]}, _pairs(*figures), apart)


def _pairs(one: dict[str, Any], other: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    return {key: (one.get(key), other.get(key)) for key in one | other}


def _apart(one: np.ndarray | None, other: np.ndarray | None) -> float | list[list[int] | None]:
    if one is None or other is None or one.shape != other.shape:
        return [None if array is None else list(array.shape) for array in (one, other)]
    return float(np.abs(one - other).max())


def _motor_figures(prior: MotorPrior) -> dict[str, float]:
    """|z| of N(0, I) is about √latents; a spread is half the distance from the 16th to the 84th percentile."""
    figures = {"training motors": float(len(prior.mean))}
    figures["mean |z|"] = float(np.linalg.norm(prior.mean, axis=1).mean())
    if prior.network.motor is None:
        return figures
    latents = prior.network.num_latents
    drawn = _constants(prior, np.random.default_rng(0).standard_normal((_FLEET_DRAWS, latents)))
    for name, central in _constants(prior, np.zeros((1, latents))).items():
        figures[name] = float(central[0])
        figures[f"spread of {name}"] = float(0.5 * np.ptp(np.percentile(drawn[name], [16, 84])))
    return figures


def _constants(prior: MotorPrior, z: np.ndarray) -> dict[str, np.ndarray]:
    values = prior.network.constants(z)
    return named_multiples(values) if prior.network.gain_unit else values
