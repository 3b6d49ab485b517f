"""``motorprior transfer``: every policy in its own simulation and on the twin."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.artifacts import read_json, write_json, write_tensors
from motorprior.bench.fleet import Fleet, load_fleet
from motorprior.cli.console import bar, table
from motorprior.cli.motors import MotorChoice, choice_from_json
from motorprior.cli.stage import begin, description, finish, fleet_files, is_finished
from motorprior.cli.walk import POLICY
from motorprior.exceptions import ConfigError
from motorprior.locomotion.policy import Policy
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world import WorldConfig
from motorprior.transfer.study import DRAWS, Walking, evaluate
from motorprior.transfer.twin import DURATION_STEPS, twin_simulator

FIGURES, TRACES = "figures.json", "traces.safetensors"
CONDITIONS = ("ideal_pd", "tuned_pd", "paper", "rollout", "oracle")
_MEASURES = ("speed", "upright", "drift")


@dataclass(frozen=True)
class Transfer:
    """Run policies where they were trained, and on the twin: unseen physical motors, 1 kHz, encoder noise."""

    walks: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that `motorprior walk` wrote; several seeds of one actuator model are averaged."""
    out: Path
    """Folder for figures.json and the gaits of the report."""
    fleet: str = "pupper_v2"
    """The twin's fleet."""


def run_transfer(config: Transfer, show: bool = True) -> dict[str, float]:
    """Evaluate, or read what this very evaluation found; returns the figures.

    Raises:
        ArtifactError, ConfigError: a policy, its motors or the fleet cannot be used.
    """
    fleet = load_fleet(config.fleet)
    files = [folder / POLICY for folder in config.walks]
    if not files:
        raise ConfigError("no policy given", remedy="give the folders of at least one walk")
    wanted = description("transfer", asdict(config), [*files, *fleet_files(config.fleet)])
    if not is_finished(config.out, wanted):
        policies = [(Policy.load(path), path) for path in files]
        choices = [choice_from_json(policy.provenance.get("motors"), str(path)) for policy, path in policies]
        begin(config.out)
        _evaluate_all(config, [policy for policy, _ in policies], choices, fleet)
        finish(config.out, wanted)
    figures = read_json(config.out / FIGURES)
    if show:
        show_transfer(figures)
    return figures


def _evaluate_all(config: Transfer, policies: list[Policy], choices: list[MotorChoice], fleet: Fleet) -> None:
    rows: dict[str, list[dict[str, Walking]]] = {}
    traces: dict[str, np.ndarray] = {}
    twin = twin_simulator(fleet)
    with bar(f"transfer: {len(policies)} policies x {DRAWS} draws", 2 * DRAWS * len(policies)) as progress:
        for policy, choice in zip(policies, choices, strict=True):
            condition = choice.condition()
            own, own_trace = evaluate(policy, _own_simulator(policy, choice), progress.advance)
            there, twin_trace = evaluate(policy, twin, progress.advance)
            rows.setdefault(condition, []).append({"own": own, "twin": there})
            traces.setdefault(f"own/{condition}", own_trace)
            traces.setdefault(f"twin/{condition}", twin_trace)
    write_json(config.out / FIGURES, _figures(rows))
    write_tensors(config.out / TRACES, traces, {"control_dt": policies[0].control_dt})


def _own_simulator(policy: Policy, choice: MotorChoice) -> WalkSimulator:
    return WalkSimulator(choice.drawer(), WorldConfig(physics_dt=choice.physics_dt), WalkConfig(DURATION_STEPS))


def _figures(rows: dict[str, list[dict[str, Walking]]]) -> dict[str, float]:
    """Means over seeds, and every seed's own figure."""
    figures: dict[str, float] = {}
    for condition, seeds in rows.items():
        for place in ("own", "twin"):
            for measure in _MEASURES:
                values = [getattr(seed[place], measure) for seed in seeds]
                figures[f"{place}_{measure}/{condition}"] = float(np.mean(values))
                for number, value in enumerate(values):
                    figures[f"{place}_{measure}/{condition}/seed_{number}"] = float(value)
    return figures


def conditions_in(figures: dict[str, float]) -> list[str]:
    """Conditions of a transfer table, in the usual order."""
    found = {name.split("/")[1] for name in figures if name.startswith("twin_speed/")}
    return [name for name in CONDITIONS if name in found] + sorted(found - set(CONDITIONS))


def transfer_rows(figures: dict[str, float]) -> list[list[str]]:
    """The transfer table as text: own simulation, then twin."""
    rows = []
    for name in conditions_in(figures):
        seeds = sum(key.startswith(f"twin_speed/{name}/seed_") for key in figures)
        cells = [name, str(seeds)]
        for place in ("own", "twin"):
            cells.append(f"{figures[f'{place}_speed/{name}']:.2f}")
            cells.append(f"{100 * figures[f'{place}_upright/{name}']:.0f} %")
            cells.append(f"{figures[f'{place}_drift/{name}']:.2f}")
        rows.append(cells)
    return rows


TRANSFER_COLUMNS = (
    "trained on", "seeds", "own: speed [m/s]", "upright", "drift in 5 s [m]",
    "twin: speed [m/s]", "upright", "drift in 5 s [m]",
)  # fmt: skip


def show_transfer(figures: dict[str, float]) -> None:
    """The transfer table on the terminal."""
    table(f"Transfer, {DRAWS} motor draws x 5 s, means over seeds", TRANSFER_COLUMNS, transfer_rows(figures))
