"""Classes of joints in a motor prior: a unit of class c has z ~ N(mean of c, I).

The spread between units is pooled over the classes. A class that was never recorded has z ~ N(0,
unseen_std²), whose variance includes that between classes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class JointClasses:
    """C classes of a prior with M training motors and Z latents."""

    names: tuple[str, ...]  # C names
    of_motors: tuple[str, ...]  # class of each training motor
    mean: np.ndarray  # (C, Z)
    unseen_std: np.ndarray  # (Z,) at least 1

    @classmethod
    def one(cls, motors: int, latents: int, name: str = "") -> "JointClasses":
        """One class: z ~ N(0, I) for every joint."""
        return cls((name,), (name,) * motors, np.zeros((1, latents)), np.ones(latents))

    def mean_and_std(self, classes: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of z, (J, Z) each, of new units of these classes; a single class serves all."""
        rows = [self.names.index(name) if name in self.names else -1 for name in classes]
        if len(self.names) == 1:
            rows = [0] * len(rows)
        is_known = np.array(rows)[:, None] >= 0
        mean = np.where(is_known, self.mean[rows], 0.0)
        return mean, np.where(is_known, 1.0, self.unseen_std)

    def rows_of(self, name: str) -> np.ndarray:
        """Training motors of a class; all of them if it has none."""
        rows = np.flatnonzero([name == each for each in self.of_motors])
        return rows if len(rows) else np.arange(len(self.of_motors))
