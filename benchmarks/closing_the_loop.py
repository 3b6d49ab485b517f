"""Benefit of adaptation to a robot's motors: record, adapt, continue training and walk, on held-out virtual robots.

    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop
    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop_wear \
        --robots 2 --wear none weak worn damaged --max-speed 0.75 --current --iterations 150 --further 50 --walks 2

Virtual Puppers in simulated time (`simulated_port.py`), with the host code and commands of docs/hardware.md. For each
robot: 60 s of recording in the air, `logs import --suspended`, `adapt`. For each seed of the training, policies:
    before    trained on samples of the prior (`walk`), the same for all robots
    longer    the control: `before`, trained further on the prior (`walk --start`) for as long as `adapted`
    adapted   `before`, trained further on the posterior of this robot's motors
    current   the same with torque limits that follow the gains (the option limit_follows_gain), with --current
    advised   current if `adapt` reports weak motors, otherwise adapted, with --current
Each walks straight at `--max-speed`, `--walks` times for 10 s, with different sensor noise. Printed and written to
figures_SPEED_WEAR.json: for each pair of robot and seed the median path length [m] (in straight segments of a second),
the median displacement from the start [m], and the fraction of walks that end with a fault; medians over the pairs
(means of the fraction), median, quartiles and sign of the gain over the control; and the number of robots with an
outlier. With several kinds of wear also the figures of each, as WEAR/…. Finished trainings are reused: for other
`--iterations` or `--further`, give another `--out`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.registry import motor_text
from motorprior.commands.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.exceptions import LogError, RobotFault
from motorprior.hardware import commands
from motorprior.hardware.settings import DeploySettings, RecordSettings
from motorprior.identification.adapt import advice_on_weak_motors
from motorprior.identification.prior_file import load_prior
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.progress import Lines
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from simulated_port import SimulatedPort, on_its_clock
from worn_motors import WEAR

ROBOT = load_robot(DEFAULT_ROBOT)
SECONDS = 10.0
EPISODE_STEPS, HOLD = 500, 1.25  # of training: control steps per episode, duration of a command [s]
CONTROL = "longer"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a walk."""

    path: float  # length [m]
    displacement: float  # [m]
    fault: str | None  # kind


@dataclass(frozen=True)
class RobotCase:
    """A virtual robot."""

    number: int
    wear: str = "none"  # a name in `WEAR`

    def folder(self, out: Path) -> Path:
        """Folder of its recordings and policies."""
        return out / (f"robot_{self.number}" if self.wear == "none" else f"robot_{self.number}_{self.wear}")


def record(robot: RobotCase, folder: Path, seconds: float, excitation: str) -> Path:
    """Recording of the suspended robot, as a motor log."""
    log = folder / f"log_{excitation}_{seconds:g}" / "run.parquet"
    if not log.is_file():
        port = SimulatedPort(ROBOT, robot.number, suspended=True, period=5, wear=WEAR[robot.wear])
        with on_its_clock(port):
            out = folder / f"recorded_{excitation}_{seconds:g}"
            settings = RecordSettings(out, excitation=excitation, seconds=seconds, yes=True)
            recorded = commands.run_record(ROBOT, port.port, settings, lambda _: None)
        import_logs(LogsImport((recorded,), log.parent, suspended=True))
    return log


def deploy(robot: RobotCase, policy: Path, noise_seed: int, speed: float) -> Outcome:
    """One walk on the ground, straight at this speed [m/s]."""
    port, fault = SimulatedPort(ROBOT, robot.number, noise_seed, wear=WEAR[robot.wear]), None
    start = port.body.position()
    with TemporaryDirectory() as out, on_its_clock(port):
        try:
            settings = DeploySettings(Path(out), seconds=SECONDS, forward=speed, yes=True)
            commands.run_deploy(ROBOT, policy, port.port, settings, lambda _: None)
        except RobotFault as error:
            fault = error.kind
    return Outcome(port.path, float(np.hypot(*(port.body.position() - start))), fault)


@dataclass(frozen=True)
class Training:
    """Settings of the training."""

    prior: Path
    seed: int
    iterations: int  # of the first training
    further: int  # additional iterations
    max_speed: float  # maximum commanded speed [m/s]

    def policy(
        self, folder: Path, kind: str, posterior: Path | None = None, start: Path | None = None, current: bool = False
    ) -> Path:
        """File of a policy in ``folder``, trained on the prior or a posterior, from scratch or from ``start``."""
        out = folder / f"{kind}_{self.max_speed:g}_{self.seed}"
        motors = motor_text("prior", file=self.prior)
        if posterior is not None:
            motors = motor_text("posterior", file=posterior, prior=self.prior, limit_follows_gain=current)
        iterations = self.iterations if start is None else self.further
        speeds, search = Commands(forward=(0.0, self.max_speed), hold=HOLD), ArsConfig(seed=self.seed)
        walk = Walk(
            out=out, motors=motors, start=start, iterations=iterations, episode_steps=EPISODE_STEPS, commands=speeds,
            search=search,
        )  # fmt: skip
        run_walk(walk, Lines(sys.stderr), out.name)
        return out / POLICY


def posterior_of(
    robot: RobotCase, folder: Path, prior: Path, seconds: float, excitation: str = "varied"
) -> tuple[Path, bool]:
    """The posterior of the robot's motors from a recording, and whether a motor is an outlier."""
    posterior = folder / f"posterior_{excitation}_{seconds:g}" / POSTERIOR
    log = record(robot, folder, seconds, excitation)
    try:
        run_adapt(Adapt(prior, log, posterior.parent), Lines(sys.stderr))
    except LogError as error:
        print(f"{folder.name}: {error}")
        run_adapt(Adapt(prior, log, posterior.parent, anyway=True), Lines(sys.stderr))
        return posterior, True
    return posterior, False


def has_weak_motors(prior: Path, posterior: Path) -> bool:
    """Whether `adapt` recommends torque limits that follow the gains."""
    loaded = load_prior(prior, ROBOT)
    found = MotorPosterior.load(posterior, loaded)
    return bool(advice_on_weak_motors(loaded, found.joint_names, found.mean))


def summary(walks: list[Outcome]) -> dict[str, float]:
    """Figures of the walks of one policy on one robot."""
    return {
        "path_m": float(np.median([one.path for one in walks])),
        "displacement_m": float(np.median([one.displacement for one in walks])),
        "fault_share": float(np.mean([one.fault is not None for one in walks])),
    }


def compared(pairs: Sequence[Mapping[str, list[Outcome]]]) -> dict[str, float]:
    """Figures of every policy over pairs of robot and seed, and its gain over the control on the same pair."""
    figures: dict[str, float] = {"pairs": float(len(pairs))}
    for name in pairs[0]:
        of_name, of_control = ([summary(pair[which]) for pair in pairs] for which in (name, CONTROL))
        figures[f"{name}/fault_share"] = float(np.mean([one["fault_share"] for one in of_name]))
        for key in ("path_m", "displacement_m"):
            figures[f"{name}/{key}"] = float(np.median([one[key] for one in of_name]))
            if name != CONTROL:
                gain = [one[key] - other[key] for one, other in zip(of_name, of_control, strict=True)]
                for share, value in zip((25, 50, 75), np.percentile(gain, (25, 50, 75)), strict=True):
                    figures[f"{name}/gain_{key}/p{share}"] = float(value)
                figures[f"{name}/gain_{key}/pairs_better"] = float(np.count_nonzero(np.array(gain) > 0.0))
    return figures


def by_wear(
    pairs: Sequence[tuple[RobotCase, Mapping[str, list[Outcome]]]], outliers: Mapping[RobotCase, bool]
) -> dict[str, float]:
    """Figures of all pairs, and of each kind of wear as WEAR/… if there are several."""

    def figures(kinds: Sequence[str]) -> dict[str, float]:
        found = compared([walks for robot, walks in pairs if robot.wear in kinds])
        return found | {
            "robots_unlike_the_prior": float(sum(outliers[robot] for robot in outliers if robot.wear in kinds))
        }

    kinds = list(dict.fromkeys(robot.wear for robot in outliers))
    every = figures(kinds)
    if len(kinds) > 1:
        every |= {f"{wear}/{key}": value for wear in kinds for key, value in figures([wear]).items()}
    return every


def main() -> None:
    """Run all robots and seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prior", type=Path, required=True, help="prior of the robots' fleet")
    parser.add_argument("--out", type=Path, required=True, help="folder for everything")
    parser.add_argument("--robots", type=int, default=8, help="virtual Puppers per kind of wear")
    parser.add_argument("--seeds", type=int, default=3, help="seeds of the training")
    parser.add_argument("--recorded", type=float, default=60.0, help="length of the recording [s]")
    parser.add_argument("--walks", type=int, default=5, help="walks of each policy on each robot")
    parser.add_argument("--iterations", type=int, default=200, help="iterations of the first training")
    parser.add_argument("--further", type=int, default=100, help="additional iterations")
    parser.add_argument("--max-speed", type=float, default=0.5, help="maximum commanded speed [m/s]")
    parser.add_argument("--current", action="store_true", help="also train with torque limits that follow the gains")
    parser.add_argument("--wear", nargs="+", choices=WEAR, default=["none"], help="wear of the motors")
    given = parser.parse_args()
    kinds = list(dict.fromkeys(given.wear))
    robots = [RobotCase(number, wear) for wear in kinds for number in range(given.robots)]
    posteriors = {each: posterior_of(each, each.folder(given.out), given.prior, given.recorded) for each in robots}
    weak = [each for each in robots if given.current and has_weak_motors(given.prior, posteriors[each][0])]
    pairs, rows = [], []
    for seed in range(given.seeds):
        training = Training(given.prior, seed, given.iterations, given.further, given.max_speed)
        before = training.policy(given.out, "before")
        longer = training.policy(given.out, CONTROL, start=before)
        for robot in robots:
            folder, posterior = robot.folder(given.out), posteriors[robot][0]
            policies = {"before": before, CONTROL: longer}
            policies["adapted"] = training.policy(folder, "adapted", posterior, before)
            if given.current:
                policies["current"] = training.policy(folder, "current", posterior, before, current=True)
            found = {
                name: [deploy(robot, policy, noise_seed, given.max_speed) for noise_seed in range(given.walks)]
                for name, policy in policies.items()
            }
            if given.current:
                found["advised"] = found["current" if robot in weak else "adapted"]
            pairs.append((robot, found))
            for name, walks in found.items():
                values = (f"{key} {value:.2f}" for key, value in summary(walks).items())
                print(f"{folder.name} seed {seed} {name:8}", *values, flush=True)
                pair = {"robot": robot.number, "wear": robot.wear, "unlike": posteriors[robot][1], "seed": seed}
                rows.append(pair | {"policy": name, "walks": [asdict(walk) for walk in walks]})
    figures = by_wear(pairs, {robot: outlier for robot, (_, outlier) in posteriors.items()})
    text = json.dumps({"figures": figures, "pairs": rows}, indent=1)
    name = "_".join([f"{given.max_speed:g}", *([] if kinds == ["none"] else kinds)])
    (given.out / f"figures_{name}.json").write_text(text + "\n")
    for key, value in figures.items():
        print(f"{key:40} {value:8.3f}")


if __name__ == "__main__":
    main()
