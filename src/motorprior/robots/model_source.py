"""Where the MJCF of a robot comes from. It holds the robot alone: floor, contacts and clock are the simulation's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROTOR_GEAR_RATIO = 1e5
"""Turns of a rotor per turn of its joint. Of the real 36 the same reflected inertia would couple to the motion of
the link that carries the motor, by armature/36; MuJoCo's armature does not, so here it should not either: of a lightly
damped PD 1e3 leaves 0.3 mrad, 1e5 0.02 mrad, and 1e6 no less."""


@dataclass(frozen=True)
class GeneratedModel:
    """A model that this library writes.

    Attributes:
        mjcf: returns the MJCF text; its only body in the world is the robot's base.
        urdf: returns URDF text for engines that read no MJCF, from the joints' reflected inertias [kg·m²] and a shift
            of the base's centre of mass [m]; None where there is none.
    """

    mjcf: Callable[[], str]
    urdf: Callable[..., str] | None = None


@dataclass(frozen=True)
class ModelFile:
    """A user's MJCF or URDF.

    Attributes:
        files: of the model: its own first, then what it includes and the meshes that it names.
        sha256: digest of these files when the robot was loaded, see `model_files.files_digest`.
    """

    files: tuple[Path, ...]
    sha256: str

    @property
    def path(self) -> Path:
        """Of the model's own file."""
        return self.files[0]
