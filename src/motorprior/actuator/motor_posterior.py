"""What is known of particular motors: the posterior of z, as a file. One motor, or all of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Factors
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior, are_gains, checked_gains
from motorprior.artifacts import write_tensors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.schema import TEXT, Header, Tensor, check_tensors, many, number

LARGEST = 1e3  # Bound of a latent and of its variance: N(0, 1) has none beyond 10
_REMEDY = "write it with `motorprior adapt`"
_HEADER = Header(
    "motor posterior",
    2,
    {
        "joint_names": many(TEXT, least=1),
        "prior_sha256": TEXT,
        "seconds": number(above=0.0),
        "surprise": many(number(0.0, 1.0), least=1),
    },
    _REMEDY,
    "posterior.safetensors",
    "adapt",
)
_TENSORS = {
    "mean": Tensor(("motors", "latents"), LARGEST),
    "covariance": Tensor(("motors", "latents", "latents"), LARGEST),
}


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
        gains: (2, M) stated kp and kd in the log, None if the prior knows of none.
    """

    prior: MotorPrior
    mean: np.ndarray
    covariance: np.ndarray
    joint_names: tuple[str, ...]
    seconds: float
    surprise: tuple[float, ...]
    gains: np.ndarray | None = None

    def sample(
        self,
        count: int,
        seed: int | np.random.Generator,
        gains: np.ndarray | None = None,
        limit_follows_gain: bool = False,
    ) -> LatentActuator:
        """Draw ``count`` motors: of each joint its own, or, of a single motor, ``count`` times that one.

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.
            gains: (2, count) stated kp and kd, ignored where none count; those of the log if not given.
            limit_follows_gain: the torque limit of every motor drawn is multiplied by its kp over that of the prior's
                central motor. So it is of motors that give less torque per ampere, whose gains and limit are currents.

        Raises:
            ConfigError: the posterior is of neither one motor nor ``count``, ``seed`` is no seed, or the limits of
                motors without constants are to follow.
        """
        require_count("count", count)
        if len(self.mean) not in (1, count):
            raise ConfigError(
                f"the posterior is of {len(self.mean)} motors, the robot has {count}",
                remedy=f"adapt to one motor, or to all {count} in the robot's order",
            )
        factors = np.linalg.cholesky(self.covariance)
        noise = generator_of(seed).standard_normal((count, self.mean.shape[1]))
        if self.gains is None:
            gains = None
        else:
            gains = checked_gains(np.broadcast_to(self.gains, (2, count)) if gains is None else gains, count)
        motors = LatentActuator(self.prior.network, self.mean + np.einsum("mij,mj->mi", factors, noise), gains=gains)
        return _limited_by_gain(motors) if limit_follows_gain else motors

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically; it names the prior by digest and does not contain it.

        Raises:
            ArtifactError: it cannot be written there.
        """
        header = _HEADER.write(
            joint_names=list(self.joint_names), prior_sha256=self.prior.sha256(), seconds=self.seconds,
            surprise=list(self.surprise),
        )  # fmt: skip
        tensors = {"mean": self.mean, "covariance": self.covariance}
        write_tensors(Path(path), tensors | ({} if self.gains is None else {"gains": self.gains}), header)

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
        tensors, header = _HEADER.read(path)
        wanted = _TENSORS | ({"gains": Tensor((2, "motors"), 1e6)} if prior.network.gain_unit else {})
        check_tensors(tensors, wanted, path, _REMEDY, {"motors": len(header["joint_names"])})
        covariance = tensors["covariance"]
        wrong = {
            "joint_names and surprise are not as many": len(header["surprise"]) != len(header["joint_names"]),
            "a covariance is not symmetric and positive definite": not _has_factor(covariance),
        }
        if "gains" in tensors:
            wrong["gains are not positive"] = not are_gains(tensors["gains"])
        for problem, is_so in wrong.items():
            if is_so:
                raise ArtifactError(problem, where=path, remedy=_REMEDY)
        if header["prior_sha256"] != prior.sha256():
            raise ConfigError(
                "it is no posterior of this prior", where=path, remedy="adapt that prior to the log again"
            )
        names, surprise = tuple(header["joint_names"]), tuple(header["surprise"])
        return cls(prior, tensors["mean"], covariance, names, header["seconds"], surprise, tensors.get("gains"))


def _limited_by_gain(motors: LatentActuator) -> LatentActuator:
    network = motors.network
    if network.motor is None:
        raise ConfigError(
            "the motors of this prior have no constants, so no limit can follow a gain",
            remedy="leave that out, or identify the prior with preset rollout", argument="limit_follows_gain",
        )  # fmt: skip
    return motors.with_factors(Factors.ones(motors.num_motors)._replace(torque_limit=kp_share(network, motors.z)))


def kp_share(network: LatentNetwork, z: np.ndarray) -> np.ndarray:
    """(M,) kp of motors (M, Z) over that of the central motor, of a network that decodes constants [-]."""
    central = network.constants(np.zeros((1, network.num_latents)))["kp"]
    return network.constants(z)["kp"] / central


def _has_factor(covariance: np.ndarray) -> bool:
    """Whether `MotorPosterior.sample` can draw from it: eigenvalues can be above 0 where rounding leaves no factor."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return np.allclose(covariance, covariance.transpose(0, 2, 1))
