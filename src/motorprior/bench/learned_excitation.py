"""Excitations learned from runs of a robot, and the one look-up of all excitations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bench.bounded_stream import Bounds, bounded, soft
from motorprior.bench.excitation import Excitation, Rng, Streams, excitation_named
from motorprior.bench.stream_makers import CHANNELS, DILATIONS, MAKERS, SUB, TAPS, num_inputs
from motorprior.bounds import TABLE, TEXT, many, number, one_of
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.schema import Header, Tensor, check_tensors

BURN_IN = 50  # frames before a stream, in which it gets up to speed
NUM_HIDDEN = 32  # of the generator
_REMEDY = "write it again with `motorprior excite`"
_HEADER = Header(
    "excitation", 1,
    {"play": one_of(*MAKERS), "classes": many(TEXT, 1), "period": number(above=0.0, unit="s"), "provenance": TABLE},
    _REMEDY, "excitation.safetensors", "motorprior excite",
)  # fmt: skip
_TENSORS = {
    "windows": Tensor(("windows", "frames", CHANNELS)),
    **dict.fromkeys(("window_class", "commands", "frequency"), Tensor(("windows",))),
    "scales": Tensor(("classes", CHANNELS), above=0.0),
    "bounds": Tensor(("classes", len(Bounds._fields)), above=0.0),
    "load_inertia": Tensor(("classes", 2), above=0.0),
}


def weight_shapes(num_classes: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the generator's weights."""
    sizes = (num_inputs(num_classes), *(NUM_HIDDEN for _ in DILATIONS))
    shapes: dict[str, tuple[int, ...]] = {"w_out": (NUM_HIDDEN, CHANNELS), "b_out": (CHANNELS,)}
    for layer in range(len(DILATIONS)):
        shapes |= {f"w{layer}": (TAPS, sizes[layer], sizes[layer + 1]), f"b{layer}": (sizes[layer + 1],)}
    return shapes


@dataclass(frozen=True, eq=False)
class LearnedExcitation:
    """Windows of runs, and a generator of more of them.

    Targets are relative to the joint's mean target in its run [rad], external torques in N·m.
    """

    play: str  # how streams are made: one of `stream_makers.MAKERS`
    classes: tuple[str, ...]  # C joint classes
    period: float  # control period, of a frame [s]
    windows: np.ndarray  # (W, frames, 1 + SUB) target of each frame, and external torque every period / SUB
    window_class: np.ndarray  # (W,) index of the joint class
    commands: np.ndarray  # (W,) commanded speed of the run [m/s], 0 if unknown
    frequency: np.ndarray  # (W,) frequency of the largest component of the target [Hz]
    scales: np.ndarray  # (C, 1 + SUB) standard deviations
    bounds: np.ndarray  # (C, 4) `Bounds` of each class
    load_inertia: np.ndarray  # (C, 2) lowest and highest in the runs [kg·m²]
    weights: Mapping[str, np.ndarray] = field(default_factory=dict)  # of the generator; none if it was not trained
    provenance: Mapping[str, Any] = field(default_factory=dict)  # what it was trained on, and how
    jumps: ClassVar[bool] = False
    is_bounded: ClassVar[bool] = True

    def playing(self, play: str) -> LearnedExcitation:
        """The same runs, played another way; raises `ConfigError` for an unknown one or without a generator."""
        if play not in MAKERS or (play == "generated" and not self.weights):
            ways = ", ".join(way for way in MAKERS if way != "generated" or self.weights)
            raise ConfigError(f"play {play!r}", remedy=f"use one of {ways}", argument="play")
        return replace(self, play=play)

    def within(self, limits: Bounds) -> LearnedExcitation:
        """The same with bounds that are at most these limits, each a number."""
        return replace(self, bounds=np.minimum(self.bounds, np.array(limits, float)))

    def streams(self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0) -> Streams:
        """See `Excitation.streams`; torques do not scale with ``unit``. Joints of no class get a random one.

        Raises ConfigError for a period longer than the runs' control period.
        """
        del unit
        if dt > 1.001 * self.period:
            problem = f"a period of {dt:g} s, the runs were controlled every {self.period:g} s"
            raise ConfigError(problem, remedy="fit it with this period", argument="period")
        others = rng.integers(len(self.classes), size=len(joint_names))
        which = np.array([class_of(n, self.classes, int(k)) for n, k in zip(joint_names, others, strict=True)])
        target, torque = self.frames(rng, int(np.ceil(steps * dt / self.period)) + 1, which)
        time = np.arange(steps + 1) * dt
        frame = np.floor(time[:-1] / self.period + 1e-6).astype(int)
        sums = np.vstack([np.zeros_like(torque[:1]), np.cumsum(torque, axis=0)]) * self.period / SUB
        at = np.arange(len(sums)) * self.period / SUB
        means = np.stack([np.diff(np.interp(time, at, column)) for column in sums.T], axis=1) / dt
        low, high = np.log(self.load_inertia[which]).T
        return Streams(target[frame], means, np.exp(rng.uniform(low, high)))

    def frames(self, rng: Rng, frames: int, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Targets (frames, n) [rad] and external torques (frames·SUB, n) [N·m] of joints of classes ``which`` (n,)."""
        raw = MAKERS[self.play](self, rng, frames + BURN_IN + 1, which)
        limits = Bounds(*self.bounds[which].T)
        target = bounded(raw[..., 0], limits, self.period)[BURN_IN:]
        torque = soft(raw[BURN_IN + 1 :, :, 1:], limits.torque[:, None])
        return target, np.moveaxis(torque, 2, 1).reshape(-1, len(which))

    def save(self, path: Path) -> None:
        """Write it as one safetensors file."""
        tensors = {name: getattr(self, name) for name in _TENSORS} | dict(self.weights)
        header = _HEADER.write(
            play=self.play, classes=list(self.classes), period=self.period, provenance=dict(self.provenance)
        )
        write_tensors(path, {name: np.asarray(value, np.float64) for name, value in tensors.items()}, header)

    @classmethod
    def load(cls, path: str | Path) -> LearnedExcitation:
        """Read what `save` wrote; raises ArtifactError for another file, or one that is damaged."""
        tensors, header = _HEADER.read(Path(path))
        count = len(header["classes"])
        weights = {name: Tensor(shape) for name, shape in weight_shapes(count).items()}
        has_weights = header["play"] == "generated" or bool(weights.keys() & tensors.keys())
        wanted = _TENSORS | (weights if has_weights else {})
        check_tensors(tensors, wanted, path, _REMEDY, {"classes": count})
        which = tensors["window_class"]
        if set(np.unique(which)) != set(range(count)):
            raise ArtifactError("window_class is not the index of a class", where=path, remedy=_REMEDY)
        return cls(
            header["play"], tuple(header["classes"]), float(header["period"]),
            **{name: tensors[name] for name in _TENSORS} | {"window_class": which.astype(int)},
            weights={name: tensors[name] for name in weights} if has_weights else {}, provenance=header["provenance"],
        )  # fmt: skip


def class_of(name: str, classes: Sequence[str], other: int) -> int:
    """Index of the class that is the joint's name or its end, as knee of FR_knee; ``other`` if none is."""
    ends = [index for index, kind in enumerate(classes) if f"_{name}".endswith(f"_{kind}")]
    return max(ends, key=lambda index: len(classes[index]), default=other)


def excitation_of(name: str, others: tuple[str, ...] = ()) -> Excitation | LearnedExcitation:
    """The excitation in a file (.safetensors), or of this name; errors as `excitation_named` and `load`."""
    if name.endswith(".safetensors"):
        return LearnedExcitation.load(name)
    return excitation_named(name, (*others, "a file that `motorprior excite` wrote"))
