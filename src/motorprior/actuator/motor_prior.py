"""The motor prior: a distribution of motors as a file. z ~ N(0, I) gives a motor, μ_i gives training motor i."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.prior_bounds import LARGEST_SLOPE, check_central_motor, check_metrics
from motorprior.actuator.servo_terms import TERMS, in_order
from motorprior.artifacts import tensors_as_bytes, write_tensors
from motorprior.bounds import generator_of, require_count, require_number
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.logs.motor_log import GAIN_UNITS
from motorprior.schema import TABLE, TEXT, TRUTH, Field, Header, Tensor, check_tensors, exactly, many, number, one_of

UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N·m", "armature": "kg·m²", "time": "s"}
SIGN = "error = position_target - joint_pos; a positive torque accelerates the joint upwards"
INPUT_ORDER = "errors of all taps, then velocities of all taps; tap k is k periods old"
_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")
_REMEDY = "identify it again with this version"
_OLDEST_TAP = 10_000  # Periods; every motor keeps so much history


def _are_taps(taps: object) -> bool:
    """Whether this is what a history can be made of."""
    if not isinstance(taps, list) or any(type(tap) is not int for tap in taps):
        return False
    return bool(taps) and taps[0] == 0 and taps[-1] <= _OLDEST_TAP and sorted(set(taps)) == taps


_HEADER = Header(
    "motor prior",
    5,
    {
        "units": exactly(UNITS),
        "sign": exactly(SIGN),
        "input_order": exactly(INPUT_ORDER),
        "motor_parameters": many(TEXT),
        "motor_terms": many(one_of(*TERMS)),
        **dict.fromkeys(("period", *_SCALES), number(1e-9, 1e9)),
        "taps": Field(f"integers that ascend from 0 to {_OLDEST_TAP} at most", _are_taps),
        **dict.fromkeys(("has_armature", "grey_box", "standardised"), TRUTH),
        **dict.fromkeys(("preset", "robot", "motor"), TEXT),
        "joint_names": many(TEXT),
        "gain_unit": one_of("", *GAIN_UNITS),
        **dict.fromkeys(("provenance", "metrics"), TABLE),
    },
    _REMEDY,
    "prior.safetensors",
    "identify",
)
SCHEMA_VERSION = _HEADER.version
_LARGEST, _LARGEST_LOGARITHM = 1e4, 30.0  # Of a weight, and of what is exponentiated
_LARGEST_CENTER = 600.0  # Of what `check_central_motor` can exponentiate; it knows the bounds of every constant
_WEIGHTS = {
    "b1": Tensor(("neurons",), _LARGEST),
    "w1": Tensor(("inputs", "neurons"), _LARGEST),
    "v1": Tensor(("latents", "neurons"), _LARGEST),
    "w2": Tensor(("neurons", "neurons"), _LARGEST),
    "b2": Tensor(("neurons",), _LARGEST),
    "w3": Tensor(("neurons",), _LARGEST),
    "b3": Tensor((), _LARGEST),
    "log_armature": Tensor((), _LARGEST_LOGARITHM),
    "armature_slope": Tensor(("latents",), LARGEST_SLOPE),
}
_MOTORS = {
    "mean": Tensor(("motors", "latents"), _LARGEST),
    "log_var": Tensor(("motors", "latents"), _LARGEST_LOGARITHM),
}
_GAINS = {"gains": Tensor((2, "motors"), 1e6)}
_GREY_BOX = {
    "motor_center": Tensor(("constants",), _LARGEST_CENTER),
    "motor_slope": Tensor(("latents", "constants"), LARGEST_SLOPE),
}
_COPULA = {
    "mixing": Tensor(("latents", "latents"), _LARGEST),
    "quantiles": Tensor((len(SCORES), "latents"), _LARGEST),
}


@dataclass(frozen=True)
class MotorPrior:
    """A learned distribution of motors.

    Attributes:
        network: the shared network.
        mean: (M, Z) posterior means of the training motors.
        log_var: (M, Z) their log-variances.
        preset: name of the recipe.
        robot: robot whose motors these are.
        motor: motor model.
        provenance: where the logs come from: the bench's fleet with the distributions of its gains and constants, or
            the log's source; recipe and seed.
        metrics: figures of the training.
        joint_names: of the training motors, if they drove the joints of a robot; none of a bench.
        gains: (2, M) stated kp and kd of the training motors, None if the network's ``gain_unit`` is "".
    """

    network: LatentNetwork
    mean: np.ndarray
    log_var: np.ndarray
    preset: str
    robot: str
    motor: str
    provenance: dict[str, Any]
    metrics: dict[str, float]
    joint_names: tuple[str, ...] = ()
    gains: np.ndarray | None = None

    def sample(
        self, count: int, seed: int | np.random.Generator, gains: np.ndarray | None = None, spread: float = 1.0
    ) -> LatentActuator:
        """Draw ``count`` new motors, z ~ N(0, spread²·I).

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.
            gains: (2, count) stated kp and kd, ignored where none count. If not given, those of the training motors: of
                as many, each one's in its place, otherwise their medians.
            spread: 0 for the mean motor alone, more than 1 for more different motors than there are [-].

        Raises:
            ConfigError: ``count`` is no positive whole number, ``seed`` no seed, ``spread`` negative or not finite, or
                ``gains`` are not so many positive numbers.
        """
        require_count("count", count)
        require_number("spread", spread)
        z = spread * generator_of(seed).standard_normal((count, self.network.num_latents))
        return LatentActuator(self.network, z, gains=self._told(count, gains))

    def _told(self, count: int, gains: np.ndarray | None) -> np.ndarray | None:
        """(2, count) gains, or None where none count."""
        if self.gains is None:
            return None
        if gains is None:
            same = self.gains.shape[1] == count
            return self.gains if same else np.tile(np.median(self.gains, axis=1)[:, None], count)
        return checked_gains(gains, count)

    def training_motors(self, index: np.ndarray) -> LatentActuator:
        """The training motors at ``index``, at their posterior means."""
        return LatentActuator(
            self.network, self.mean[index], gains=None if self.gains is None else self.gains[:, index]
        )

    def expected(self, joint_names: tuple[str, ...]) -> np.ndarray:
        """(J, Z) latents expected at these joints: the training motor's of the same name, 0 where there is none."""
        rows = dict(zip(self.joint_names, self.mean, strict=False))
        nothing = np.zeros(self.network.num_latents)
        return np.stack([rows.get(name, nothing) for name in joint_names])

    def has_names(self, joint_names: tuple[str, ...]) -> np.ndarray:
        """(J,) whether a training motor drove the joint of that name."""
        return np.isin(joint_names, self.joint_names)

    def require(self, robot: str, physics_dt: float) -> None:
        """Refuse a use the prior was not made for.

        Raises:
            ConfigError: another robot, or a physics step that does not divide its period.
        """
        if self.robot != robot:
            raise ConfigError(
                f"the prior is of robot {self.robot!r}, not {robot!r}", remedy=f"identify one from logs of {robot}"
            )
        self.training_motors(np.array([0])).arrays(physics_dt)

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically.

        Raises:
            ArtifactError: it cannot be written there.
        """
        write_tensors(Path(path), *self._contents())

    def sha256(self) -> str:
        """Digest of the file that `save` writes; posteriors name their prior by it."""
        return hashlib.sha256(tensors_as_bytes(*self._contents())).hexdigest()

    def _contents(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        net = self.network
        tensors = {name: np.asarray(getattr(net, name), np.float64) for name in _WEIGHTS}
        if net.motor is not None:
            tensors |= {"motor_center": net.motor.center, "motor_slope": net.motor.slope}
        if net.copula is not None:
            tensors |= {"mixing": net.copula.mixing, "quantiles": net.copula.quantiles}
        terms = () if net.motor is None else net.motor.terms
        header = _HEADER.write(
            units=UNITS, sign=SIGN, input_order=INPUT_ORDER, motor_parameters=list(parameters_of(terms)),
            motor_terms=list(terms),
            taps=list(net.taps), period=net.period, has_armature=net.has_armature, grey_box=net.motor is not None,
            standardised=net.copula is not None, **{name: getattr(net, name) for name in _SCALES},
            preset=self.preset, robot=self.robot, motor=self.motor, provenance=self.provenance, metrics=self.metrics,
            joint_names=list(self.joint_names), gain_unit=net.gain_unit,
        )  # fmt: skip
        if self.gains is not None:
            tensors["gains"] = self.gains
        return {**tensors, "mean": self.mean, "log_var": self.log_var}, header

    @classmethod
    def load(cls, path: str | Path) -> MotorPrior:
        """Read a prior.

        Raises:
            ArtifactError: not a motor prior, another schema, unknown or missing keys, shapes that do not fit,
                or weights beyond any sensible size.
        """
        path = Path(path)
        tensors, header = _HEADER.read(path)
        _check(tensors, header, path)
        numbers: dict[str, Any] = {name: float(header[name]) for name in ("period", *_SCALES)}
        arrays: dict[str, Any] = {name: tensors[name] for name in _WEIGHTS}
        terms = tuple(header["motor_terms"])
        motor = GearedMotor(tensors["motor_center"], tensors["motor_slope"], terms) if header["grey_box"] else None
        copula = Copula(tensors["mixing"], tensors["quantiles"]) if header["standardised"] else None
        network = LatentNetwork(
            **arrays, **numbers, taps=tuple(header["taps"]), has_armature=header["has_armature"], motor=motor,
            copula=copula, gain_unit=header["gain_unit"],
        )  # fmt: skip
        texts = {name: header[name] for name in ("preset", "robot", "motor", "provenance", "metrics")}
        names, gains = tuple(header["joint_names"]), tensors.get("gains")
        return cls(network, tensors["mean"], tensors["log_var"], **texts, joint_names=names, gains=gains)


def are_gains(gains: np.ndarray) -> bool:
    """Whether (2, n) numbers can be stated kp and kd: finite, kp positive, kd not negative."""
    return bool(np.isfinite(gains).all() and np.all(gains[0] > 0.0) and np.all(gains[1] >= 0.0))


def checked_gains(gains: np.ndarray, count: int) -> np.ndarray:
    """(2, count) stated kp and kd.

    Raises:
        ConfigError: not of this shape, not finite, kp not positive or kd negative.
    """
    gains = np.asarray(gains, dtype=np.float64)
    if gains.shape != (2, count):
        problem = f"gains of shape {gains.shape}, wanted (2, {count}): kp and kd of every motor"
        raise ConfigError(problem, remedy="give one column per motor", argument="gains")
    if not are_gains(gains):
        worst = gains[:, int(np.argmin(np.where(np.isfinite(gains), gains, -np.inf).min(axis=0)))].tolist()
        raise ConfigError(f"kp and kd {worst} are no gains", remedy="give kp > 0 and kd >= 0", argument="gains")
    return gains


def _check(tensors: dict[str, np.ndarray], header: dict[str, Any], path: Path) -> None:
    """Metrics within bounds, tensors as declared, and what no declaration of one entry can say."""
    check_metrics(header["metrics"], path)
    wanted = _MOTORS | _WEIGHTS
    wanted |= (_GREY_BOX if header["grey_box"] else {}) | (_COPULA if header["standardised"] else {})
    wanted |= _GAINS if header["gain_unit"] else {}
    names = parameters_of(tuple(header["motor_terms"]))
    known = {"inputs": 2 * len(header["taps"]), "constants": len(names)}
    sizes = check_tensors(tensors, wanted, path, _REMEDY, known)
    if header["grey_box"]:
        check_central_motor(tensors["motor_center"], names, path, tensors.get("gains"))
    wrong = {
        "grey_box and has_armature are both true: the rotor would count twice": header["grey_box"]
        and header["has_armature"],
        "standardised is true, but it has no latents": header["standardised"] and sizes["latents"] == 0,
        "quantiles that do not rise, or a singular mixing": header["standardised"] and not _is_copula(tensors),
        "it has 0 training motors": sizes["motors"] == 0,
        "joint_names are not as many as its motors": header["joint_names"]
        and len(header["joint_names"]) != sizes["motors"],
        "gains are not positive": header["gain_unit"] and not are_gains(tensors["gains"]),
        "gain_unit without a motor": header["gain_unit"] and not header["grey_box"],
        "motor_terms are not in their order, or motor_parameters are not theirs": header["motor_terms"]
        != list(in_order(header["motor_terms"]))
        or header["motor_parameters"] != list(names),
        f"{sizes['neurons']} neurons per layer is not a multiple of 4": sizes["neurons"] % 4,
        "it has neither a network nor a motor": not sizes["neurons"] and not header["grey_box"],
    }
    for problem, is_so in wrong.items():
        if is_so:
            raise ArtifactError(problem, where=path, remedy=_REMEDY)


def _is_copula(tensors: dict[str, np.ndarray]) -> bool:
    mixing = tensors["mixing"]
    return bool(np.all(np.diff(tensors["quantiles"], axis=0) > 0) and np.linalg.matrix_rank(mixing) == len(mixing))
