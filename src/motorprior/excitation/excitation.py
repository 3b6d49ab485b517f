"""What an excitation is: position targets and loads of joints, from a random generator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

Rng: TypeAlias = np.random.Generator
# (generator, steps, sample period [s]) -> (steps,) signal
Signal = Callable[[Rng, int, float], np.ndarray]


class Streams(NamedTuple):
    """Commands and loads of n joints."""

    position_target: np.ndarray  # (steps, n) [rad]
    external_torque: np.ndarray  # (steps, n) on the joints, on a bench [N·m]
    load_inertia: np.ndarray | None = None  # (n,) on a bench [kg·m²]; None: the bench's own choice


class StreamSource(Protocol):
    """An excitation: hand-made signals, or signals learned from runs."""

    @property
    def jumps(self) -> bool:
        """Whether targets change faster than any speed limit."""
        ...

    @property
    def is_bounded(self) -> bool:
        """Whether targets have a fixed amplitude, which a robot may only reduce."""
        ...

    def streams(
        self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0
    ) -> Streams:
        """Streams of joints, sampled every ``dt`` [s]; ``unit`` of external torques [N·m]."""
        ...

    def within(self, away: np.ndarray, amplitude: float, speed: float, dt: float) -> np.ndarray:
        """Distances (steps, n) [rad] from a pose, bounded where the excitation can be bounded."""
        ...


@dataclass(frozen=True)
class Excitation:
    """Excitation of a motor by hand-made signals."""

    target: Signal  # position targets [rad]
    external_torque: Signal | None = None  # on the joint, in the `unit` of `streams`; None: 0
    jumps: bool = False  # whether targets change faster than any speed limit

    @property
    def is_bounded(self) -> bool:
        """Hand-made targets have any amplitude."""
        return False

    def streams(
        self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0
    ) -> Streams:
        """Streams of joints, sampled every ``dt`` [s]; ``unit`` of external torques [N·m]."""
        targets = np.stack([self.target(rng, steps, dt) for _ in joint_names], axis=1)

        if self.external_torque is None:
            return Streams(targets, np.zeros_like(targets))

        torques = [self.external_torque(rng, steps, dt) for _ in joint_names]
        return Streams(targets, unit * np.stack(torques, axis=1))

    def within(self, away: np.ndarray, amplitude: float, speed: float, dt: float) -> np.ndarray:
        """The same distances: hand-made signals are scaled, not bounded."""
        return away
