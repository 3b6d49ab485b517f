"""``motorprior transfer``: every policy in its own simulation and on the twin."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.artifacts import write_json, write_tensors
from motorprior.bench.fleet import Fleet
from motorprior.cli.console import bar, table
from motorprior.cli.motors import choice_from_json, load_robot_fleet
from motorprior.cli.stage import begin, description, finish, fleet_files, is_finished, read_figures
from motorprior.cli.walk import POLICY
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.engines import ENGINES, Engine, Scene
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.terrain import Terrain
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
    engine: Engine | None = None
    """Engine of a policy's own simulation; the one it was trained in, on its terrain, if not given. The twin is always
    in MuJoCo."""


def run_transfer(config: Transfer, show: bool = True) -> dict[str, float]:
    """Evaluate, or read what this very evaluation found; returns the figures.

    Raises:
        ArtifactError, ConfigError: a policy, its motors or the fleet cannot be used.
    """
    fleet = load_robot_fleet(config.fleet)
    files = [folder / POLICY for folder in config.walks]
    if not files:
        raise ConfigError("no policy given", remedy="give the folders of at least one walk")
    wanted = description("transfer", asdict(config), [*files, *fleet_files(config.fleet)])
    if not is_finished(config.out, wanted):
        walkers = [_walker(path, config.engine) for path in files]
        begin(config.out)
        _evaluate_all(config, walkers, fleet)
        finish(config.out, wanted)
    figures = read_figures(config.out / FIGURES)
    if show:
        show_transfer(figures)
    return figures


@dataclass(frozen=True)
class _Walker:
    """A policy, the name of what it was trained on, and the simulation it was trained in."""

    policy: Policy
    condition: str
    own: WalkSimulator | BackendSimulator


def _walker(path: Path, engine: Engine | None) -> _Walker:
    """Everything a policy needs; refuses what cannot run here.

    Raises:
        ArtifactError, ConfigError: a damaged policy, one of another control period, motors that are gone, or an engine
            that is not installed.
    """
    policy = Policy.load(path)
    policy.require_clock(spec.CONTROL_DT, path)
    choice = choice_from_json(policy.provenance.get("motors"), path)
    try:
        draw = choice.drawer()
    except (ArtifactError, ConfigError) as error:
        problem = f"the motors it was trained on: {error.problem}"
        where = path if error.where is None else f"{path}: {error.where}"
        raise type(error)(problem, where=where, remedy=error.remedy) from error
    trained_in, roughness = _ground(policy, path)
    engine = engine or trained_in
    terrain = Terrain(roughness if engine == "pybullet" else 0.0)
    scene = Scene(engine, draw, choice.physics_dt, WalkConfig(DURATION_STEPS), terrain)
    return _Walker(policy, choice.condition(), scene.simulator())


def _ground(policy: Policy, path: Path) -> tuple[Engine, float]:
    """Engine and roughness [m] that a policy was trained with; MuJoCo and flat if it does not say.

    Raises:
        ArtifactError: says something that cannot be.
    """
    engine, roughness = policy.provenance.get("engine", "mujoco"), policy.provenance.get("roughness", 0.0)
    if engine not in ENGINES or type(roughness) not in (int, float):
        raise ArtifactError(
            f"was trained in engine {engine!r} on roughness {roughness!r}", where=path,
            remedy=f"an engine is one of {ENGINES}, a roughness a number [m]; train again",
        )  # fmt: skip
    return engine, float(roughness)


def _evaluate_all(config: Transfer, walkers: list[_Walker], fleet: Fleet) -> None:
    rows: dict[str, list[dict[str, Walking]]] = {}
    traces: dict[str, np.ndarray] = {}
    twin = twin_simulator(fleet)
    with bar(f"transfer: {len(walkers)} policies x {DRAWS} draws", 2 * DRAWS * len(walkers)) as progress:
        for walker in walkers:
            own, own_trace = evaluate(walker.policy, walker.own, progress.advance)
            there, twin_trace = evaluate(walker.policy, twin, progress.advance)
            rows.setdefault(walker.condition, []).append({"own": own, "twin": there})
            traces.setdefault(f"own/{walker.condition}", own_trace)
            traces.setdefault(f"twin/{walker.condition}", twin_trace)
    write_json(config.out / FIGURES, _figures(rows))
    write_tensors(config.out / TRACES, traces, {"control_dt": spec.CONTROL_DT})


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
