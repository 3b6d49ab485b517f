"""The posterior of z of particular motors, as a file: one motor, or all of a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Factors
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior, checked_gains
from motorprior.artifacts import write_tensors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ConfigError
from motorprior.schema import TEXT, Header, Tensor, check_tensors, many, number

_REMEDY = "write it with `motorprior adapt`"
_HEADER = Header(
    "motor posterior",
    2,
    {
        "joint_names": many(TEXT, minimum=1),
        "prior_sha256": TEXT,
        "seconds": number(above=0.0),
        "surprise": many(number(0.0, 1.0), minimum=1),
    },
    _REMEDY,
    "posterior.safetensors",
    "adapt",
)
_TENSORS = {
    "mean": Tensor(("motors", "latents")),
    "covariance": Tensor(("motors", "latents", "latents")),
}


@dataclass(frozen=True)
class MotorPosterior:
    """Of M motors, Z latents.

    Attributes:
        prior: whose z this is; its file is kept next to this one.
        mean: (M, Z).
        covariance: (M, Z, Z).
        joint_names: M names, those of the log.
        seconds: how much log was used.
        surprise: (M,) p-value of the outlier test against the training motors.
        gains: (2, M) kp and kd in the log, None if the prior has none.
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
            gains: (2, count) kp and kd, ignored where the prior has none; those of the log if not given.
            limit_follows_gain: multiply the torque limit of every motor by its kp over that of the prior's central
                motor, as for a motor with less torque per ampere, whose gains and limit are currents. Grey boxes only.

        Raises:
            ConfigError: the posterior is of neither one motor nor ``count``, or an argument is out of range.
        """
        require_count("count", count)
        if len(self.mean) not in (1, count):
            raise ConfigError(
                f"the posterior is of {len(self.mean)} motors, the robot has {count}",
                remedy=f"adapt to one motor, or to all {count} in the robot's order",
            )
        factors = np.linalg.cholesky(self.covariance)
        noise = generator_of(seed).standard_normal((count, self.mean.shape[1]))
        if self.gains is not None:
            gains = checked_gains(np.broadcast_to(self.gains, (2, count)) if gains is None else gains, count)
        z = self.mean + np.einsum("mij,mj->mi", factors, noise)
        motors = LatentActuator(self.prior.network, z, gains=None if self.gains is None else gains)
        if not limit_follows_gain:
            return motors
        if self.prior.network.motor is None:
            raise ConfigError(
                "the prior has no constants, so no torque limit",
                remedy="leave it out, or identify with preset rollout",
                argument="limit_follows_gain",
            )
        factors = Factors.ones(count)._replace(torque_limit=kp_share(self.prior.network, motors.z))
        return motors.with_factors(factors)

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically; it names the prior by digest and does not contain it."""
        header = _HEADER.write(
            joint_names=list(self.joint_names), prior_sha256=self.prior.sha256(), seconds=self.seconds,
            surprise=list(self.surprise),
        )  # fmt: skip
        tensors = {"mean": self.mean, "covariance": self.covariance}
        write_tensors(Path(path), tensors | ({} if self.gains is None else {"gains": self.gains}), header)

    @classmethod
    def load(cls, path: str | Path, prior: MotorPrior) -> MotorPosterior:
        """Read a posterior.

        Raises:
            ArtifactError: another kind or schema, unknown or missing keys, or shapes that do not fit.
            ConfigError: a posterior of another prior.
        """
        path = Path(path)
        tensors, header = _HEADER.read(path)
        wanted = _TENSORS | ({"gains": Tensor((2, "motors"))} if prior.network.gain_unit else {})
        check_tensors(tensors, wanted, path, _REMEDY, {"motors": len(header["joint_names"])})
        if header["prior_sha256"] != prior.sha256():
            raise ConfigError("posterior of another prior", where=path, remedy="adapt this prior to the log again")
        mean, covariance, gains = tensors["mean"], tensors["covariance"], tensors.get("gains")
        names, surprise = tuple(header["joint_names"]), tuple(header["surprise"])
        return cls(prior, mean, covariance, names, header["seconds"], surprise, gains)


def kp_share(network: LatentNetwork, z: np.ndarray) -> np.ndarray:
    """(M,) kp of motors (M, Z) over that of the central motor, of a network that decodes constants [-]."""
    central = network.constants(np.zeros((1, network.num_latents)))["kp"]
    return network.constants(z)["kp"] / central
