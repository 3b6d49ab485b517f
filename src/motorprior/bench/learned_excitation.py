"""Excitations learned from runs of a robot: windows that are played, surrogates with their spectrum, or generated.

A frame is one control period: a position target, and SUB external torques. Makers give a raw stream
(frames, CHANNELS) of a joint of class ``kind``; `bounded_stream` bounds it. `excitation_of` finds
every excitation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bench.bounded_stream import Bounds, bounded, soft_clip
from motorprior.bench.excitation import Excitation, Rng, Streams, excitation_named
from motorprior.bounds import TABLE, TEXT, many, number, one_of
from motorprior.exceptions import ConfigError
from motorprior.schema import Header, Tensor, check_tensors

SUB = 5  # external torques per frame
CHANNELS = 1 + SUB
BURN_IN = 50  # frames discarded at the start of a stream
# frames of a cross-fade between two windows; windows from which the next one is chosen
FADE = 10
FOLLOWERS = 128
# frames of a gait in a generated stream, and of the transition to the next one
GAIT_FRAMES = 250
TRANSITION = 25
NEIGHBOURS = 8  # windows with a similar gait, one of which is mixed with a window
# inputs: noise per frame, code of a window, harmonics of the gait's phase
NOISE = 10
CODE = 12
HARMONICS = 10
# layers of the embedding of a gait's phase, and its channels
LAYERS = 3
EMBEDDING = 96
# channels, taps and dilations of the convolutions
NUM_HIDDEN = 32
TAPS = 5
DILATIONS = (1, 3)
TARGET_NOISE = 0.1  # factor of the convolutions in the target, which is smooth
EDGE = (TAPS - 1) * sum(DILATIONS) // 2  # frames before and after an output that it depends on
LEAK = 0.2  # slope of the activations for negative inputs
MIN_SCALE = 1e-6  # standard deviation of a channel that is constant in the runs
UNKNOWN_LOAD = 1e-9  # [kg·m²]: a bench then plays its own loads
# frames over which a surrogate has the marginals of the runs; windows whose spectra it mixes
_SURROGATE = 4096, 64
_REMEDY = "write it again with `motorprior excite`"


def recorded(
    runs: "LearnedExcitation", rng: np.random.Generator, frames: int, kind: int
) -> np.ndarray:
    """All windows of a class in random order, then again, with cross-faded seams.

    The next window is the one of FOLLOWERS random ones whose targets continue the last one's best.
    """
    windows = runs.windows[runs.window_class == kind]
    count = -(-frames // (runs.windows.shape[1] - FADE))
    last = rng.integers(len(windows))
    left = np.empty(0, int)
    order = []
    for _ in range(count):
        left = left if len(left) else rng.permutation(len(windows))
        seams = windows[left[:FOLLOWERS], :FADE, 0] - windows[last, -FADE:, 0]
        best = int(np.argmin(np.sum(seams**2, axis=1)))
        last = left[best]
        left = np.delete(left, best)
        order.append(last)
    rising = (0.5 - 0.5 * np.cos(np.pi * (np.arange(FADE) + 0.5) / FADE))[:, None]
    played = windows[order]
    played[1:, :FADE] = rising * played[1:, :FADE] + rising[::-1] * played[:-1, -FADE:]
    return played[:, :-FADE].reshape(-1, CHANNELS)[:frames]


def surrogate(
    runs: "LearnedExcitation", rng: np.random.Generator, frames: int, kind: int
) -> np.ndarray:
    """A Gaussian process with the cross-spectra of a class, then its marginals.

    Phase-randomised surrogate (Theiler et al., Physica D 58, 1992): a sum of the spectra of windows
    with random complex weights at every frequency, mapped by rank to the windows' values, channel
    by channel.
    """
    total = max(frames, _SURROGATE[0])
    windows = runs.windows[runs.window_class == kind]
    mixed = rng.permutation(windows)[: _SURROGATE[1]]
    spectra = np.fft.rfft(np.hanning(windows.shape[1])[:, None] * mixed, axis=1)
    at = np.linspace(0.0, spectra.shape[1] - 1.0, total // 2 + 1).round().astype(int)
    weights = rng.standard_normal((2, len(at), len(mixed)))
    process = np.fft.irfft(
        np.einsum("fw,wfi->fi", weights[0] + 1j * weights[1], spectra[:, at]), n=total, axis=0
    )
    values = np.sort(windows.reshape(-1, CHANNELS), axis=0)
    levels = np.linspace(0, len(values) - 1, total).astype(int)
    return np.take_along_axis(values[levels], process.argsort(axis=0).argsort(axis=0), axis=0)[
        :frames
    ]


def generated(
    runs: "LearnedExcitation", rng: np.random.Generator, frames: int, kind: int
) -> np.ndarray:
    """A stream of the generator, convolutions of endless inputs, hence without seams.

    Every GAIT_FRAMES the next gait follows: frequency, code and commanded speed between those of
    two similar windows.
    """
    total = frames + 2 * EDGE
    number, since = np.divmod(np.arange(total) + rng.integers(GAIT_FRAMES), GAIT_FRAMES)
    known = np.column_stack([np.log(runs.frequency), runs.weights["codes"], runs.commands])[
        runs.window_class == kind
    ]
    gaits = _gaits(known, rng, number[-1] + 2)
    share = 0.5 - 0.5 * np.cos(np.pi * np.minimum((since + 0.5) / TRANSITION, 1.0))[:, None]
    gait = (1.0 - share) * gaits[number] + share * gaits[number + 1]
    phase = 2 * np.pi * (rng.random() + runs.period * np.cumsum(np.exp(gait[:, 0])))
    conditions = np.column_stack([gait[:, 1:], np.eye(len(runs.classes))[np.full(total, kind)]])
    noise = rng.standard_normal((1, total, NOISE))
    return generator(runs.weights, phase[None], conditions[None], noise)[0] * runs.scales[kind]


def _gaits(known: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, K) random points between a row of ``known`` (n, K) and one of its nearest rows."""
    first = rng.integers(len(known), size=count)
    share = rng.uniform(0.0, 0.5, (count, 1))
    apart = np.linalg.norm((known[first, None] - known) / (known.std(axis=0) + 1e-9), axis=2)
    second = rng.permuted(np.argsort(apart, axis=1)[:, : NEIGHBOURS + 1], axis=1)[:, 0]
    return (1.0 - share) * known[first] + share * known[second]


def generator(
    weights: Mapping[str, Any], phase: Any, conditions: Any, noise: Any, xp: ModuleType = np
) -> Any:
    """(n, frames - 2 EDGE, CHANNELS) scaled raw streams; also for JAX.

    Inputs are the gait's phase (n, frames) [rad], conditions (n, frames, CODE + 1 + classes): the
    code, the commanded speed and the class; and Gaussian noise (n, frames, NOISE). An embedding of
    phase and conditions, frame by frame, gives mean target and torques; gated convolutions of
    embedding and noise add oscillations.
    """
    waves = [
        wave(order * phase)[..., None]
        for order in range(1, HARMONICS + 1)
        for wave in (xp.sin, xp.cos)
    ]
    embedding = xp.concatenate([*waves, conditions], axis=2)
    for layer in range(LAYERS):
        embedding = leaky(embedding @ weights[f"v{layer}"] + weights[f"c{layer}"], xp)
    hidden = xp.concatenate([embedding, noise], axis=2)
    for layer, dilation in enumerate(DILATIONS):
        found = convolved(hidden, weights[f"w{layer}"], dilation) + weights[f"b{layer}"]
        found = found[..., :NUM_HIDDEN] * (0.5 + 0.5 * xp.tanh(0.5 * found[..., NUM_HIDDEN:]))
        reach = dilation * (TAPS - 1) // 2
        hidden = found + hidden[:, reach:-reach] if layer else found
    mean = embedding[:, EDGE:-EDGE] @ weights["w_skip"] + weights["b_out"]
    return mean + (hidden @ weights["w_out"]) * xp.array([TARGET_NOISE] + SUB * [1.0])


def leaky(signal: Any, xp: ModuleType = np) -> Any:
    """``signal``, its negative values times LEAK."""
    return xp.where(signal > 0.0, signal, LEAK * signal)


def convolved(signal: Any, kernel: Any, dilation: int = 1, stride: int = 1) -> Any:
    """Convolution of (n, frames, inputs) with (taps, inputs, outputs), without padding."""
    count = signal.shape[1] - dilation * (len(kernel) - 1)
    return sum(
        signal[:, tap * dilation :][:, :count:stride] @ kernel[tap] for tap in range(len(kernel))
    )


def weight_shapes(num_classes: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the generator's weights."""
    inputs = 2 * HARMONICS + CODE + 1 + num_classes
    shapes: dict[str, tuple[int, ...]] = {
        "w_skip": (EMBEDDING, CHANNELS),
        "w_out": (NUM_HIDDEN, CHANNELS),
        "b_out": (CHANNELS,),
    }
    for layer in range(LAYERS):
        shapes |= {
            f"v{layer}": (EMBEDDING if layer else inputs, EMBEDDING),
            f"c{layer}": (EMBEDDING,),
        }
    for layer in range(len(DILATIONS)):
        before = NUM_HIDDEN if layer else EMBEDDING + NOISE
        shapes |= {f"w{layer}": (TAPS, before, 2 * NUM_HIDDEN), f"b{layer}": (2 * NUM_HIDDEN,)}
    return shapes


MAKERS = {"generated": generated, "surrogate": surrogate, "recorded": recorded}
_HEADER = Header(
    "excitation", 1,
    {"method": one_of(*MAKERS), "classes": many(TEXT, 1), "period": number(above=0.0, unit="s"), "provenance": TABLE},
    _REMEDY, "excitation.safetensors", "motorprior excite",
)  # fmt: skip
_TENSORS = {
    "windows": Tensor(("windows", "frames", CHANNELS)),
    **dict.fromkeys(("window_class", "commands", "frequency"), Tensor(("windows",))),
    "scales": Tensor(("classes", CHANNELS), above=0.0),
    "bounds": Tensor(("classes", len(Bounds._fields)), above=0.0),
    "load_inertia": Tensor(("classes", 2), above=0.0),
}


@dataclass(frozen=True, eq=False, repr=False)
class LearnedExcitation:
    """Windows of runs, and a generator of more of them.

    Targets are relative to the joint's mean target in its run [rad], external torques in N·m.
    """

    method: str  # one of MAKERS, makes the streams
    classes: tuple[str, ...]  # C joint classes
    period: float  # control period, of a frame [s]
    # (W, frames, 1 + SUB) target of each frame, and external torque every period / SUB
    windows: np.ndarray
    window_class: np.ndarray  # (W,) index of the joint class
    commands: np.ndarray  # (W,) commanded speed of the run [m/s], 0 if unknown
    frequency: np.ndarray  # (W,) gait frequency [Hz]
    scales: np.ndarray  # (C, 1 + SUB) standard deviations
    bounds: np.ndarray  # (C, 4) `Bounds` of each class
    load_inertia: np.ndarray  # (C, 2) lowest and highest in the runs [kg·m²], or UNKNOWN_LOAD
    # of the generator; empty if not trained
    weights: Mapping[str, np.ndarray] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)  # what it was trained on, and how
    jumps: ClassVar[bool] = False
    is_bounded: ClassVar[bool] = True

    def __repr__(self) -> str:
        return f"{self.method} excitation of {', '.join(self.classes)}, from {len(self.windows)} windows of runs"

    def __str__(self) -> str:
        runs = [
            f"  {run['seconds']:.3g} s of {run['source']}"
            for run in self.provenance.get("trained_on", ())
        ]
        return "\n".join([f"{self!r}, period {self.period:g} s", *runs, *self.class_lines()])

    def class_lines(self) -> list[str]:
        """A line for each joint class: number of windows, bounds and load inertia."""
        lines = []
        counts = np.bincount(self.window_class)
        for name, count, bounds, load in zip(
            self.classes, counts, self.bounds, self.load_inertia, strict=True
        ):
            text = "at most {:.3g} rad from the centre, {:.3g} rad/s, {:.3g} rad/s², {:.3g} N·m".format(
                *bounds
            )
            loaded = "" if UNKNOWN_LOAD in load else ", load {:.2g} to {:.2g} kg·m²".format(*load)
            lines.append(f"{name}: {count} windows; {text}{loaded}")
        return lines

    def with_method(self, method: str) -> "LearnedExcitation":
        """The same runs with another method of MAKERS; raises `ConfigError` without a generator."""
        if method == "generated" and not self.weights:
            raise ConfigError(
                "no generator", remedy="play it as surrogate or recorded", argument="method"
            )
        return replace(self, method=method)

    def streams(
        self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0
    ) -> Streams:
        """See `Excitation.streams`; torques do not scale with ``unit``. Joints of no class get a random one.

        Raises ConfigError for a period longer than the runs' control period.
        """
        if dt > 1.001 * self.period:
            problem = f"a period of {dt:g} s, the runs were controlled every {self.period:g} s"
            raise ConfigError(
                problem,
                remedy=f"play it at a period of at most {self.period:g} s",
                argument="period",
            )
        others = rng.integers(len(self.classes), size=len(joint_names)).tolist()
        which = np.array([self._class_of(*each) for each in zip(joint_names, others, strict=True)])
        target, torque = self.frames(rng, int(np.ceil(steps * dt / self.period)) + 1, which)
        time = np.arange(steps + 1) * dt
        frame = np.floor(time[:-1] / self.period + 1e-6).astype(int)
        sums = np.vstack([np.zeros_like(torque[:1]), np.cumsum(torque, axis=0)]) * self.period / SUB
        at = np.arange(len(sums)) * self.period / SUB
        means = np.stack([np.diff(np.interp(time, at, column)) for column in sums.T], axis=1) / dt
        loads = self.load_inertia[which]
        inertia = None if np.any(loads == UNKNOWN_LOAD) else np.exp(rng.uniform(*np.log(loads).T))
        return Streams(target[frame], means, inertia)

    def _class_of(self, name: str, other: int) -> int:
        """Index of the class that is the joint's name or its end, as knee of FR_knee; ``other`` if none is."""
        ends = [index for index, kind in enumerate(self.classes) if f"_{name}".endswith(f"_{kind}")]
        return max(ends, key=lambda index: len(self.classes[index]), default=other)

    def frames(self, rng: Rng, frames: int, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Targets (frames, n) [rad] and external torques (frames·SUB, n) [N·m] of joints of classes ``which`` (n,)."""
        raw = np.stack(
            [MAKERS[self.method](self, rng, frames + BURN_IN + 1, kind) for kind in which], axis=1
        )
        limits = Bounds(*self.bounds[which].T)
        target = bounded(raw[..., 0], limits, self.period)[BURN_IN:]
        torque = soft_clip(raw[BURN_IN + 1 :, :, 1:], limits.torque[:, None])
        return target, np.moveaxis(torque, 2, 1).reshape(-1, len(which))

    def save(self, path: Path) -> None:
        """Write it as one safetensors file."""
        tensors = {name: getattr(self, name) for name in _TENSORS} | dict(self.weights)
        entries = {"method": self.method, "classes": list(self.classes), "period": self.period}
        header = _HEADER.make(**entries, provenance=dict(self.provenance))
        write_tensors(
            path, {name: np.asarray(value, np.float64) for name, value in tensors.items()}, header
        )

    @classmethod
    def load(cls, path: str | Path) -> "LearnedExcitation":
        """Read what `save` wrote; raises ArtifactError for another file, or one that is damaged."""
        tensors, header = _HEADER.read(Path(path))
        count = len(header["classes"])
        has_weights = header["method"] == "generated" or "codes" in tensors
        shapes = {"codes": ("windows", CODE), **weight_shapes(count)} if has_weights else {}
        weights = {name: Tensor(shape) for name, shape in shapes.items()}
        check_tensors(tensors, _TENSORS | weights, path, _REMEDY, {"classes": count})
        return cls(
            header["method"],
            tuple(header["classes"]),
            float(header["period"]),
            **{name: tensors[name] for name in _TENSORS}
            | {"window_class": tensors["window_class"].astype(int)},
            weights={name: tensors[name] for name in weights},
            provenance=header["provenance"],
        )


def excitation_of(name: str, others: tuple[str, ...] = ()) -> Excitation | LearnedExcitation:
    """The excitation in a file (.safetensors), or of this name; errors as `excitation_named` and `load`."""
    if name.endswith(".safetensors"):
        return LearnedExcitation.load(name)
    return excitation_named(name, (*others, "a file that `motorprior excite` wrote"))
