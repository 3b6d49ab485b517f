"""Benefit of adapting to a robot's motors: record, adapt, continue training and walk, on held-out robots.

    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop
    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop_wear \
        --robots 2 --wear none weak worn damaged --max-speed 0.75 --current --iterations 150 --further 50 --walks 2

Virtual Puppers in simulated time (`simulated_port.py`), otherwise the host's own code and the commands of
docs/hardware.md. For each robot 60 s of recording in the air, `logs import --hung`, `adapt`; for each seed of the
training, policies:
    before    trained on samples of the prior (`walk`), the same for all robots
    longer    that one, trained on (`walk --start`) on the prior for as long as `adapted`: the control
    adapted   `before`, trained on (`walk --start`) on the posterior of this robot's motors
    current   the same, but that the torque limits follow the gains (`MotorChoice.limit_follows_gain`), with --current
    advised   current where `adapt` calls motors weak, adapted elsewhere, with --current
Each walks straight on at `--max-speed`, `--walks` times for 10 s, with different sensor noise. Printed and written to
figures_SPEED_WEAR.json: for each pair of robot and seed the median path [m] (in straight segments of a second), the
median displacement from the start [m], and the share of walks that a fault ended; over the pairs the medians (of the
share the mean), and median, quartiles and sign of a policy's gain over the control; and for how many robots `adapt`
found an outlier. Of several kinds of wear, each one's figures are there, too, as WEAR/…. Finished trainings are kept;
with other `--iterations` or `--further`, give another `--out`.
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
from motorprior.exceptions import LogError, RobotFault
from motorprior.hardware import commands
from motorprior.hardware.settings import DeploySettings, Excitation, RecordSettings
from motorprior.locomotion.command import Commands
from motorprior.pipeline.adapt import POSTERIOR, Adapt, run_adapt
from motorprior.pipeline.log_import.raw_logs import LogsImport, import_logs
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.prior_file import load_prior
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.weak_motors import advice_on_weak_motors
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.ars import ArsConfig
from simulated_port import SimulatedPort, on_its_clock
from worn_motors import WEAR

ROBOT = load_robot(DEFAULT_ROBOT)
SECONDS = 10.0
EPISODE_STEPS, HOLD = 500, 1.25  # of trainings: control steps of an episode, and seconds that a command is held
CONTROL = "longer"


@dataclass(frozen=True)
class Outcome:
    """Attributes: path and displacement of a walk [m], fault (its kind, or None)."""

    path: float
    displacement: float
    fault: str | None


@dataclass(frozen=True)
class VirtualRobot:
    """A virtual robot: its number, how its motors have worn (a name in `WEAR`)."""

    number: int
    wear: str = "none"

    def folder(self, out: Path) -> Path:
        """Of what is recorded of it and trained for it."""
        return out / (f"robot_{self.number}" if self.wear == "none" else f"robot_{self.number}_{self.wear}")


def record(robot: VirtualRobot, folder: Path, seconds: float, excitation: Excitation) -> Path:
    """The robot's recording, hung, as a motor log."""
    log = folder / f"log_{excitation}_{seconds:g}" / "run.parquet"
    if not log.is_file():
        port = SimulatedPort(ROBOT, robot.number, hung=True, period=5, wear=WEAR[robot.wear])
        with on_its_clock(port):
            settings = RecordSettings(
                folder / f"recorded_{excitation}_{seconds:g}", excitation, seconds=seconds, yes=True
            )
            recorded = commands.run_record(ROBOT, port.port, settings, lambda _: None)
        import_logs(LogsImport((recorded,), log.parent, hung=True))
    return log


def deploy(robot: VirtualRobot, policy: Path, life: int, speed: float) -> Outcome:
    """One walk on the ground, straight ahead at this speed [m/s]."""
    port, fault = SimulatedPort(ROBOT, robot.number, life, wear=WEAR[robot.wear]), None
    start = port.body.live.position()
    with TemporaryDirectory() as out, on_its_clock(port):
        try:
            settings = DeploySettings(Path(out), seconds=SECONDS, forward=speed, yes=True)
            commands.run_deploy(ROBOT, policy, port.port, settings, lambda _: None)
        except RobotFault as error:
            fault = error.kind
    return Outcome(port.path, float(np.hypot(*(port.body.live.position() - start))), fault)


@dataclass(frozen=True)
class Training:
    """How to train: prior, seed, iterations from the beginning and further ones, highest commanded speed [m/s]."""

    prior: Path
    seed: int
    iterations: int
    further: int
    max_speed: float

    def policy(
        self, folder: Path, kind: str, posterior: Path | None = None, start: Path | None = None, current: bool = False
    ) -> Path:
        """A policy in ``folder``, trained on the prior or a posterior, anew or from ``start``; the file."""
        out = folder / f"{kind}_{self.max_speed:g}_{self.seed}"
        motors = MotorChoice(prior=self.prior, posterior=posterior, limit_follows_gain=current)
        iterations = self.iterations if start is None else self.further
        speeds, search = Commands(forward=(0.0, self.max_speed), hold=HOLD), ArsConfig(seed=self.seed)
        walk = Walk(out, motors, start, iterations, episode_steps=EPISODE_STEPS, commands=speeds, search=search)
        run_walk(walk, Lines(sys.stderr), out.name)
        return out / POLICY


def posterior_of(
    robot: VirtualRobot, folder: Path, prior: Path, seconds: float, excitation: Excitation = "varied"
) -> tuple[Path, bool]:
    """The posterior of the robot's motors, found from a recording, and whether one is unlike the prior's."""
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
    """Whether `adapt` advises that the torque limits follow the gains."""
    known = load_prior(prior, ROBOT)
    found = MotorPosterior.load(posterior, known)
    return bool(advice_on_weak_motors(known, found.joint_names, found.mean))


def walked(robot: VirtualRobot, policies: dict[str, Path], walks: int, speed: float) -> dict[str, list[Outcome]]:
    """Every policy on the robot, with the same noise for each."""
    return {name: [deploy(robot, policy, life, speed) for life in range(walks)] for name, policy in policies.items()}


def summary(walks: list[Outcome]) -> dict[str, float]:
    """Over the walks of one policy on one robot."""
    return {
        "path_m": float(np.median([one.path for one in walks])),
        "displacement_m": float(np.median([one.displacement for one in walks])),
        "fault_share": float(np.mean([one.fault is not None for one in walks])),
    }


def compared(pairs: Sequence[Mapping[str, list[Outcome]]]) -> dict[str, float]:
    """Over pairs of robot and seed: each policy's figures, and what it gains over the control on the same pair."""
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
    pairs: Sequence[tuple[VirtualRobot, Mapping[str, list[Outcome]]]], unlike: Mapping[VirtualRobot, bool]
) -> dict[str, float]:
    """The figures of all pairs, and those of each kind of wear as WEAR/… where there are several."""

    def figures(kinds: Sequence[str]) -> dict[str, float]:
        found = compared([walks for robot, walks in pairs if robot.wear in kinds])
        return found | {"robots_unlike_the_prior": float(sum(unlike[robot] for robot in unlike if robot.wear in kinds))}

    kinds = list(dict.fromkeys(robot.wear for robot in unlike))
    every = figures(kinds)
    if len(kinds) > 1:
        every |= {f"{wear}/{key}": value for wear in kinds for key, value in figures([wear]).items()}
    return every


def figures_file(out: Path, max_speed: float, wear: Sequence[str]) -> Path:
    """Path of the figures."""
    kinds = [] if list(wear) == ["none"] else wear
    return out / f"figures_{'_'.join([f'{max_speed:g}', *kinds])}.json"


def main() -> None:
    """Close the loop on every robot, with every seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prior", type=Path, required=True, help="prior of the robots' fleet")
    parser.add_argument("--out", type=Path, required=True, help="folder for everything")
    parser.add_argument("--robots", type=int, default=8, help="virtual Puppers, of every kind of wear")
    parser.add_argument("--seeds", type=int, default=3, help="of the training")
    parser.add_argument("--recorded", type=float, default=60.0, help="length of the recording [s]")
    parser.add_argument("--walks", type=int, default=5, help="of each policy on each robot")
    parser.add_argument("--iterations", type=int, default=200, help="of the training from the beginning")
    parser.add_argument("--further", type=int, default=100, help="of the training on")
    parser.add_argument("--max-speed", type=float, default=0.5, help="highest commanded speed [m/s]")
    parser.add_argument("--current", action="store_true", help="train on posteriors with limits that follow, too")
    parser.add_argument("--wear", nargs="+", choices=WEAR, default=["none"], help="of the robots' motors")
    given = parser.parse_args()
    kinds = list(dict.fromkeys(given.wear))
    robots = [VirtualRobot(number, wear) for wear in kinds for number in range(given.robots)]
    known = {each: posterior_of(each, each.folder(given.out), given.prior, given.recorded) for each in robots}
    weak = [each for each in robots if given.current and has_weak_motors(given.prior, known[each][0])]
    pairs, rows = [], []
    for seed in range(given.seeds):
        training = Training(given.prior, seed, given.iterations, given.further, given.max_speed)
        before = training.policy(given.out, "before")
        longer = training.policy(given.out, CONTROL, start=before)
        for robot in robots:
            folder, posterior = robot.folder(given.out), known[robot][0]
            policies = {"before": before, CONTROL: longer}
            policies["adapted"] = training.policy(folder, "adapted", posterior, before)
            if given.current:
                policies["current"] = training.policy(folder, "current", posterior, before, current=True)
            found = walked(robot, policies, given.walks, given.max_speed)
            if given.current:
                found["advised"] = found["current" if robot in weak else "adapted"]
            pairs.append((robot, found))
            for name, walks in found.items():
                words = (f"{key} {value:.2f}" for key, value in summary(walks).items())
                print(f"{folder.name} seed {seed} {name:8}", *words, flush=True)
                pair = {"robot": robot.number, "wear": robot.wear, "unlike": known[robot][1], "seed": seed}
                rows.append(pair | {"policy": name, "walks": [asdict(walk) for walk in walks]})
    figures = by_wear(pairs, {robot: unlike for robot, (_, unlike) in known.items()})
    text = json.dumps({"figures": figures, "pairs": rows}, indent=1)
    figures_file(given.out, given.max_speed, kinds).write_text(text + "\n")
    for key, value in figures.items():
        print(f"{key:40} {value:8.3f}")


if __name__ == "__main__":
    main()
