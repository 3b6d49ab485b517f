"""Watch policies walk: a film, MuJoCo's own window, and how well they walk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.timetable import Timetable
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import locked, write_results
from motorprior.pipeline.transfer_study.transfer import policy_for, training_scene
from motorprior.pipeline.walking.walk import POLICY
from motorprior.pipeline.walking.walk_seeds import SEED_FOLDER
from motorprior.pipeline.watching.schedule_file import read_schedule
from motorprior.pipeline.watching.walk_film import Look, Scenes, write_film
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.rollout import Episode, WalkConfig
from motorprior.simulation.viewer import require_screen, show
from motorprior.transfer.gait_quality import completed, gait_quality, headings, quality_results, steps_along_heading
from motorprior.transfer.twin import EVALUATION_SEED, HARD, NOISY, twin_of, with_shared_speeds

Place = Literal["own", "twin", "hard"]
LONGEST, MOST_POLICIES = 600.0, 4
"""Of a walk [s]; more than four policies would be too small to see."""
_PLACES = {"own": "on its own motors", "twin": "on the twin", "hard": "on a hard twin"}
_OF_ONE_COMMAND = ("speed_error", "heading_deg_per_m", "lateral_share")
_TWINS = {"twin": NOISY, "hard": HARD}


@dataclass(frozen=True)
class Play:
    """Watch policies walk: a film, and how well they walk. Several are shown one under the other."""

    policies: tuple[Path, ...]
    """Policies, or folders that `motorprior walk` wrote."""
    out: Path = Path("runs/play")
    """Folder for the film (play.mp4 or play.gif) and figures.json."""
    place: Place = "own"
    """The motors: those that each policy was trained on, or the twin, unseen motors with 1 kHz physics and noise, or
    that on unknown ground, with an unknown load and pushes."""
    forward: float | None = None
    """Commanded speed [m/s]; the fastest that all policies may be told if not given."""
    yaw_rate: float = 0.0
    """Commanded yaw rate, to the left [rad/s]."""
    schedule: Path | None = None
    """CSV file with the columns time_s, forward_m_s and yaw_rate_rad_s; a row holds until the next. In place of the
    two commands above."""
    seconds: float = 10.0
    """Duration [s]."""
    seed: int = 0
    """Draws the motors, the same for all policies on the twin."""
    film: Look = "auto"
    """Rendered by OpenGL, drawn as lines without it, or rendered where that works."""
    viewer: bool = False
    """Also open MuJoCo's window, which needs a screen."""
    fleet: str | None = None
    """The twin's fleet; the robot's own if not given."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


@dataclass(frozen=True)
class Played:
    """Attributes: film, its path; results, the measures of every walk; steps, control steps that each walked."""

    film: Path
    results: Results
    steps: dict[str, int]


def run_play(config: Play, progress: Progress = SILENT) -> Played:
    """Walk, measure, write the film, and open the window if it is asked for.

    Raises:
        ArtifactError, ConfigError: a policy, its motors, the schedule or the fleet cannot be used; a command beyond the
            robot's usual speeds and those of a policy's training; no OpenGL where a rendered film is asked for; no
            screen where a window is.
    """
    with locked(config.out):
        played, walks = _play(config, progress)
    if config.viewer:
        robot = load_robot(config.robot)
        show(robot, walks, robot.control_dt)
    return played


def _play(config: Play, progress: Progress) -> tuple[Played, list[np.ndarray]]:
    """What `run_play` returns, and the walks."""
    robot = load_robot(config.robot)
    names = _names(config.policies)
    require_number("seconds", config.seconds, robot.control_dt, LONGEST)
    require_seed(config.seed)
    if config.viewer:
        require_screen()
    commands, steps = (
        commands_of(config, with_shared_speeds(robot, map(Policy.load, names.values()))),
        max(1, round(config.seconds / robot.control_dt)),
    )
    episodes: dict[str, Episode] = {}
    with progress.start(f"walk: {len(names)} x {config.seconds:g} s", len(names)) as task:
        for name, path in names.items():
            episodes[name] = _walk(config, robot, path, WalkConfig(steps, commands=commands))
            task.advance()
    told = commands.schedule(robot, EVALUATION_SEED + config.seed, steps)
    results = sum((_measured(config, robot, name, each, told) for name, each in episodes.items()), Results())
    write_results(config.out, results)
    walks = [_held(episode.trace, steps) for episode in episodes.values()]
    titles = [f"{name}, {_PLACES[config.place]}" for name in names]
    notes = [_notes(robot, episode, walk, told) for episode, walk in zip(episodes.values(), walks, strict=True)]
    film = write_film(config.out, Scenes(config.robot, walks, titles, notes), config.film, progress)
    return Played(film, results, {name: episode.steps for name, episode in episodes.items()}), walks


def commands_of(config: Play, robot: Robot) -> Commands | Timetable:
    """What the robot is told to do.

    Raises:
        ConfigError: a command that it is not built for, a file that is no schedule, or two ways to command at once.
    """
    size = robot.require_legs()
    if config.schedule is not None:
        if config.forward is not None or config.yaw_rate:
            raise ConfigError(
                "schedule is in place of forward and yaw_rate", remedy="give the one or the other", argument="schedule"
            )
        return read_schedule(config.schedule, robot)
    forward = size.forward[1] if config.forward is None else config.forward
    require_number("forward", forward, *size.forward)
    require_number("yaw_rate", config.yaw_rate, -size.yaw_rate, size.yaw_rate)
    return Commands.steady(forward, config.yaw_rate)


def _names(policies: Sequence[Path]) -> dict[str, Path]:
    """Files of the policies by the names of their folders, or of themselves where they have other names than usual."""
    files = [_policy_in(path) if path.is_dir() else path for path in policies]
    if not 1 <= len(files) <= MOST_POLICIES:
        raise ConfigError(f"{len(files)} policies given", remedy=f"give 1 to {MOST_POLICIES}")
    names: dict[str, Path] = {}
    for path in files:
        name = path.resolve().parent.name if path.name == POLICY else path.stem
        names[name if name not in names else f"{name} ({len(names) + 1})"] = path
    return names


def _policy_in(folder: Path) -> Path:
    """The policy of a training.

    Raises:
        ConfigError: the folder is of several trainings: names those that are finished.
    """
    seeds = sorted(folder.glob(f"{SEED_FOLDER.format('*')}/{POLICY}"))
    if seeds and not (folder / POLICY).is_file():
        raise ConfigError(
            f"no {POLICY} in it, but in {len(seeds)} folders of seeds below", where=folder,
            remedy=f"give one of these, or up to {MOST_POLICIES}: {seeds[0]}",
        )  # fmt: skip
    return folder / POLICY


def _walk(config: Play, robot: Robot, path: Path, walk: WalkConfig) -> Episode:
    policy, robot = policy_for(path, robot)
    if config.place in _TWINS:  # whatever motors it was trained on, which it may not name
        other = replace(walk, randomization=_TWINS[config.place], gait=policy.gait)
        simulator = twin_of(robot, load_robot_fleet(robot, config.fleet), other)
    else:
        simulator = training_scene(policy, path, robot, walk).simulator()
    try:
        return simulator.run(policy.arrays(), EVALUATION_SEED + config.seed, trace=True)
    finally:
        simulator.close()


def _measured(config: Play, robot: Robot, name: str, episode: Episode, told: np.ndarray) -> Results:
    """The measures of a walk; where commands change, there is no path to keep to, and a speed at every moment.

    speed_off is then the mean of |filtered speed - command in force|, see `Episode.speed_error` [m/s]. An engine that
    tells no torques (PyBullet) leaves one measure.
    """
    if not len(episode.motion):
        upright = float(completed(episode, len(told)))
        return Results.of([Result("upright", "1", upright, name, config.place)])
    quality = gait_quality(robot, episode, _slowest(told[:, 0]), float(told[0, 1]), len(told))
    measured = quality_results(quality, robot, name, config.place)
    if (told == told[0]).all():
        return measured
    rows = [row for row in measured if row.quantity not in _OF_ONE_COMMAND]
    if math.isfinite(episode.speed_error):
        rows.append(Result("speed_off", "m/s", episode.speed_error, name, config.place))
    return Results.of(rows)


def _slowest(forward: np.ndarray) -> float:
    """The commanded speed nearest to standing [m/s]; 0 where the direction changes."""
    return 0.0 if forward.min() < 0.0 < forward.max() else float(forward[np.abs(forward).argmin()])


def _held(trace: np.ndarray, steps: int) -> np.ndarray:
    """The trace, and its last frame until the end."""
    return np.concatenate([trace, np.repeat(trace[-1:], steps - len(trace), axis=0)])


def _notes(robot: Robot, episode: Episode, walk: np.ndarray, told: np.ndarray) -> list[str]:
    """Per frame: time, way along its own heading and command; where it fell, since when."""
    notes, dt = [], robot.control_dt
    ways = np.append(0.0, np.cumsum(steps_along_heading(walk[:, :2], headings(walk))))
    for step, (way, (forward, turn)) in enumerate(zip(ways, told, strict=True)):
        state = f"told {forward:z.2f} m/s, {turn:z.2f} rad/s" if step < episode.steps else "fell"
        notes.append(f"{step * dt:.2f} s    {way:z.2f} m    {state}")
    return notes
