"""What it is worth to know a robot's motors: record, adapt, train on, and walk again, on robots nobody trained on.

    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop

Virtual Puppers in simulated time (`simulated_port.py`), otherwise the host's own code and the commands of
docs/hardware.md, for each robot: 60 s of recording in the air, `logs import --hung`, `adapt`, and three policies:
    before      trained on samples of the prior (`walk`), the same for all robots
    trained_on  the same one, trained on (`walk --start`) on the posterior of this robot's motors
    anew        trained on that posterior from the beginning
Each walks `--walks` times for 10 s, with other noise of the sensors. Printed and written to figures_SPEED_SEED.json,
for each robot and policy, and over all robots: median way in 10 s [m], in straight pieces of a second, which a curve does
not shorten; median displacement from the start [m], which it does; share of the walks that ended in a fault. Finished
parts are kept.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np

from motorprior.cli.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.cli.logs import LogsImport, run_logs_import
from motorprior.cli.motors import MotorChoice
from motorprior.cli.walk import POLICY, Walk, run_walk
from motorprior.exceptions import LogError, RobotFault
from motorprior.hardware import commands
from motorprior.hardware.settings import DeploySettings, RecordSettings
from motorprior.locomotion.task import TaskWeights
from motorprior.search.ars import ArsConfig
from simulated_port import SimulatedPort, on_its_clock

SECONDS, RECORDED = 10.0, 60.0


@dataclass(frozen=True)
class Outcome:
    """Attributes: path and displacement of a walk [m], fault (its kind, or None)."""

    path: float
    displacement: float
    fault: str | None


def record(number: int, folder: Path) -> Path:
    """The recording of robot ``number``, hung, as a motor log."""
    log = folder / "log" / "run.parquet"
    if not log.is_file():
        port = SimulatedPort(number, hung=True, rate=200)
        with on_its_clock(port), mock.patch.object(commands, "SerialLink", lambda _: port):
            recorded = commands.run_record(
                port.port, RecordSettings(folder / "recorded", seconds=RECORDED, yes=True), print
            )
        run_logs_import(LogsImport((recorded,), log.parent, hung=True))
    return log


def deploy(number: int, policy: Path, life: int) -> Outcome:
    """One walk on the ground."""
    port, fault = SimulatedPort(number, life), None
    start = port.body.live.position()
    with TemporaryDirectory() as out, on_its_clock(port), mock.patch.object(commands, "SerialLink", lambda _: port):
        try:
            commands.run_deploy(policy, port.port, DeploySettings(Path(out), seconds=SECONDS, yes=True), lambda _: None)
        except RobotFault as error:
            fault = error.kind
    return Outcome(port.body.path, float(np.hypot(*(port.body.live.position() - start))), fault)


@dataclass(frozen=True)
class Training:
    """How to train: prior, seed, iterations from the beginning and further ones, speed that earns most [m/s]."""

    prior: Path
    seed: int
    iterations: int
    further: int
    max_speed: float

    def policy(self, folder: Path, kind: str, posterior: Path | None = None, start: Path | None = None) -> Path:
        """A policy in ``folder``; the file."""
        out = folder / f"{kind}_{self.max_speed:g}_{self.seed}"
        motors, iterations = (
            MotorChoice(prior=self.prior, posterior=posterior),
            self.further if start else self.iterations,
        )
        task, search = TaskWeights(max_speed=self.max_speed), ArsConfig(seed=self.seed)
        run_walk(Walk(out, motors, start, iterations, search=search, task=task), name=out.name)
        return out / POLICY


def policies(number: int, folder: Path, training: Training, before: Path, anew: bool) -> dict[str, Path]:
    """The policies of a robot."""
    posterior = folder / "adapted" / POSTERIOR
    log = record(number, folder)
    try:
        run_adapt(Adapt(training.prior, log, posterior.parent))
    except LogError as error:
        print(f"robot {number}: {error}")
        run_adapt(Adapt(training.prior, log, posterior.parent, anyway=True))
    found = {"before": before, "trained_on": training.policy(folder, "trained_on", posterior, before)}
    return found | ({"anew": training.policy(folder, "anew", posterior)} if anew else {})


def summary(walks: list[Outcome]) -> dict[str, float]:
    """Medians over walks."""
    return {
        "path_m": float(np.median([one.path for one in walks])),
        "displacement_m": float(np.median([one.displacement for one in walks])),
        "fault_share": float(np.mean([one.fault is not None for one in walks])),
    }


def compared(found: dict[int, dict[str, list[Outcome]]]) -> dict[str, float]:
    """Over robots: the median of their medians, and of how each robot's policy differs from ``before`` on it."""
    figures: dict[str, float] = {}
    for name in next(iter(found.values())):
        per_robot = [summary(walks[name]) for walks in found.values()]
        for key in ("path_m", "displacement_m"):
            values = np.array([one[key] for one in per_robot])
            figures[f"{name}/{key}"] = float(np.median(values))
            if name != "before":
                gain = values - np.array([summary(walks["before"])[key] for walks in found.values()])
                figures |= {
                    f"{name}/gain_{key}": float(np.median(gain)),
                    f"{name}/gain_{key}/least": float(gain.min()),
                    f"{name}/gain_{key}/most": float(gain.max()),
                    f"{name}/robots_better_{key}": float(np.count_nonzero(gain > 0)),
                }
        figures[f"{name}/fault_share"] = float(np.mean([one["fault_share"] for one in per_robot]))
    return figures


def main() -> None:
    """Close the loop on every robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prior", type=Path, required=True, help="prior of the robots' fleet")
    parser.add_argument("--out", type=Path, required=True, help="folder for everything")
    parser.add_argument("--robots", type=int, default=8, help="virtual Puppers")
    parser.add_argument("--walks", type=int, default=5, help="of each policy on each robot")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--iterations", type=int, default=200, help="of the training from the beginning")
    parser.add_argument("--further", type=int, default=100, help="of the training on")
    parser.add_argument("--max-speed", type=float, default=0.5, help="speed beyond which nothing more is earned [m/s]")
    parser.add_argument("--anew", action="store_true", help="train from the beginning on every posterior, too")
    given = parser.parse_args()
    training = Training(given.prior, given.seed, given.iterations, given.further, given.max_speed)
    before = training.policy(given.out, "before")
    found: dict[int, dict[str, list[Outcome]]] = {}
    for number in range(given.robots):
        folder = given.out / f"robot_{number}"
        choices = policies(number, folder, training, before, given.anew)
        found[number] = {
            name: [deploy(number, policy, life) for life in range(given.walks)] for name, policy in choices.items()
        }
        for name, walks in found[number].items():
            print(
                f"robot {number} {name:10}",
                *(f"{key} {value:.2f}" for key, value in summary(walks).items()),
                flush=True,
            )
    walks = {
        number: {name: [asdict(walk) for walk in walks] for name, walks in by.items()} for number, by in found.items()
    }
    figures = compared(found)
    (given.out / f"figures_{given.max_speed:g}_{given.seed}.json").write_text(
        json.dumps({"figures": figures, "walks": walks}, indent=1) + "\n"
    )
    for key, value in figures.items():
        print(f"{key:32} {value:8.3f}")


if __name__ == "__main__":
    main()
