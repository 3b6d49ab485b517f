"""What is known of particular motors: the posterior of z, as a file. One motor, or all of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_tensors
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.schema import TEXT, Header, Tensor, check_tensors, many, number

LARGEST = 1e3
"""Bound of a latent and of its variance: N(0, 1) has none beyond 10."""
_ANEW = "write it with `motorprior adapt`"
_HEADER = Header(
    "motor posterior",
    1,
    {
        "joint_names": many(TEXT, least=1),
        "prior_sha256": TEXT,
        "seconds": number(above=0.0),
        "surprise": many(number(0.0, 1.0), least=1),
    },
    _ANEW,
)
_TENSORS = {
    "mean": Tensor(("motors", "latents"), LARGEST),
    "covariance": Tensor(("motors", "latents", "latents"), LARGEST),
}


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
        header = _HEADER.write(
            joint_names=list(self.joint_names), prior_sha256=self.prior_sha256, seconds=self.seconds,
            surprise=list(self.surprise),
        )  # fmt: skip
        write_tensors(path, {"mean": self.mean, "covariance": self.covariance}, header)

    @classmethod
    def load(cls, path: Path) -> MotorPosterior:
        """Read a posterior.

        Raises:
            ArtifactError: another kind or schema, unknown or missing keys, or shapes that do not fit.
        """
        tensors, header = _HEADER.read(path)
        check_tensors(tensors, _TENSORS, path, _ANEW, {"motors": len(header["joint_names"])})
        covariance = tensors["covariance"]
        wrong = {
            "joint_names and surprise are not as many": len(header["surprise"]) != len(header["joint_names"]),
            "a covariance is not symmetric and positive definite": not _has_factor(covariance),
        }
        for problem, is_so in wrong.items():
            if is_so:
                raise ArtifactError(problem, where=path, remedy=_ANEW)
        names, surprise = tuple(header["joint_names"]), tuple(header["surprise"])
        return cls(tensors["mean"], covariance, names, header["prior_sha256"], header["seconds"], surprise)


def _has_factor(covariance: np.ndarray) -> bool:
    """Whether `MotorPosterior.sample` can draw from it: eigenvalues can be above 0 where rounding leaves no factor."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return np.allclose(covariance, covariance.transpose(0, 2, 1))
