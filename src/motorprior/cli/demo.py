"""``motorprior demo``: the whole mission, small: logs, prior, simulation, policies, transfer, report."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from motorprior.artifacts import read_json, write_json
from motorprior.bounds import require_count, require_seed
from motorprior.cli.bench import Bench, require_bench_size, run_bench
from motorprior.cli.console import CONSOLE
from motorprior.cli.identify import PRIOR, Identify, run_identify
from motorprior.cli.motors import MotorChoice, load_robot_fleet
from motorprior.cli.replay import Replay, read_logs, run_replay, show_replay
from motorprior.cli.report import PAGE, SETTINGS, build_report
from motorprior.cli.run_record import RunRecord
from motorprior.cli.speed import measure_speed
from motorprior.cli.stage import MARKER, begin
from motorprior.cli.transfer import Transfer, run_transfer, show_transfer
from motorprior.cli.validate import GAINS_FILE, TUNED, Validate, run_validate, show_fidelity
from motorprior.cli.walk import Walk, run_walk
from motorprior.exceptions import ArtifactError
from motorprior.robots.pupper_v2 import spec
from motorprior.search.ars import ArsConfig

FIGURES = "figures.json"
SEEDS_APART = 1000
"""Policies of different demo seeds share no search seed."""
PRESETS = ("rollout", "paper", "one_network", "paper_wide")


@dataclass(frozen=True)
class Demo:
    """The whole story, small: minutes on two cores. A rerun continues where it stopped."""

    out: Path = Path("runs/demo")
    """Run folder: every artefact, figures.json and report.html."""
    fleet: str = "pupper_v2"
    """Population of motors: pupper_v2, mixed, or a path to a .toml file."""
    logs: Path | None = None
    """Folder with real Pupper v2 logs (jietan/puppersim, puppersim/data/system_id) to replay."""
    seed: int = 0
    """Seed of everything."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor and preset."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    iterations: int = 200
    """ARS iterations per policy."""
    seeds: int = 2
    """Policies per condition."""
    workers: int = 2
    """Threads for walking; the result does not depend on it."""


def run_demo(config: Demo, started: float | None = None) -> None:
    """Run every stage that is not finished, and the report after each.

    Args:
        config: settings.
        started: time.monotonic() when the process began, so that ``seconds`` counts imports; now if not given.

    Raises:
        MotorPriorError: a stage cannot run; what is finished stays.
    """
    require_count("motors", config.motors, spec.NUM_JOINTS)
    require_bench_size(config.motors, config.bench_steps, "bench_steps")
    for name in ("iterations", "seeds", "workers"):
        require_count(name, getattr(config, name))
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    require_seed(config.seed)
    load_robot_fleet(config.fleet)
    if config.logs is not None:
        read_logs(config.logs)
    begin(config.out)
    settings = asdict(config) | {"out": str(config.out), "logs": None if config.logs is None else str(config.logs)}
    _write_if_changed(config.out / SETTINGS, settings)
    (config.out / FIGURES).unlink(missing_ok=True)  # or the page would show those of other settings
    clock = RunRecord(
        config.out, {name: settings[name] for name in settings if name not in ("out", "workers")}, started
    )
    figures: dict[str, float] = {}
    _learn(config, clock)
    figures |= clock.run("validate", lambda: _validate(config))
    _page_so_far(config.out)
    if config.logs is not None:
        figures |= clock.run("replay", lambda: _replay(config, config.logs))
    figures |= clock.run("speed", lambda: _speed(config))
    walks = [clock.run(f"walk {walk.out.name}", lambda walk=walk: _walk(walk)) for walk in _walks(config)]
    figures |= clock.run("transfer", lambda: _transfer(config, walks))
    write_json(config.out / FIGURES, figures)  # the page shows some
    page = build_report(config.out)
    figures["seconds"] = clock.total()
    write_json(config.out / FIGURES, figures)
    _say(config, figures, page)


def _learn(config: Demo, clock: RunRecord) -> None:
    out = config.out
    for preset in ("rollout", "paper"):
        bench = Bench(out / "bench" / preset, config.fleet, preset, config.motors, config.bench_steps, config.seed)
        clock.run(f"bench {preset}", lambda bench=bench: run_bench(bench))
    _page_so_far(out)
    CONSOLE.print(f"first pictures: {out / PAGE}")
    for preset in PRESETS:
        folder = "paper" if preset == "paper" else "rollout"
        identify = Identify(out / "bench" / folder, out / "priors" / preset, preset, config.seed, config.adam_steps)
        clock.run(f"identify {preset}", lambda identify=identify: run_identify(identify))
        if preset == "rollout":  # the one that the page shows
            _page_so_far(out)


def _page_so_far(out: Path) -> None:
    """The page anew, unless it is younger than settings and every finished stage: drawing it takes seconds."""
    page, sources = out / PAGE, (out / SETTINGS, *out.rglob(MARKER))
    if not page.is_file() or page.stat().st_mtime_ns < max(path.stat().st_mtime_ns for path in sources):
        build_report(out)


def _write_if_changed(path: Path, value: Any) -> None:
    """JSON; its time stays that of the last change."""
    with suppress(ArtifactError):  # none there, or a damaged one
        if read_json(path) == value:
            return
    write_json(path, value)


def _validate(config: Demo) -> dict[str, float]:
    priors = tuple(config.out / "priors" / preset / PRIOR for preset in PRESETS)
    return run_validate(Validate(priors, config.out / "validate", config.seed, held_out=False), show=False)


def _replay(config: Demo, logs: Path | None) -> dict[str, float]:
    assert logs is not None
    prior = config.out / "priors" / "rollout" / PRIOR
    return run_replay(Replay(logs, prior, config.out / "replay", config.fleet, seed=config.seed), show=False)


def _speed(config: Demo) -> dict[str, float]:
    return measure_speed(config.out / "priors" / "rollout" / PRIOR, config.fleet)


def _walks(config: Demo) -> list[Walk]:
    """Every policy to train, first seeds first."""
    gains, tuned = (read_json(config.out / "validate" / name) for name in (GAINS_FILE, TUNED))
    conditions = {
        "rollout": MotorChoice("prior", config.out / "priors" / "rollout" / PRIOR, fleet=config.fleet),
        "oracle": MotorChoice("fleet", fleet=config.fleet),
        "ideal_pd": MotorChoice("pd", fleet=config.fleet, **gains),
        "tuned_pd": MotorChoice("pd", fleet=config.fleet, **tuned),
        "paper": MotorChoice("prior", config.out / "priors" / "paper" / PRIOR, fleet=config.fleet),
    }
    return [
        Walk(
            config.out / "walk" / f"{name}_{seed}",
            motors,
            iterations=config.iterations,
            search=ArsConfig(seed=SEEDS_APART * config.seed + seed),
            workers=config.workers,
        )
        for seed in range(config.seeds)
        for name, motors in conditions.items()
    ]


def _walk(walk: Walk) -> Path:
    run_walk(walk, f"walk on {walk.out.name}")
    return walk.out


def _transfer(config: Demo, walks: list[Path]) -> dict[str, float]:
    return run_transfer(Transfer(tuple(sorted(walks)), config.out / "transfer", config.fleet), show=False)


def _say(config: Demo, figures: dict[str, Any], page: Path) -> None:
    show_fidelity(figures)
    if config.logs is not None:
        show_replay(figures)
    else:
        print(
            "No real logs were given. Those of a Pupper v2 are in jietan/puppersim, puppersim/data/system_id "
            "(Apache-2.0): --logs FOLDER"
        )
    show_transfer(figures)
    print(f"{100 * figures['mj_step_share/rollout']:.1f} % of an episode's time is inside mj_step.")
    print(f"Report: {page}   Figures: {config.out / FIGURES}   {figures['seconds']:.0f} s")
