"""The motor posterior: Gaussians of the latents z of particular motors, as a file."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import ConstantFactors
from motorprior.actuator.constants import (
    NUM_SAMPLES,
    POSTERIOR,
    UNITS,
    Constants,
    Estimate,
    named_constants,
)
from motorprior.actuator.estimates import is_identified
from motorprior.actuator.gains import checked_gains
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.latent import NetworkActuator
from motorprior.actuator.motor_prior import MotorPrior, with_command_mode, with_model_error
from motorprior.artifacts import write_tensors
from motorprior.bounds import TEXT, generator_of, many, number, require_count, require_number
from motorprior.exceptions import ConfigError, listed
from motorprior.robots.robot import Robot
from motorprior.schema import Header, Tensor, check_tensors
from motorprior.texts import Overview, Printable

POSTERIOR_FILE = "posterior.safetensors"
_REMEDY = "write it with `motorprior adapt`"
# A log narrows a constant if posterior / prior standard deviation is below this ratio.
MAX_NARROWED_RATIO = 0.8
_HEADER = Header(
    "motor posterior",
    2,
    {
        "joint_names": many(TEXT, minimum=1),
        "prior_sha256": TEXT,
        "seconds": number(above=0.0),
        "surprise": many(number(0.0, 1.0), minimum=1),  # the field outlier_p_value
    },
    _REMEDY,
    POSTERIOR_FILE,
    "adapt",
)


@dataclass(frozen=True, repr=False)
class MotorPosterior(Printable):
    """Posterior of M motors, Z latents."""

    prior: MotorPrior
    mean: np.ndarray  # (M, Z)
    covariance: np.ndarray  # (M, Z, Z)
    joint_names: tuple[str, ...]  # M names in the log
    seconds: float  # length of the log
    # (M,) p-value of the outlier test against the training motors
    outlier_p_value: tuple[float, ...]
    gains: np.ndarray | None = None  # (2, M) logged kp and kd, None if the prior has none

    def sample(
        self,
        joints: int | Robot,
        seed: int | np.random.Generator,
        gains: np.ndarray | None = None,
        limit_follows_gain: bool = False,
        prior_share: float = 0.0,
        latent_spread: float = 1.0,
    ) -> GreyBoxActuator | NetworkActuator:
        """Sample motors, z ~ N(mean, latent_spread²·(covariance + prior_share²·I)).

        The posterior of several motors gives one sample of each. The posterior of a single motor
        gives any number of samples of this motor.

        Args:
            joints: number of motors, or the robot.
            seed: seed, or a generator to continue.
            gains: (2, count) kp and kd, ignored if the prior has none; the logged gains if not
                given.
            limit_follows_gain: scale the torque limit of every motor by the ratio of its kp to the
                kp of the prior's central motor. If the firmware controls the current, a smaller
                torque constant reduces both. Grey boxes only.
            prior_share: additional standard deviation of z, as a share of the prior's standard
                deviation, which is 1 [-].
            latent_spread: factor on the standard deviation of z [-]; 0 gives the mean motors.

        Raises:
            ConfigError: the posterior has several motors, but not ``joints`` motors; or an argument
                is out of range.
        """
        count = joints.num_joints if isinstance(joints, Robot) else joints
        require_count("count", count)
        if len(self.mean) not in (1, count):
            raise ConfigError(
                f"the posterior has {len(self.mean)} motors, the robot {count}",
                remedy=f"adapt to one motor, or to all {count} in the order of the robot",
            )
        require_number("prior_share", prior_share)
        require_number("latent_spread", latent_spread)
        num_latents = self.mean.shape[1]
        covariance = self.covariance + prior_share**2 * np.eye(num_latents)
        cholesky_factors = np.linalg.cholesky(covariance)
        noise = generator_of(seed).standard_normal((count, num_latents))
        deviation = np.einsum("mij,mj->mi", cholesky_factors, noise)
        z = self.mean + latent_spread * deviation

        are_gains_given = gains is not None
        if self.gains is None:
            gains = None
        elif gains is None:
            gains = checked_gains(np.broadcast_to(self.gains, (2, count)), count)
        else:
            gains = checked_gains(gains, count)
        motors = self.prior.model.motors(z, gains=gains)
        if not are_gains_given:
            motors = with_command_mode(motors)
        if not limit_follows_gain:
            return motors

        if not isinstance(motors, GreyBoxActuator):
            raise ConfigError(
                "the prior has no physical constants, so no torque limit",
                remedy="omit it, or identify with preset rollout",
                argument="limit_follows_gain",
            )
        classes = self.prior.joint_classes(self.joint_names)
        central, _ = self.prior.classes.mean_and_std(classes)
        one = np.ones(count)
        limit_factor = kp_ratio(motors.model, motors.z, central)
        return motors.with_factors(
            ConstantFactors(kp=one, kd=one, torque_limit=limit_factor, coulomb=one)
        )

    def constants(self) -> Constants:
        """Constants of these motors, from the log and the prior, and ranges of new motors.

        The estimates are medians and 90 % intervals of samples of the posterior, with an allowance
        for the error of the model, at the motors' gains. A constant is identified if the upper end
        of the interval is less than twice the lower end, and the log narrows it: for at least half
        of the motors, its standard deviation in the posterior is below 0.8 times its standard
        deviation in the prior. For positive constants it is the standard deviation of the
        logarithm.
        """
        mean, std, _ = self.prior.predicted(self.joint_names)
        prior_precision = np.eye(mean.shape[1]) / std[:, :, None] ** 2
        precision = with_model_error(np.linalg.inv(self.covariance), prior_precision)
        covariance = np.linalg.inv(precision)

        # NUM_SAMPLES samples of all motors of the posterior, and of the prior
        rng = np.random.default_rng(0)
        cholesky_factors = np.linalg.cholesky(covariance)
        noise = rng.standard_normal((NUM_SAMPLES, *self.mean.shape))
        z = self.mean + np.einsum("mij,dmj->dmi", cholesky_factors, noise)
        z_of_prior = mean + std * rng.standard_normal(z.shape)

        # one row per sample and motor
        gains_of_rows = None if self.gains is None else np.tile(self.gains, NUM_SAMPLES)
        rows = z.reshape(-1, z.shape[-1])
        values = named_constants(self.prior.model, rows, gains_of_rows)
        rows_of_prior = z_of_prior.reshape(-1, z.shape[-1])
        prior_values = named_constants(self.prior.model, rows_of_prior, gains_of_rows)

        identified = {}
        estimates = {}
        for name, samples in values.items():
            narrows = _narrows(samples, prior_values[name])
            if narrows is None:  # it does not vary, such as a logged gain
                continue
            of_motors = samples.reshape(NUM_SAMPLES, -1)
            low, median, high = np.median(np.quantile(of_motors, [0.05, 0.5, 0.95], axis=0), axis=1)
            is_narrow = bool(is_identified(name, np.array([[low], [high]]))[0])
            identified[name] = narrows and is_narrow
            estimates[name] = Estimate(float(median), float(low), float(high), identified[name])
        origin = "of the prior"
        return Constants.of(prior_values, UNITS, identified, estimates, origin, POSTERIOR)

    def overview(self) -> Overview:
        """For people: log, outliers and constants."""
        worst = int(np.argmin(self.outlier_p_value))
        smallest = f"{self.outlier_p_value[worst]:.3g} ({self.joint_names[worst]})"
        facts = {
            "log": f"{self.seconds:.3g} s",
            "prior": f"{self.prior.preset}, {self.prior.motor}",
            "joints": listed(self.joint_names, 8),
            "smallest p-value of the outlier test": smallest,
        }
        headline = f"motor posterior of {len(self.mean)} motors"
        constants = self.constants()
        if len(self.mean) == 1:
            return Overview(headline, facts, constants.columns, constants.cells)

        # a column per constant that the log narrows, at the posterior means
        narrowed = [row for row in constants if row.identifiable]
        values = named_constants(self.prior.model, self.mean, self.gains)
        columns = ("joint", *(f"{row.name} [{row.unit}]" for row in narrowed))
        rows = []
        for motor, name in enumerate(self.joint_names):
            rows.append([name, *(f"{values[row.name][motor]:.3g}" for row in narrowed)])
        return Overview(headline, facts, columns, rows)

    def take(self, index: list[int]) -> "MotorPosterior":
        """The motors at ``index``."""
        return replace(
            self,
            mean=self.mean[index],
            covariance=self.covariance[index],
            joint_names=tuple(self.joint_names[motor] for motor in index),
            outlier_p_value=tuple(self.outlier_p_value[motor] for motor in index),
            gains=None if self.gains is None else self.gains[:, index],
        )

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically, with the digest of the prior."""
        header = _HEADER.make(
            joint_names=list(self.joint_names),
            prior_sha256=self.prior.sha256(),
            seconds=self.seconds,
            surprise=list(self.outlier_p_value),
        )
        tensors = {"mean": self.mean, "covariance": self.covariance}
        if self.gains is not None:
            tensors["gains"] = self.gains
        write_tensors(Path(path), tensors, header)

    @classmethod
    def load(cls, path: str | Path, prior: MotorPrior) -> "MotorPosterior":
        """Read a posterior.

        Raises:
            ArtifactError: another kind or schema, unknown or missing keys, or wrong shapes.
            ConfigError: the posterior belongs to another prior.
        """
        path = Path(path)
        tensors, header = _HEADER.read(path)
        declared = {
            "mean": Tensor(("motors", "latents")),
            "covariance": Tensor(("motors", "latents", "latents")),
        }
        if prior.model.gain_unit:
            declared["gains"] = Tensor((2, "motors"))
        sizes = {"motors": len(header["joint_names"])}
        check_tensors(tensors, declared, path, _REMEDY, sizes)
        if header["prior_sha256"] != prior.sha256():
            remedy = "adapt this prior to the log again"
            raise ConfigError("posterior of another prior", where=path, remedy=remedy)
        return cls(
            prior=prior,
            mean=tensors["mean"],
            covariance=tensors["covariance"],
            joint_names=tuple(header["joint_names"]),
            seconds=header["seconds"],
            outlier_p_value=tuple(header["surprise"]),
            gains=tensors.get("gains"),
        )


def _narrows(posterior_values: np.ndarray, prior_values: np.ndarray) -> bool | None:
    """Whether a log narrows a constant; None if the constant does not vary, such as a logged gain.

    The arguments are NUM_SAMPLES samples of the constant of every motor.
    """
    if min(posterior_values.min(), prior_values.min()) > 0.0:
        posterior_values = np.log(posterior_values)
        prior_values = np.log(prior_values)
    posterior_std = posterior_values.reshape(NUM_SAMPLES, -1).std(axis=0)
    prior_std = prior_values.reshape(NUM_SAMPLES, -1).std(axis=0)
    varies = bool(np.median(prior_std) > 1e-9)
    if not varies:
        return None
    return bool(np.median(posterior_std - MAX_NARROWED_RATIO * prior_std) < 0.0)


def kp_ratio(model: GreyBox, z: np.ndarray, central: np.ndarray | float = 0.0) -> np.ndarray:
    """(M,) kp of grey-box motors with latents (M, Z), relative to central motors [-].

    ``central`` are the latents of the central motors of their classes.
    """
    kp = model.constants(z)["kp"]
    central_kp = model.constants(np.broadcast_to(central, z.shape))["kp"]
    return kp / central_kp
