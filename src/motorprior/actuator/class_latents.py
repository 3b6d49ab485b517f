"""Latents of each class of joints in a motor prior: a motor of class c has z ~ N(mean of c, I).

`robots.joint_classes` defines the classes. The standard deviation between motors is pooled over the
classes. A motor of a class that was never recorded has z ~ N(0, unseen_std²), whose variance
includes that between classes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ClassLatents:
    """C classes of a prior with M training motors and Z latents."""

    names: tuple[str, ...]  # C names
    of_motors: tuple[str, ...]  # class of each training motor
    mean: np.ndarray  # (C, Z)
    unseen_std: np.ndarray  # (Z,) at least 1

    @classmethod
    def with_one_class(cls, motors: int, latents: int, name: str = "") -> "ClassLatents":
        """One class: z ~ N(0, I) for every joint."""
        return cls(
            names=(name,),
            of_motors=(name,) * motors,
            mean=np.zeros((1, latents)),
            unseen_std=np.ones(latents),
        )

    def mean_and_std(self, classes: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of z, (J, Z) each, of new motors of these classes.

        A prior with a single class has it for all motors.
        """
        rows = [self.names.index(name) if name in self.names else -1 for name in classes]
        if len(self.names) == 1:
            rows = [0] * len(rows)
        is_recorded = np.array(rows)[:, None] >= 0
        mean = np.where(is_recorded, self.mean[rows], 0.0)
        std = np.where(is_recorded, 1.0, self.unseen_std)
        return mean, std

    def rows_of(self, name: str) -> np.ndarray:
        """Indices of the training motors of a class; all of them if the class has none."""
        rows = np.flatnonzero([motor_class == name for motor_class in self.of_motors])
        return rows if len(rows) else np.arange(len(self.of_motors))
