"""Tidy table of the walks of a study: environment, training condition, seed, draw, measures."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_text
from motorprior.exceptions import ArtifactError
from motorprior.files import read_text

KEYS = ("place", "condition", "seed", "draw")
NUMBERS = frozenset({"seed", "draw"})
MAX_TABLE = 100_000_000  # bytes
OWN = "own"  # a policy's training simulation
OWN_FOREIGN = "own_foreign"  # likewise, of policies for out-of-family motors


@dataclass(frozen=True)
class WalkRow:
    """One walk.

    Attributes:
        place: environment, or OWN.
        condition: of the training.
        seed: of the training.
        draw: number of the sample of motors and conditions, the same for every policy in an environment.
        measures: name -> number; NaN if undefined.
    """

    place: str
    condition: str
    seed: int
    draw: int
    measures: Mapping[str, float]


@dataclass(frozen=True)
class WalkTable:
    """Walks in order of measurement."""

    walks: tuple[WalkRow, ...] = ()

    @classmethod
    def of(cls, walks: Iterable[WalkRow]) -> WalkTable:
        """Table of walks."""
        return cls(tuple(walks))

    def __len__(self) -> int:
        return len(self.walks)

    def distinct(self, key: str) -> list:
        """Distinct values of one of KEYS: names in row order, numbers sorted."""
        found = list(dict.fromkeys(getattr(walk, key) for walk in self.walks))
        return sorted(found) if key in NUMBERS else found

    def measures(self) -> list[str]:
        """Names of all measures."""
        return list(dict.fromkeys(name for walk in self.walks for name in walk.measures))

    def at(self, place: str, condition: str | None = None) -> WalkTable:
        """Walks in an environment, of one condition if given."""
        return WalkTable.of(walk for walk in self.walks if walk.place == place and condition in (None, walk.condition))

    def scores(self, place: str, condition: str, measure: str) -> np.ndarray:
        """(seeds, draws) of one measure, both sorted.

        Raises:
            ArtifactError: not one walk per seed and draw.
        """
        found = self.at(place, condition)
        seeds, draws = found.distinct("seed"), found.distinct("draw")
        values = {(walk.seed, walk.draw): walk.measures.get(measure, np.nan) for walk in found.walks}
        if len(values) != len(found) or len(values) != len(seeds) * len(draws):
            raise ArtifactError(
                f"{condition} in {place}: {len(found)} walks, not one for each of {len(seeds)} seeds and "
                f"{len(draws)} draws", remedy=f"delete watched/{condition}_* in the study's folder and run it again",
            )  # fmt: skip
        return np.array([[values[seed, draw] for draw in draws] for seed in seeds]).reshape(len(seeds), len(draws))

    def save(self, path: Path) -> None:
        """Write a CSV file, one row per walk; undefined measures are empty."""
        names, text = self.measures(), io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*KEYS, *names])
        for walk in self.walks:
            numbers = (walk.measures.get(name, np.nan) for name in names)
            cells = ["" if np.isnan(number) else f"{number:.6g}" for number in numbers]
            writer.writerow([*(getattr(walk, key) for key in KEYS), *cells])
        write_text(path, text.getvalue())

    @classmethod
    def load(cls, path: Path) -> WalkTable:
        """Read what `save` wrote.

        Raises:
            ArtifactError: missing, or damaged; names the row.
        """
        rows = csv.DictReader(io.StringIO(read_text(path, MAX_TABLE), newline=""))
        walks = []
        for number, row in enumerate(rows, start=2):
            try:
                place, condition, seed, draw = (row.pop(key) for key in KEYS)
                measures = {name: float(text or "nan") for name, text in row.items()}
                walks.append(WalkRow(place, condition, int(seed), int(draw), measures))
            except (KeyError, TypeError, ValueError) as error:
                remedy = "delete its folder and run the study again"
                raise ArtifactError(f"row {number}: {error}", where=path, remedy=remedy) from error
        return cls(tuple(walks))
