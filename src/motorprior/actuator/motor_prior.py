"""The motor prior: a distribution of motors as a file. z ~ N(0, I) gives a motor, μ_i gives training motor i."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.prior_bounds import LARGEST_SLOPE, check_central_motor, check_metrics
from motorprior.artifacts import read_tensors, require_keys, tensors_as_bytes, write_tensors
from motorprior.bounds import generator_of, require_count
from motorprior.exceptions import ArtifactError, ConfigError

SCHEMA_VERSION = 3
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N·m", "armature": "kg·m²", "time": "s"}
SIGN = "error = position_target - joint_pos; a positive torque accelerates the joint upwards"
INPUT_ORDER = "errors of all taps, then velocities of all taps; tap k is k periods old"
_WEIGHTS = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
_MOTOR = ("motor_center", "motor_slope")
"""Of a grey box only."""
_COPULA = ("mixing", "quantiles")
"""Of a prior with standardised latents only."""
_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")
_HEADER = (
    "schema_version", "kind", "units", "sign", "input_order", "taps", "period", "has_armature", "grey_box",
    "standardised", "motor_parameters", *_SCALES, "preset", "robot", "motor", "provenance", "metrics",
)  # fmt: skip
_KINDS = {
    "has_armature": bool,
    "grey_box": bool,
    "standardised": bool,
    "preset": str,
    "robot": str,
    "motor": str,
    "provenance": dict,
    "metrics": dict,
}
_KIND_NAMES = {bool: "true or false", str: "a text", dict: "a table"}
_ANEW = "identify it anew"
_LARGEST_WEIGHT, _LARGEST_LOGARITHM = 1e4, 30.0
_LOGARITHMS = ("motor_center", "log_armature", "log_var")
"""Tensors that are exponentiated."""
_SLOPES = ("motor_slope", "armature_slope")
"""Tensors whose product with z is."""
_SMALLEST_SCALE, _LARGEST_SCALE = 1e-9, 1e9
_OLDEST_TAP = 10_000
"""Periods; every motor keeps so much history."""


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
    """

    network: LatentNetwork
    mean: np.ndarray
    log_var: np.ndarray
    preset: str
    robot: str
    motor: str
    provenance: dict[str, Any]
    metrics: dict[str, float]

    def sample(self, count: int, seed: int | np.random.Generator) -> LatentActuator:
        """Draw ``count`` new motors, z ~ N(0, I).

        Args:
            count: number of motors.
            seed: of the draw; a generator goes on from where it is.

        Raises:
            ConfigError: ``count`` is no positive whole number, or ``seed`` no seed.
        """
        require_count("count", count)
        return LatentActuator(self.network, generator_of(seed).standard_normal((count, self.network.num_latents)))

    def training_motors(self, index: np.ndarray) -> LatentActuator:
        """The training motors at ``index``, at their posterior means."""
        return LatentActuator(self.network, self.mean[index])

    def require(self, robot: str, physics_dt: float) -> None:
        """Refuse a use the prior was not made for.

        Raises:
            ConfigError: another robot, or a physics step that does not divide its period.
        """
        if self.robot != robot:
            raise ConfigError(
                f"the prior is of robot {self.robot!r}, not {robot!r}", remedy=f"identify one from logs of {robot}"
            )
        LatentActuator(self.network, self.mean[:1]).arrays(physics_dt)

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
        header = {
            "schema_version": SCHEMA_VERSION, "kind": "motor prior", "units": UNITS, "sign": SIGN,
            "input_order": INPUT_ORDER, "taps": list(net.taps), "period": net.period,
            "has_armature": net.has_armature, "grey_box": net.motor is not None,
            "standardised": net.copula is not None,
            "motor_parameters": list(PARAMETERS), **{name: getattr(net, name) for name in _SCALES},
            "preset": self.preset, "robot": self.robot, "motor": self.motor,
            "provenance": self.provenance, "metrics": self.metrics,
        }  # fmt: skip
        return {**tensors, "mean": self.mean, "log_var": self.log_var}, header

    @classmethod
    def load(cls, path: str | Path) -> MotorPrior:
        """Read a prior.

        Raises:
            ArtifactError: not a motor prior, another schema, unknown or missing keys, shapes that do not fit,
                or weights beyond any sensible size.
        """
        path = Path(path)
        tensors, header = read_tensors(path)
        if header.get("kind") != "motor prior":
            raise ArtifactError(f"kind {header.get('kind')!r} is not a motor prior", where=path)
        if header.get("schema_version") != SCHEMA_VERSION:
            raise ArtifactError(
                f"schema version {header.get('schema_version')!r}, this motorprior reads {SCHEMA_VERSION}",
                where=path,
                remedy="identify it anew with this version",
            )
        require_keys(header, _HEADER, path)
        _check_meaning(header, path)
        require_keys(tensors, (*_WEIGHTS, *_optional(header), "mean", "log_var"), path)
        _check_shapes(tensors, header, path)
        numbers: dict[str, Any] = {name: float(header[name]) for name in ("period", *_SCALES)}
        arrays: dict[str, Any] = {name: tensors[name] for name in _WEIGHTS}
        motor = GearedMotor(tensors["motor_center"], tensors["motor_slope"]) if header["grey_box"] else None
        copula = Copula(tensors["mixing"], tensors["quantiles"]) if header["standardised"] else None
        network = LatentNetwork(
            **arrays, **numbers, taps=tuple(header["taps"]), has_armature=header["has_armature"], motor=motor,
            copula=copula,
        )  # fmt: skip
        texts = {name: header[name] for name in ("preset", "robot", "motor", "provenance", "metrics")}
        return cls(network, tensors["mean"], tensors["log_var"], **texts)


def _optional(header: dict[str, Any]) -> tuple[str, ...]:
    """Names of the tensors that only some priors have, of this one."""
    return (*(_MOTOR if header["grey_box"] else ()), *(_COPULA if header["standardised"] else ()))


def _check_meaning(header: dict[str, Any], path: Path) -> None:
    """Units, sign, order and numbers are those this code computes with."""
    meaning = (("units", UNITS), ("sign", SIGN), ("input_order", INPUT_ORDER), ("motor_parameters", list(PARAMETERS)))
    for key, wanted in meaning:
        if header[key] != wanted:
            raise ArtifactError(
                f"{key} is {header[key]!r}", where=path, remedy=f"this version computes with {wanted!r}"
            )
    for key in ("period", *_SCALES):
        value = header[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not _SMALLEST_SCALE <= value <= _LARGEST_SCALE:
            raise ArtifactError(
                f"{key} = {str(value)[:40]} is not a number from {_SMALLEST_SCALE:g} to {_LARGEST_SCALE:g}",
                where=path,
                remedy=_ANEW,
            )
    if not _are_taps(header["taps"]):
        problem = f"taps {str(header['taps'])[:40]} are not integers that ascend from 0 to {_OLDEST_TAP} at most"
        raise ArtifactError(problem, where=path, remedy=_ANEW)
    for key, kind in _KINDS.items():
        if not isinstance(header[key], kind):
            raise ArtifactError(f"{key} = {str(header[key])[:40]} is not {_KIND_NAMES[kind]}", where=path, remedy=_ANEW)
    if header["grey_box"] and header["has_armature"]:
        problem = "grey_box and has_armature are both true: the rotor would count twice"
        raise ArtifactError(problem, where=path, remedy=_ANEW)
    check_metrics(header["metrics"], path)


def _are_taps(taps: object) -> bool:
    """Whether this is what a history can be made of."""
    if not isinstance(taps, list) or any(type(tap) is not int for tap in taps):
        return False
    return bool(taps) and taps[0] == 0 and taps[-1] <= _OLDEST_TAP and sorted(set(taps)) == taps


def _check_shapes(tensors: dict[str, np.ndarray], header: dict[str, Any], path: Path) -> None:
    inputs, neurons = 2 * len(header["taps"]), tensors["b1"].shape[0] if tensors["b1"].ndim == 1 else 0
    motors, latents = (*tensors["mean"].shape, 0, 0)[:2]
    wanted = {
        "w1": (inputs, neurons), "v1": (latents, neurons), "b1": (neurons,), "w2": (neurons, neurons),
        "b2": (neurons,), "w3": (neurons,), "b3": (), "log_armature": (), "armature_slope": (latents,),
        "mean": (motors, latents), "log_var": (motors, latents),
        "motor_center": (len(PARAMETERS),), "motor_slope": (latents, len(PARAMETERS)),
        "mixing": (latents, latents), "quantiles": (len(SCORES), latents),
    }  # fmt: skip
    for name, shape in wanted.items():
        if name in (*_MOTOR, *_COPULA) and name not in _optional(header):
            continue
        value = tensors[name]
        if value.shape != shape or value.dtype != np.float64:
            raise ArtifactError(f"{name} is {value.dtype}{value.shape}, wanted float64{shape}", where=path)
        largest = _largest(name)
        if value.size and np.abs(value).max() > largest:
            raise ArtifactError(
                f"{name} holds {np.abs(value).max():.3g}, beyond {largest:g}", where=path,
                remedy="the training diverged: identify it anew",
            )  # fmt: skip
    if header["grey_box"]:
        check_central_motor(tensors["motor_center"], path)
    if header["standardised"] and latents == 0:
        raise ArtifactError("standardised is true, but it has no latents", where=path, remedy=_ANEW)
    if header["standardised"]:
        mixing, rises = tensors["mixing"], np.diff(tensors["quantiles"], axis=0)
        if np.any(rises <= 0) or np.linalg.matrix_rank(mixing) < latents:
            raise ArtifactError("quantiles that do not rise, or a singular mixing", where=path, remedy=_ANEW)
    if motors == 0:
        raise ArtifactError("it has 0 training motors", where=path, remedy=_ANEW)
    if neurons == 0 or neurons % 4:
        raise ArtifactError(f"{neurons} neurons per layer is not a multiple of 4", where=path, remedy=_ANEW)


def _largest(name: str) -> float:
    """Of the absolute values in a tensor."""
    if name in _SLOPES:
        return LARGEST_SLOPE
    return _LARGEST_LOGARITHM if name in _LOGARITHMS else _LARGEST_WEIGHT
