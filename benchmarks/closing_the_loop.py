r"""Benefit of adaptation to a robot's motors, on held-out virtual robots.

    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors --out runs/loop
    python benchmarks/closing_the_loop.py --prior runs/prior/prior.safetensors \
        --out runs/loop_wear --robots 2 --wear none weak worn damaged --max-speed 0.75 \
        --iterations 150 --further 50 --walks 2

Virtual Puppers in simulated time (`simulated_port.py`), with the host code and commands of
docs/hardware.md. For each robot: 60 s of recording in the air, `logs import --suspended`, `adapt`.
For each seed of the training, policies:
    before    trained on samples of the prior (`walk`), the same for all robots
    longer    the control: `before`, trained further on the prior (`walk --start`) as long as
              `adapted`
    adapted   `before`, trained further on the posterior of this robot's motors
    current   the same with torque limits that follow the gains (the option limit_follows_gain)
    advised   current if `adapt` reports weak motors, otherwise adapted
Each walks straight at `--max-speed`, `--walks` times for 10 s, with different sensor noise.
figures.json: for each pair of robot and seed the median path length [m] (in straight segments of a
second), the median displacement from the start [m], and the fraction of walks that end with a
fault; medians over the pairs (means of the fraction), median, quartiles and sign of the gain over
the control. Finished trainings are reused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

import motorprior as mp
from figures import PROGRESS, run_benchmark
from motorprior.actuator.physical import PhysicalMotors
from motorprior.actuator.registry import motor_text
from motorprior.exceptions import RobotFault
from motorprior.excitation.recording import MotionSettings
from motorprior.excitation.robot_targets import recorded_motion
from motorprior.hardware import runs
from motorprior.hardware.settings import DeploySettings, RunSettings
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import advice_on_weak_motors
from motorprior.priors.prior_file import load_prior
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.training import POLICY
from simulated_port import SimulatedPort, on_its_clock

ROBOT = mp.load_robot(DEFAULT_ROBOT)
HOLD = 1.25  # duration of a command in training [s]
CONTROL = "longer"
_STREAM = 0x3EA


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    prior: Path  # prior of the robots' fleet
    out: Path  # folder for everything
    robots: int = 8  # virtual Puppers per kind of wear
    seeds: int = 3  # seeds of the training
    walks: int = 5  # walks of each policy on each robot
    iterations: int = 200  # iterations of the first training
    further: int = 100  # additional iterations
    episode_steps: int = 500  # control steps per episode of a training
    directions: int = 16  # directions per iteration
    walk_seconds: float = 10.0  # duration of a walk [s]
    record_seconds: float = 60.0  # duration of a recording [s]
    max_speed: float = 0.5  # maximum commanded speed [m/s]
    wear: tuple[Literal["none", "weak", "worn", "damaged"], ...] = ("none",)  # wear of the motors


def with_wear(wear: str, motors: PhysicalMotors, number: int) -> PhysicalMotors:
    """The motors of virtual robot ``number`` with a kind of wear; the factors are assumptions."""
    if wear == "worn":  # gears with more backlash and friction
        return motors.scaled({"backlash": 3.0, "coulomb": 1.5, "load_friction": 1.5})
    strength = np.ones(len(motors))
    if wear == "weak":  # a smaller torque constant, as with hot or aged magnets
        strength[:] = 0.75
    elif wear == "damaged":  # one random motor per robot with much less torque
        strength[np.random.default_rng([_STREAM, number]).integers(len(motors))] = 0.4
    return motors.scaled(dict.fromkeys(("kp", "kd", "torque_limit", "stall_torque"), strength))


@dataclass(frozen=True)
class RobotCase:
    """A virtual robot."""

    number: int
    wear: str  # wear of the motors
    folder: Path  # folder of its recordings and policies
    posterior: Path  # file of the posterior of its motors
    is_weak: bool  # whether `adapt` reports weak motors


def record(folder: Path, number: int, wear: str, seconds: float) -> mp.MotorLog:
    """Recording of the suspended robot, with loads."""
    log = folder / "log" / "run.parquet"
    if not log.is_file():
        port = SimulatedPort(ROBOT, number, suspended=True, period=5, wear=partial(with_wear, wear))
        with on_its_clock(port):
            motion = recorded_motion(ROBOT, MotionSettings(seconds=seconds))
            recorded = runs.record(
                ROBOT,
                port.port,
                RunSettings(folder / "recorded", yes=True),
                motion.targets,
                lambda _: None,
                max_speed=motion.max_speed,
            )
        mp.write_log(log, mp.load_log(recorded, robot=ROBOT, suspended=True, progress=PROGRESS))
    return read_parquet(log)


def deploy(
    settings: Settings, robot: RobotCase, policy: Path, noise_seed: int
) -> tuple[float, float, bool]:
    """Path length [m], displacement [m] and fault of a straight walk on the ground."""
    port = SimulatedPort(ROBOT, robot.number, noise_seed, wear=partial(with_wear, robot.wear))
    fault = False
    start = port.body.position()
    with TemporaryDirectory() as out, on_its_clock(port):
        try:
            walk = DeploySettings(
                Path(out), seconds=settings.walk_seconds, forward=settings.max_speed, yes=True
            )
            runs.deploy(ROBOT, policy, port.port, walk, lambda _: None)
        except RobotFault:
            fault = True
    forward, left = port.body.position() - start
    return port.path, float(np.hypot(forward, left)), fault


def train(settings: Settings, seed: int, out: Path, motors: str, start: Path | None = None) -> Path:
    """File of a policy in the folder ``out``, trained on these motors, maybe from ``start`` on."""
    iterations = settings.iterations if start is None else settings.further
    speeds = Commands(forward=(0.0, settings.max_speed), hold=HOLD)
    mp.train_policy(
        ROBOT,
        motors,
        start=start,
        out=out,
        iterations=iterations,
        episode_steps=settings.episode_steps,
        commands=speeds,
        search=ArsConfig(
            num_directions=settings.directions,
            num_top_directions=min(settings.directions, ArsConfig.num_top_directions),
            seed=seed,
        ),
        name=out.name,
        progress=PROGRESS,
    )
    return out / POLICY


def policies_of(settings: Settings, seed: int, robot: RobotCase) -> dict[str, Path]:
    """Files of all policies for a robot; those of the prior are the same for all robots."""
    prior = motor_text("prior", file=settings.prior)
    posterior = partial(motor_text, "posterior", file=robot.posterior, prior=settings.prior)
    trained_on_prior = train(settings, seed, settings.out / f"before_{seed}", prior)

    def continued(out: Path, motors: str) -> Path:
        return train(settings, seed, out, motors, trained_on_prior)

    return {
        "before": trained_on_prior,
        CONTROL: continued(settings.out / f"{CONTROL}_{seed}", prior),
        "adapted": continued(robot.folder / f"adapted_{seed}", posterior(limit_follows_gain=False)),
        "current": continued(robot.folder / f"current_{seed}", posterior(limit_follows_gain=True)),
    }


def adapted_robot(settings: Settings, number: int, wear: str) -> RobotCase:
    """Record a robot, and adapt the prior to its motors."""
    folder = settings.out / f"robot_{number}_{wear}"
    prior = load_prior(settings.prior, ROBOT)
    log = record(folder, number, wear, settings.record_seconds)
    posterior = mp.adapt(prior, log, allow_outliers=True, progress=PROGRESS)
    path = folder / "posterior" / "posterior.safetensors"
    posterior.save(path)
    is_weak = bool(advice_on_weak_motors(prior, posterior.joint_names, posterior.mean))
    return RobotCase(number, wear, folder, path, is_weak)


def compared(pairs: Sequence[Mapping[str, np.ndarray]]) -> dict[str, float]:
    """Figures of every policy over pairs of robot and seed, and its gain over the control.

    The gain is over the control on the same pair. A pair has (walks, 3) results of `deploy` by
    policy.
    """
    figures = {"pairs": float(len(pairs))}
    for name in pairs[0]:
        figures[f"{name}/fault_share"] = float(np.mean([walks[name][:, 2] for walks in pairs]))
        for column, key in enumerate(("path_m", "displacement_m")):
            lengths = np.array([np.median(walks[name][:, column]) for walks in pairs])
            control = np.array([np.median(walks[CONTROL][:, column]) for walks in pairs])
            figures[f"{name}/{key}"] = float(np.median(lengths))
            if name == CONTROL:
                continue
            for share in (25, 50, 75):
                gain = float(np.percentile(lengths - control, share))
                figures[f"{name}/gain_{key}/p{share}"] = gain
            pairs_better = float(np.count_nonzero(lengths > control))
            figures[f"{name}/gain_{key}/pairs_better"] = pairs_better
    return figures


def compute(settings: Settings) -> dict[str, float]:
    """Figures of all robots and seeds."""
    robots = []
    for wear in settings.wear:
        for number in range(settings.robots):
            robots.append(adapted_robot(settings, number, wear))

    pairs = []
    for seed in range(settings.seeds):
        for robot in robots:
            results: dict[str, np.ndarray] = {}
            for name, policy in policies_of(settings, seed, robot).items():
                walks = [
                    deploy(settings, robot, policy, number) for number in range(settings.walks)
                ]
                results[name] = np.array(walks)
            results["advised"] = results["current" if robot.is_weak else "adapted"]
            pairs.append(results)
    return compared(pairs)


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
