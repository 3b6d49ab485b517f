"""Which terms of `servo_terms` the data ask for: added one by one while held-out free runs get better.

Some motors are fitted on every second segment of their logs and judged on the others. In each round every term that is
still off is tried, from the best fits so far; the one with the least held-out loss stays if it is worth its price,

    m + 2·s/√n < 0 and m < log(1 - PRICE),   m, s: mean and deviation over n motors of log(loss with it / loss without)

where "without" has had as many steps of fitting.

In the end each term is left out again, and stays out if the others do without it at that price.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.servo_terms import FAINT, TERMS, in_order
from motorprior.identification.fleet_fit import encoded, initial_center, restart, weak_belief, with_motor
from motorprior.identification.motor_fit import WIDE, Belief, MotorFit
from motorprior.identification.window_runs import WindowRuns

PRICE = 0.04
"""Share of the held-out loss that a term must save."""
MOTORS = 8
"""Most motors that are fitted."""
_SURE = 1.0
"""Standard errors by which a term's gain is above 0."""
_RADII, _DRAWS = (0.7, 0.35, 0.2), 48
_STEPS = 6
_NEW_RADII, _NEW_DRAWS = (2.0, 0.5), 48
"""Random search of a new term's constants."""
_SETTLED, _SETTLINGS = 0.02, 6
"""A fit is settled when another turn lowers the losses by less than this share; most turns."""
_STREAM = 43


@dataclass(frozen=True)
class Selection:
    """Terms, the central motor's decoder outputs (P,) that they were chosen with, and what each saved.

    ``saved`` maps each term that was tried last in the final round, or chosen, to the share of the held-out loss that
    it saves (negative: that it costs).
    """

    terms: tuple[str, ...]
    center: np.ndarray
    saved: dict[str, float]


@dataclass(frozen=True)
class _State:
    """Fits (m, P) of motors with these terms, as decoder outputs; their losses (m,), fitted and held out."""

    terms: tuple[str, ...]
    raw: np.ndarray
    fitted: np.ndarray
    held_out: np.ndarray


def select_terms(
    network: LatentNetwork,
    runs: WindowRuns,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
) -> Selection:
    """Choose terms for the motors of ``runs``, of which a few are best enough.

    Args:
        network: with a residual that stays as it is.
        runs: logs.
        seed: of the searches.
        report: called with what was found, a line per round.
    """
    trial = _Trial(network, runs, np.random.default_rng([seed, _STREAM]))
    best, saved = trial.settled(trial.first()), {}
    while len(best.terms) < len(TERMS):
        best = trial.with_terms(best, best.terms)
        others = [trial.with_terms(best, (*best.terms, name)) for name in TERMS if name not in best.terms]
        shares = {_added(best, other): _saved(best, other) for other in others}
        found = max(others, key=lambda other: shares[_added(best, other)])
        name = _added(best, found)
        if not _worth(best, found):
            saved |= shares
            break
        saved[name] = shares[name]
        best = trial.settled(found)
        report(f"{name}: saves {100 * shares[name]:.0f} % of the held-out loss")
    for name in best.terms if len(best.terms) > 1 else ():
        less = trial.with_terms(best, tuple(other for other in best.terms if other != name))
        if not _worth(less, best):
            report(f"{name}: the others do without it")
            best, saved[name] = less, _saved(less, best)
    return Selection(best.terms, np.median(best.raw, axis=0), saved)


def _added(before: _State, after: _State) -> str:
    return next(name for name in after.terms if name not in before.terms)


def _saved(before: _State, after: _State) -> float:
    """Share of the held-out loss."""
    return 1.0 - float(np.exp(np.mean(np.log(after.held_out / before.held_out))))


def _worth(before: _State, after: _State) -> bool:
    gains = np.log(before.held_out / after.held_out)
    error = gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return _saved(before, after) > PRICE and bool(gains.mean() > _SURE * error)


class _Trial:
    """Fits on half of the windows, judged on the other half."""

    def __init__(self, network: LatentNetwork, runs: WindowRuns, rng: np.random.Generator):
        self._network, self._runs, self._rng = network, runs, rng
        held_out = held_out_windows(runs)
        self._seen, self._unseen = ~held_out, held_out

    def first(self) -> _State:
        """Without terms."""
        center = initial_center(())
        fit, belief = self._fit((), center)
        start = np.zeros((self._runs.num_motors, len(center)))
        z = fit.search(self._rng, start, belief, _RADII, _DRAWS)
        return self._state((), center + fit.polish(z, belief, 2 * _STEPS).z)

    def with_terms(self, before: _State, terms: tuple[str, ...]) -> _State:
        """Refitted with other terms; new constants are searched, the others begin where they were."""
        terms = in_order(terms)
        center, names = initial_center(terms), parameters_of(terms)
        old = {name: before.raw[:, row] for row, name in enumerate(parameters_of(before.terms))}
        start = np.stack([old[name] - center[row] if name in old else 0.0 * before.raw[:, 0]
                          for row, name in enumerate(names)], axis=1)  # fmt: skip
        fit, belief = self._fit(terms, center)
        new = np.array([name not in old for name in names])
        if new.any():
            faint = encoded(FAINT, terms) - center
            for radius in _NEW_RADII:
                draws = radius * self._rng.standard_normal((_NEW_DRAWS, len(names))) * new
                draws[0] = 0.0
                candidates = start[:, None] + draws
                candidates[:, 1] = np.where(new, faint, start)
                start = fit.best_of(candidates, belief)
        start = fit.polish(start, belief, _STEPS, WIDE).z
        return self._state(terms, center + fit.polish(start, belief, _STEPS).z)

    def settled(self, state: _State) -> _State:
        """Fitted on, with other motors' fits as further beginnings, until that brings nothing more."""
        for _ in range(_SETTLINGS):
            before, state = state, self._turn(state)
            if np.mean(np.log(before.fitted / state.fitted)) < _SETTLED:
                break
        return state

    def _turn(self, state: _State) -> _State:
        center = initial_center(state.terms)
        fit, belief = self._fit(state.terms, center)
        found = fit.polish(state.raw - center, belief, _STEPS)
        start = restart(self._rng, fit, found, belief, together=True)
        return self._state(state.terms, center + found.better(fit.polish(start, belief, _STEPS)).z)

    def _fit(self, terms: tuple[str, ...], center: np.ndarray) -> tuple[MotorFit, Belief]:
        network = with_motor(self._network, center, terms)
        return MotorFit(network, self._runs, self._seen), weak_belief(len(center))

    def _state(self, terms: tuple[str, ...], raw: np.ndarray) -> _State:
        center = initial_center(terms)
        network = with_motor(self._network, center, terms)
        losses = MotorFit(network, self._runs).window_losses(raw - center)
        return _State(terms, raw, losses[:, self._seen].mean(axis=1), losses[:, self._unseen].mean(axis=1))


def held_out_windows(runs: WindowRuns) -> np.ndarray:
    """(N,) whether a window is judged, not fitted: every second segment, or, of few segments, stretches of windows."""
    groups = runs.groups()
    if groups[-1] < 3:
        groups = np.arange(len(groups)) * 8 // len(groups)
    round_ = groups // 5  # presets have five excitations in turn: every one is in both halves
    return (groups + round_) % 2 == 1
