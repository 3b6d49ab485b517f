"""What is known of particular motors: the posterior of z, as a file. One motor, or the twelve of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, require_keys, write_tensors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError, ConfigError

LARGEST = 1e3
"""Bound of a latent and of its variance: N(0, 1) has none beyond 10."""
SCHEMA_VERSION = 1
_HEADER = ("schema_version", "kind", "joint_names", "prior_sha256", "seconds", "surprise")


@dataclass(frozen=True)
class MotorPosterior:
    """Of M motors, Z latents.

    Attributes:
        prior: whose z this is; its file is kept beside this one's.
        mean: (M, Z).
        covariance: (M, Z, Z).
        joint_names: M names, those of the log.
        seconds: how much log was used.
        surprise: (M,) probability that a motor of the prior's fleet seems as odd (`motorprior adapt`).
    """

    prior: MotorPrior
    mean: np.ndarray
    covariance: np.ndarray
    joint_names: tuple[str, ...]
    seconds: float
    surprise: tuple[float, ...]

    def sample(self, count: int, seed: int | np.random.Generator) -> LatentActuator:
        """Draw ``count`` motors: of each joint its own, or, of a single motor, ``count`` times that one.

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.

        Raises:
            ConfigError: the posterior is of neither one motor nor ``count``, or ``seed`` is no seed.
        """
        require_count("count", count)
        if len(self.mean) not in (1, count):
            raise ConfigError(
                f"the posterior is of {len(self.mean)} motors, the robot has {count}",
                remedy=f"adapt to one motor, or to all {count} in the robot's order",
            )
        factors = np.linalg.cholesky(self.covariance)
        noise = generator_of(seed).standard_normal((count, self.mean.shape[1]))
        return LatentActuator(self.prior.network, self.mean + np.einsum("mij,mj->mi", factors, noise))

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically; it names the prior by digest and does not contain it.

        Raises:
            ArtifactError: it cannot be written there.
        """
        header = {
            "schema_version": SCHEMA_VERSION,
            "kind": "motor posterior",
            "joint_names": list(self.joint_names),
            "prior_sha256": self.prior.sha256(),
            "seconds": self.seconds,
            "surprise": list(self.surprise),
        }
        write_tensors(Path(path), {"mean": self.mean, "covariance": self.covariance}, header)

    @classmethod
    def load(cls, path: str | Path, prior: MotorPrior) -> MotorPosterior:
        """Read a posterior.

        Args:
            path: what `save` wrote.
            prior: whose posterior it is.

        Raises:
            ArtifactError: another kind or schema, unknown or missing keys, or shapes that do not fit.
            ConfigError: it is no posterior of this prior.
        """
        path = Path(path)
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
        if header["prior_sha256"] != prior.sha256():
            raise ConfigError("it is no posterior of this prior", where=path, remedy="adapt that prior to the log anew")
        posterior = cls(
            prior,
            tensors["mean"],
            tensors["covariance"],
            tuple(header["joint_names"]),
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
