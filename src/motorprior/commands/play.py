"""Films of walking policies, MuJoCo's viewer, and the quality of the walks."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from motorprior.actuator.fleet import load_robot_fleet
from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.progress import SILENT, Progress
from motorprior.results import Results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.rendering import show
from motorprior.simulation.scene import Episode, WalkConfig, require_walks
from motorprior.simulation.training import POLICY, SEED_FOLDER, weight_warning
from motorprior.stage import locked
from motorprior.studies.compare import TrainedPolicy, run_walks, with_shared_speeds
from motorprior.studies.environments import HARD, NOISY, held_out_scene
from motorprior.studies.gait_quality import gait_quality, quality_results

_TITLES = {"own": "in its training simulation", "twin": "on the twin", "hard": "on a hard twin"}


@dataclass(frozen=True)
class Play:
    """Render walks of policies as a film and measure them."""

    policies: tuple[Path, ...]
    """Policies, or folders that `motorprior walk` wrote."""
    out: Path = Path("runs/play")
    """Folder for the film (play.gif, and play.mp4 with the extra video) and figures.json."""
    environment: Literal["own", "twin", "hard"] = "own"
    """own: the training simulation of each policy; twin: a robot with held-out motors, 1 kHz
    physics and sensor noise; hard: the twin on unknown ground, with an unknown load and pushes."""
    forward: float | None = None
    """Commanded speed [m/s]; the highest speed that is in the range of all policies if not
    given."""
    yaw_rate: float = 0.0
    """Commanded yaw rate, to the left [rad/s]."""
    seconds: float = 10.0
    """Duration [s]."""
    seed: int = 0
    """Seed of the motors, the same for all policies on the twin."""
    viewer: bool = False
    """Also open MuJoCo's viewer, which needs a screen."""
    fleet: str | None = None
    """Fleet of the twin's motors; the robot's fleet if not given."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""


def run_play(config: Play, progress: Progress = SILENT) -> tuple[Path, Results]:
    """Render and measure the walks; returns the film's path and the results.

    SimulationFault if a walk diverged.
    """
    from motorprior.report import film  # here, since it imports matplotlib

    require_number("seconds", config.seconds, positive=True)
    require_seed(config.seed)
    robot = load_robot(config.robot)
    policies = {
        name: TrainedPolicy.load(path, robot)
        for name, path in _paths_by_name(config.policies).items()
    }

    shared_speeds = with_shared_speeds(robot, (trained.policy for trained in policies.values()))
    gait = shared_speeds.require_gait()
    forward = gait.forward[1] if config.forward is None else config.forward
    require_number("forward", forward, *gait.forward)
    require_number("yaw_rate", config.yaw_rate, -gait.yaw_rate, gait.yaw_rate)
    commands = Commands.steady(forward, config.yaw_rate)
    steps = max(1, round(config.seconds / robot.control_dt))
    walk = WalkConfig(steps, commands=commands)

    episodes: dict[str, Episode] = {}
    with locked(config.out):
        title = f"walk: {len(policies)} x {config.seconds:g} s"
        with progress.start(title, len(policies)) as task:
            for name, trained in policies.items():
                if warning := weight_warning(trained.policy, robot):
                    progress.warn(warning)
                episodes[name] = _walk(config, trained, walk)
                require_walks([episodes[name]], name)
                task.advance()

        results = Results()
        for name, episode in episodes.items():
            quality = gait_quality(robot, episode, forward, config.yaw_rate, steps)
            results += quality_results(quality, name, config.environment)
        write_results(config.out, results)

        environment = _TITLES[config.environment]
        titled = {f"{name}, {environment}": episode for name, episode in episodes.items()}
        path = film.write_film(config.out, robot, titled, steps, progress)

    if config.viewer:
        walks = [film.until_end(episode.trace, steps) for episode in episodes.values()]
        show(robot, walks, robot.control_dt)
    return path, results


def _paths_by_name(policies: Iterable[Path]) -> dict[str, Path]:
    """Files of the policies by the names of their folders.

    A file with another name than policy.safetensors has its own name.
    """
    paths: dict[str, Path] = {}
    for policy in policies:
        path = policy / POLICY if policy.is_dir() else policy
        seeds = sorted(policy.glob(f"{SEED_FOLDER.format('*')}/{POLICY}"))
        if seeds and not path.is_file():
            problem = f"no {POLICY} in it, but in {len(seeds)} folders of seeds below"
            raise ConfigError(problem, where=policy, remedy=f"give some of these: {seeds[0]}")

        name = path.resolve().parent.name if path.name == POLICY else path.stem
        if name in paths:
            name = f"{name} ({len(paths) + 1})"
        paths[name] = path
    return paths


def _walk(config: Play, trained: TrainedPolicy, walk: WalkConfig) -> Episode:
    if config.environment == "own":
        scene = trained.scene(walk)
    else:
        randomization = {"twin": NOISY, "hard": HARD}[config.environment]
        fleet = load_robot_fleet(trained.robot, config.fleet)
        scene = held_out_scene(trained.robot, fleet, replace(walk, randomization=randomization))
    return run_walks(scene, trained.policy.arrays, [config.seed])[0]
