"""What is known of particular motors: the posterior of z, as a file. One motor, or all of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, require_keys, write_tensors
from motorprior.exceptions import ArtifactError, ConfigError

LARGEST = 1e3
"""Bound of a latent and of its variance: N(0, 1) has none beyond 10."""
SCHEMA_VERSION = 1
_HEADER = ("schema_version", "kind", "joint_names", "prior_sha256", "seconds", "surprise")


@dataclass(frozen=True)
class MotorPosterior:
    """Of M motors, Z latents.

    Attributes:
        mean: (M, Z).
        covariance: (M, Z, Z).
        joint_names: M names, those of the log.
        prior_sha256: digest of the prior whose z this is.
        seconds: how much log was used.
        surprise: (M,) probability that a motor of the prior's fleet seems as odd (`motorprior adapt`).
    """

    mean: np.ndarray
    covariance: np.ndarray
    joint_names: tuple[str, ...]
    prior_sha256: str
    seconds: float
    surprise: tuple[float, ...]

    def sample(self, prior: MotorPrior, rng: np.random.Generator, count: int) -> LatentActuator:
        """``count`` motors: each joint its own, or, of a single motor, ``count`` draws of it.

        Raises:
            ConfigError: neither one motor nor ``count``.
        """
        if len(self.mean) not in (1, count):
            raise ConfigError(
                f"the posterior is of {len(self.mean)} motors, the robot has {count}",
                remedy=f"adapt to one motor, or to all {count} in the robot's order",
            )
        factors = np.linalg.cholesky(self.covariance)
        noise = rng.standard_normal((count, self.mean.shape[1]))
        return LatentActuator(prior.network, self.mean + np.einsum("mij,mj->mi", factors, noise))

    def save(self, path: Path) -> None:
        """Write one safetensors file, atomically."""
        header = {
            "schema_version": SCHEMA_VERSION,
            "kind": "motor posterior",
            "joint_names": list(self.joint_names),
            "prior_sha256": self.prior_sha256,
            "seconds": self.seconds,
            "surprise": list(self.surprise),
        }
        write_tensors(path, {"mean": self.mean, "covariance": self.covariance}, header)

    @classmethod
    def load(cls, path: Path) -> MotorPosterior:
        """Read a posterior.

        Raises:
            ArtifactError: another kind or schema, unknown or missing keys, or shapes that do not fit.
        """
        tensors, header = read_tensors(path)
        if header.get("kind") != "motor posterior" or header.get("schema_version") != SCHEMA_VERSION:
            raise ArtifactError(
                f"kind {header.get('kind')!r}, schema {header.get('schema_version')!r} is not a motor posterior of "
                f"schema {SCHEMA_VERSION}",
                where=path,
                remedy="write it with `motorprior adapt`",
            )
        require_keys(header, _HEADER, path)
        require_keys(tensors, ("mean", "covariance"), path)
        _check_types(header, tensors, path)
        posterior = cls(
            tensors["mean"],
            tensors["covariance"],
            tuple(header["joint_names"]),
            header["prior_sha256"],
            header["seconds"],
            tuple(header["surprise"]),
        )
        posterior._check(path)
        return posterior

    def _check(self, path: Path) -> None:
        names, (motors, latents) = self.joint_names, (*self.mean.shape, 0, 0)[:2]
        fits = self.mean.ndim == 2 and self.covariance.shape == (motors, latents, latents) and motors > 0
        if not fits or len(names) != motors or len(self.surprise) != motors:
            raise ArtifactError(
                f"mean {self.mean.shape}, covariance {self.covariance.shape} and {len(names)} joints do not fit",
                where=path,
                remedy="write it with `motorprior adapt`",
            )
        symmetric = np.allclose(self.covariance, self.covariance.transpose(0, 2, 1))
        if not symmetric or not _has_factor(self.covariance):
            raise ArtifactError(
                "a covariance is not symmetric and positive definite",
                where=path,
                remedy="write it with `motorprior adapt`",
            )


def _has_factor(covariance: np.ndarray) -> bool:
    """Whether `MotorPosterior.sample` can draw from it: eigenvalues can be above 0 where rounding leaves no factor."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return True


def _check_types(header: dict[str, Any], tensors: dict[str, np.ndarray], path: Path) -> None:
    """Every entry is of the kind that this code computes with, and no latent is beyond any sensible size."""
    names, surprise = header["joint_names"], header["surprise"]
    right = {
        "joint_names": isinstance(names, list) and all(isinstance(name, str) for name in names),
        "prior_sha256": isinstance(header["prior_sha256"], str),
        "seconds": type(header["seconds"]) in (int, float) and 0 < header["seconds"] < np.inf,
        "surprise": isinstance(surprise, list) and all(type(p) in (int, float) and 0 <= p <= 1 for p in surprise),
    }
    right |= {name: value.dtype == np.float64 and np.all(np.abs(value) < LARGEST) for name, value in tensors.items()}
    for name, is_right in right.items():
        if not is_right:
            raise ArtifactError(f"{name} makes no sense", where=path, remedy="write it with `motorprior adapt`")
