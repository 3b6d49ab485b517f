"""An excitation learned from runs of a robot: their windows, and a method that makes streams.

The methods are `recorded_stream`, `surrogate_stream` and `generated_stream`. `bounded_stream`
bounds what they make.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bounds import TABLE, TEXT, many, number, one_of
from motorprior.exceptions import ConfigError
from motorprior.excitation.bounded_stream import Bounds, bounded, soft_clip
from motorprior.excitation.excitation import Rng, Streams
from motorprior.excitation.frames import CHANNELS, TORQUES_PER_FRAME
from motorprior.excitation.generator import CODE_SIZE, generated_stream, weight_shapes
from motorprior.excitation.recorded import recorded_stream
from motorprior.excitation.surrogate import surrogate_stream
from motorprior.robots.joint_classes import classes_among
from motorprior.schema import Header, Tensor, check_tensors

METHODS = ("generated", "surrogate", "recorded")
BURN_IN = 50  # frames discarded at the start of a stream
UNKNOWN_LOAD = 1e-9  # marks an unknown load inertia [kg·m²]; a bench then samples its own loads
_REMEDY = "write it again with `motorprior excite`"
_HEADER = Header(
    "excitation",
    1,
    {
        "method": one_of(*METHODS),
        "classes": many(TEXT, 1),
        "period": number(above=0.0, unit="s"),
        "provenance": TABLE,
    },
    _REMEDY,
    "excitation.safetensors",
    "motorprior excite",
)
_TENSORS = {
    "windows": Tensor(("windows", "frames", CHANNELS)),
    "window_class": Tensor(("windows",)),
    "commands": Tensor(("windows",)),
    "frequency": Tensor(("windows",)),
    "scales": Tensor(("classes", CHANNELS), above=0.0),
    "bounds": Tensor(("classes", len(Bounds._fields)), above=0.0),
    "load_inertia": Tensor(("classes", 2), above=0.0),
}


@dataclass(frozen=True, eq=False, repr=False)
class LearnedExcitation:
    """Windows of runs, and the method that plays them.

    Targets are relative to the joint's mean target in its run [rad], external torques in N·m.
    """

    method: str  # one of METHODS
    classes: tuple[str, ...]  # C joint classes
    period: float  # control period, of a frame [s]
    # (W, frames, 1 + TORQUES_PER_FRAME) target of each frame, and the external torques of each
    # frame, which follow each other at period / TORQUES_PER_FRAME
    windows: np.ndarray
    window_class: np.ndarray  # (W,) index of the joint class
    commands: np.ndarray  # (W,) commanded speed of the run [m/s], 0 if unknown
    frequency: np.ndarray  # (W,) gait frequency [Hz]
    scales: np.ndarray  # (C, 1 + TORQUES_PER_FRAME) standard deviations
    bounds: np.ndarray  # (C, 4) `Bounds` of each class
    load_inertia: np.ndarray  # (C, 2) lowest and highest in the runs [kg·m²], or UNKNOWN_LOAD
    # weights of the generator; empty if it is not trained
    weights: Mapping[str, np.ndarray] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)  # what it was trained on, and how

    @property
    def jumps(self) -> bool:
        """Learned targets have a bounded speed."""
        return False

    @property
    def is_bounded(self) -> bool:
        """Learned targets have the amplitude of the runs."""
        return True

    def __repr__(self) -> str:
        classes = ", ".join(self.classes)
        return f"{self.method} excitation of {classes}, from {len(self.windows)} windows of runs"

    def __str__(self) -> str:
        lines = [f"{self!r}, period {self.period:g} s"]
        for run in self.provenance.get("trained_on", ()):
            lines.append(f"  {run['seconds']:.3g} s of {run['source']}")
        return "\n".join([*lines, *self.class_lines()])

    def class_lines(self) -> list[str]:
        """A line for each joint class: number of windows, bounds and load inertia."""
        num_windows = np.bincount(self.window_class, minlength=len(self.classes))
        lines = []
        for index, name in enumerate(self.classes):
            amplitude, speed, acceleration, torque = self.bounds[index]
            line = (
                f"{name}: {num_windows[index]} windows; at most {amplitude:.3g} rad from the "
                f"centre, {speed:.3g} rad/s, {acceleration:.3g} rad/s², {torque:.3g} N·m"
            )
            low, high = self.load_inertia[index]
            if UNKNOWN_LOAD not in (low, high):
                line += f", load {low:.2g} to {high:.2g} kg·m²"
            lines.append(line)
        return lines

    def streams(
        self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0
    ) -> Streams:
        """Streams as of `Excitation.streams`; torques do not scale with ``unit``.

        ``joint_names`` are names of joints or of classes, see `classes_among`. Joints of no class
        of the runs get a random one.

        Raises ConfigError for a period longer than the runs' control period.
        """
        if dt > 1.001 * self.period:
            raise ConfigError(
                f"a period of {dt:g} s, the runs were controlled every {self.period:g} s",
                remedy=f"play it at a period of at most {self.period:g} s",
                argument="period",
            )

        classes = self._classes_of(joint_names, rng)
        num_frames = int(np.ceil(steps * dt / self.period)) + 1
        target, torque = self.frames(rng, num_frames, classes)

        # targets are held for a control period
        time = np.arange(steps + 1) * dt
        frame = np.floor(time[:-1] / self.period + 1e-6).astype(int)

        # torques are averaged over the samples, by differences of their integral
        integral = np.vstack([np.zeros_like(torque[:1]), np.cumsum(torque, axis=0)])
        integral = integral * self.period / TORQUES_PER_FRAME
        torque_time = np.arange(len(integral)) * self.period / TORQUES_PER_FRAME
        means = [np.diff(np.interp(time, torque_time, column)) for column in integral.T]

        loads = self.load_inertia[classes]
        inertia = None
        if not np.any(loads == UNKNOWN_LOAD):
            log_low, log_high = np.log(loads).T
            inertia = np.exp(rng.uniform(log_low, log_high))
        return Streams(target[frame], np.stack(means, axis=1) / dt, inertia)

    def within(self, away: np.ndarray, amplitude: float, speed: float, dt: float) -> np.ndarray:
        """Distances (steps, n) [rad] within amplitude [rad] and speed [rad/s].

        Only steps that are too fast are slowed, so the stream keeps its size.
        """
        bounds = Bounds(amplitude, speed, self.bounds[:, 2].max(), 0.0)
        return bounded(np.concatenate([away[:1], away]), bounds, dt)

    def _classes_of(self, joint_names: Sequence[str], rng: Rng) -> np.ndarray:
        """(n,) indices of the joints' classes, for example of the class knee for the joint FR_knee.

        A joint that fits no class gets a random class.
        """
        indices = rng.integers(len(self.classes), size=len(joint_names))
        class_named = {name: name for name in self.classes}
        classes = classes_among(self.classes, joint_names, class_of_joint=class_named)
        for joint, joint_class in enumerate(classes):
            if joint_class in self.classes:
                indices[joint] = self.classes.index(joint_class)
        return indices

    def frames(
        self, rng: Rng, num_frames: int, classes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Targets [rad] and external torques [N·m] of n joints.

        Shapes (num_frames, n) and (num_frames·TORQUES_PER_FRAME, n).

        ``classes`` (n,) are the indices of the joints' classes.
        """
        raw_streams = []
        for index in classes:
            raw_streams.append(self._raw_stream(rng, num_frames + BURN_IN + 1, index))
        raw = np.stack(raw_streams, axis=1)  # (frames, n, CHANNELS)

        amplitude, speed, acceleration, max_torque = self.bounds[classes].T
        limits = Bounds(amplitude, speed, acceleration, max_torque)
        target = bounded(raw[..., 0], limits, self.period)[BURN_IN:]

        # the torques of a frame become consecutive rows
        raw_torque = raw[BURN_IN + 1 :, :, 1:]
        torque = soft_clip(raw_torque, max_torque[:, None])  # (frames, n, TORQUES_PER_FRAME)
        torque_rows = np.moveaxis(torque, 2, 1).reshape(-1, len(classes))
        return target, torque_rows

    def _raw_stream(self, rng: Rng, num_frames: int, class_index: int) -> np.ndarray:
        """(num_frames, CHANNELS) stream of a joint, without bounds."""
        is_of_class = self.window_class == class_index
        if self.method == "recorded":
            return recorded_stream(self.windows[is_of_class], rng, num_frames)
        if self.method == "surrogate":
            return surrogate_stream(self.windows[is_of_class], rng, num_frames)

        gaits = np.column_stack([np.log(self.frequency), self.weights["codes"], self.commands])
        class_code = np.eye(len(self.classes))[class_index]
        scaled = generated_stream(
            self.weights, gaits[is_of_class], class_code, self.period, rng, num_frames
        )
        return scaled * self.scales[class_index]

    def save(self, path: Path) -> None:
        """Write it as one safetensors file."""
        header = _HEADER.make(
            method=self.method,
            classes=list(self.classes),
            period=self.period,
            provenance=dict(self.provenance),
        )
        tensors = {name: getattr(self, name) for name in _TENSORS} | dict(self.weights)
        tensors = {name: np.asarray(value, np.float64) for name, value in tensors.items()}
        write_tensors(path, tensors, header)

    @classmethod
    def load(cls, path: str | Path) -> "LearnedExcitation":
        """Read what `save` wrote; raises ArtifactError for another file, or one that is damaged."""
        tensors, header = _HEADER.read(Path(path))
        num_classes = len(header["classes"])

        weights: dict[str, Tensor] = {}
        if header["method"] == "generated" or "codes" in tensors:
            shapes = {"codes": ("windows", CODE_SIZE), **weight_shapes(num_classes)}
            weights = {name: Tensor(shape) for name, shape in shapes.items()}
        check_tensors(tensors, _TENSORS | weights, path, _REMEDY, {"classes": num_classes})

        fields = {name: tensors[name] for name in _TENSORS}
        fields["window_class"] = tensors["window_class"].astype(int)
        return cls(
            header["method"],
            tuple(header["classes"]),
            float(header["period"]),
            **fields,
            weights={name: tensors[name] for name in weights},
            provenance=header["provenance"],
        )
