"""The chapter of the report about trainings: their learning curves, and what was trained."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_json
from motorprior.locomotion.policy import Policy
from motorprior.report.page import Section, picture
from motorprior.report.plots_study import learning_curves
from motorprior.simulation.randomization import Randomization


def learning(folders: Mapping[str, Sequence[Path]]) -> list[Section]:
    """Learning curves of trainings, and the kinds of policies that they trained.

    Args:
        folders: of the seeds of each kind of training, by its name, each with policy.safetensors and curve.json.

    Raises:
        ArtifactError: a file that is damaged.
    """
    curves: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    policies = [Policy.load(folder / "policy.safetensors") for seeds in folders.values() for folder in seeds]
    for name, seeds in folders.items():
        for folder in seeds:
            points = read_json(folder / "curve.json")
            iteration, returns = (np.array([point[key] for point in points]) for key in ("iteration", "mean_return"))
            curves.setdefault(name, []).append((iteration, returns))
    shown = picture(learning_curves(curves), "Mean return of the perturbed policies per iteration.", "learning curves")
    body = [_varied(policies), "Returns are of each condition's own simulation and do not compare across conditions."]
    if any(name.startswith("paper") for name in folders):
        body.append("Where the simulated robot falls at once, as on the paper's motors, there is little to learn from.")
    return [Section("Learning to walk", f"Augmented random search on {_shapes(policies)}.", tuple(body), (shown,))]


def _shapes(policies: Iterable[Policy]) -> str:
    """What the policies are, each kind once."""
    units = sorted({len(policy.hidden) for policy in policies})
    shapes = [f"a policy with {each} hidden units" if each else "a linear policy" for each in units]
    gaits = dict.fromkeys(f"a {policy.gait}" for policy in policies)
    return f"{' or '.join(shapes)} that modulates {' or '.join(gaits)}"


def _varied(policies: Iterable[Policy]) -> str:
    """What differed between episodes besides motors and commands."""
    neutral = Randomization().as_json()
    kinds = {tuple(name for name, value in _of(policy).items() if value != neutral[name]) for policy in policies}
    if len(kinds) > 1:
        return "Besides motors and commands, not the same varied in all trainings; the names say what differs."
    names = ", ".join(name.replace("_", " ") for name in next(iter(kinds), ()))
    return f"Besides motors and commands, training varied {names or 'nothing'}."


def _of(policy: Policy) -> dict[str, object]:
    """What its training varied; nothing of which it does not say so."""
    neutral = Randomization().as_json()
    said = policy.provenance.get("randomization")
    return {name: (said if isinstance(said, dict) else {}).get(name, value) for name, value in neutral.items()}
