"""Films of walking policies, MuJoCo's viewer, and measures of the walks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motorprior.bench.fleet import load_robot_fleet
from motorprior.bounds import require_number, require_seed
from motorprior.commands.walk import POLICY, SEED_FOLDER
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands, Timetable
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.rendering import show
from motorprior.simulation.scene import Episode, WalkConfig, require_walks
from motorprior.simulation.training import other_weight
from motorprior.stage import locked, write_results
from motorprior.studies.compare import TrainedPolicy, evaluation_seed, run_walks, with_shared_speeds
from motorprior.studies.environments import HARD, NOISY, twin_scene
from motorprior.studies.gait_quality import gait_quality, quality_results

_TITLES = {"own": "in its training simulation", "twin": "on the twin", "hard": "on a hard twin"}
_STEADY_ONLY = ("speed_error", "heading_deg_per_m", "lateral_share")  # measures that need one constant command


@dataclass(frozen=True)
class Play:
    """Render policies as a film and measure their walks. Several walks are shown one below the other."""

    policies: tuple[Path, ...]
    """Policies, or folders that `motorprior walk` wrote."""
    out: Path = Path("runs/play")
    """Folder for the film (play.mp4 or play.gif) and figures.json."""
    environment: Literal["own", "twin", "hard"] = "own"
    """own: the training simulation of each policy; twin: held-out motors with 1 kHz physics and noise; hard: the twin
    on unknown ground, with an unknown load and pushes."""
    forward: float | None = None
    """Commanded speed [m/s]; the largest in the range of all policies if not given."""
    yaw_rate: float = 0.0
    """Commanded yaw rate, to the left [rad/s]."""
    schedule: Path | None = None
    """CSV file with the columns time_s, forward_m_s and yaw_rate_rad_s; a row is in force until the next. It replaces
    the two commands above."""
    seconds: float = 10.0
    """Duration [s]."""
    seed: int = 0
    """Seed of the motors, the same for all policies on the twin."""
    viewer: bool = False
    """Also open MuJoCo's viewer, which needs a screen."""
    fleet: str | None = None
    """Fleet of the twin; the robot's own if not given."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_play(config: Play, progress: Progress = SILENT) -> tuple[Path, Results]:
    """Path of the film, and measures of the walks; opens the viewer if requested.

    Raises:
        SimulationFault: a walk diverged.
        ArtifactError, ConfigError, LogError: a policy, its motors, the schedule or the fleet cannot be used; a command
            is outside the range of the robot or of a policy's training; the viewer finds no screen.
    """
    from motorprior.report import film  # here, since it imports matplotlib

    robot = load_robot(config.robot)
    policies = {name: TrainedPolicy.load(path, robot) for name, path in _names(config.policies).items()}
    require_number("seconds", config.seconds, positive=True)
    require_seed(config.seed)
    commands = _commands(config, with_shared_speeds(robot, (each.policy for each in policies.values())))
    steps = max(1, round(config.seconds / robot.control_dt))
    commanded = commands.schedule(robot, evaluation_seed(config.seed), steps)
    episodes: dict[str, Episode] = {}
    with locked(config.out):
        with progress.start(f"walk: {len(policies)} x {config.seconds:g} s", len(policies)) as task:
            for name, trained in policies.items():
                if line := other_weight(trained.policy, robot):
                    progress.note(line)
                episodes[name] = _walk(config, trained, WalkConfig(steps, commands=commands))
                require_walks([episodes[name]], name)
                task.advance()
        results = sum((_measured(config, robot, *named, commanded) for named in episodes.items()), Results())
        write_results(config.out, results)
        titled = {f"{name}, {_TITLES[config.environment]}": episode for name, episode in episodes.items()}
        path = film.write_film(config.out, robot, titled, commanded, progress)
    if config.viewer:
        show(robot, [film.until_end(episode.trace, steps) for episode in episodes.values()], robot.control_dt)
    return path, results


def _names(policies: Iterable[Path]) -> dict[str, Path]:
    """Files of the policies by the names of their folders, or of files with other names than policy.safetensors."""
    names: dict[str, Path] = {}
    for given in policies:
        path = given / POLICY if given.is_dir() else given
        seeds = sorted(given.glob(f"{SEED_FOLDER.format('*')}/{POLICY}"))
        if seeds and not path.is_file():
            problem = f"no {POLICY} in it, but in {len(seeds)} folders of seeds below"
            raise ConfigError(problem, where=given, remedy=f"give some of these: {seeds[0]}")
        name = path.resolve().parent.name if path.name == POLICY else path.stem
        names[name if name not in names else f"{name} ({len(names) + 1})"] = path
    return names


def _commands(config: Play, robot: Robot) -> Commands | Timetable:
    """Commands of the walk; errors for one outside the robot's range, an unreadable schedule, or both given."""
    size = robot.require_legs()
    if config.schedule is None:
        forward = size.forward[1] if config.forward is None else config.forward
        require_number("forward", forward, *size.forward)
        require_number("yaw_rate", config.yaw_rate, -size.yaw_rate, size.yaw_rate)
        return Commands.steady(forward, config.yaw_rate)
    if config.forward is not None or config.yaw_rate:
        problem = "schedule replaces forward and yaw_rate"
        raise ConfigError(problem, remedy="give one or the other", argument="schedule")
    return Timetable.read(config.schedule, robot)


def _walk(config: Play, trained: TrainedPolicy, walk: WalkConfig) -> Episode:
    if config.environment == "own":
        scene = trained.scene(walk)
    else:
        randomization = {"twin": NOISY, "hard": HARD}[config.environment]
        walk = replace(walk, randomization=randomization, gait=trained.policy.gait)
        scene = twin_scene(trained.robot, load_robot_fleet(trained.robot, config.fleet), walk)
    return run_walks(scene, trained.policy.arrays, [config.seed])[0]


def _measured(config: Play, robot: Robot, name: str, episode: Episode, commanded: np.ndarray) -> Results:
    """Measures of a walk with commands (steps, 2).

    With changing commands, measures that need a constant one are replaced by speed_off, `Episode.speed_error` [m/s].
    """
    speeds = commanded[:, 0]
    slowest = 0.0 if speeds.min() < 0.0 < speeds.max() else float(speeds[np.abs(speeds).argmin()])
    quality = gait_quality(robot, episode, slowest, float(commanded[0, 1]), len(commanded))
    measured = quality_results(quality, name, config.environment)
    if (commanded == commanded[0]).all():
        return measured
    rows = [row for row in measured if row.quantity not in _STEADY_ONLY]
    return Results.of([*rows, Result("speed_off", "m/s", episode.speed_error, name, config.environment)])
