"""Fit of the constants of all motors, with the optional terms that reduce the loss.

Terms are selected on some motors and some rows (`term_selection`), where a gain may be chance. So all motors are fitted
with them and with the logged ones alone, and the others are kept if they save LEAST_GAIN of the loss of all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import chain, repeat

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.optional_terms import TERMS
from motorprior.exceptions import MotorPriorError
from motorprior.identification.networks.descent import CHUNK, Checkpoints, Report
from motorprior.identification.physics.fleet_fit import STAGES, FleetFit, fit_fleet
from motorprior.identification.physics.term_selection import MOTORS, ROWS, WINDOWS, Selection, select_terms
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.residual import LEAST_GAIN, without_residual
from motorprior.identification.training_data.windows import TrainingData, subsampled

_UNSTABLE = 1e6  # loss of a motor whose simulation diverges
_STAGE = CHUNK  # work of one stage of a fit, in Adam steps
WORK = _STAGE * (len(TERMS) + STAGES)  # sum of the numbers that `fit_physics` reports


@dataclass(frozen=True)
class Physics:
    """The fit of all motors, the share of the loss that each term saved, and terms that were rejected on all motors."""

    fit: FleetFit
    saved: dict[str, float]
    left_out: tuple[str, ...]

    def arrays(self) -> dict[str, np.ndarray]:
        """For a checkpoint."""
        has, left_out = (
            np.array([name in names for name in TERMS], np.float64) for names in (self.fit.terms, self.left_out)
        )
        tried = np.array([self.saved.get(name, np.nan) for name in TERMS])
        fitted = {"center": self.fit.center, "offsets": self.fit.offsets, "fitted": self.fit.loss}
        return {"has_term": has, "left_out": left_out, "saved": tried} | fitted

    @classmethod
    def from_arrays(cls, kept: dict[str, np.ndarray]) -> Physics:
        """From a checkpoint."""
        terms, left_out = (
            tuple(name for name, has in zip(TERMS, kept[key], strict=True) if has) for key in ("has_term", "left_out")
        )
        saved = {name: float(share) for name, share in zip(TERMS, kept["saved"], strict=True) if np.isfinite(share)}
        return cls(FleetFit(kept["center"], kept["offsets"], kept["fitted"], terms), saved, left_out)


def fit_physics(
    data: TrainingData, preset: Preset, runs: WindowRuns, seed: int, report: Report, checkpoints: Checkpoints | None
) -> Physics:
    """The fit, or that of an interrupted training; raises `MotorPriorError` if no motor can be simulated."""
    kept = checkpoints.load() if checkpoints is not None else None
    if kept is not None:
        report(WORK, "constants were fitted")
        return Physics.from_arrays(kept)
    bare = without_residual(data.scales, preset)
    chosen = _terms(bare, data, preset, seed, report)
    fit = partial(fit_fleet, bare, runs, together=preset.physics_first == "together", seed=seed)
    found = fit(chosen.terms, report=lambda: report(_STAGE, "constants"))
    optional = tuple(name for name in chosen.terms if name not in preset.stated_terms)
    without = fit(preset.stated_terms, report=lambda: report(0, "without terms")) if optional else found
    pays = not optional or found.loss.mean() <= (1.0 - LEAST_GAIN) * without.loss.mean()
    found, left_out = (found, ()) if pays else (without, optional)
    if not found.loss.max() < _UNSTABLE:
        raise MotorPriorError(
            f"no motor can be simulated that moves like joint {int(found.loss.argmax())} of the log",
            remedy="check the log with `motorprior logs check`",
        )
    physics = Physics(found, chosen.saved, left_out)
    if checkpoints is not None:
        checkpoints.save(physics.arrays())
    return physics


def _terms(bare: LatentNetwork, data: TrainingData, preset: Preset, seed: int, report: Report) -> Selection:
    if not preset.tries_terms:
        report(_STAGE * len(TERMS), "no terms are tried")
        return Selection(preset.stated_terms, {})
    motors = len(data.series)
    some = np.unique(np.linspace(0, motors - 1, min(MOTORS, motors)).astype(int))
    part = subsampled(data, preset, max(ROWS, WINDOWS * preset.window))
    few = WindowRuns(part, preset, some, beat=lambda: report(0, ""))
    work = chain(repeat(_STAGE, len(TERMS)), repeat(0))  # the number of further rounds is unknown
    chosen = select_terms(bare, few, seed, lambda text: report(next(work), text))
    if not chosen.saved:
        report(_STAGE * len(TERMS), "the log is too short to choose terms by")
    return chosen
