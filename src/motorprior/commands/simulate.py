"""Excite a simulated robot and record a motor log."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.bounds import require_number, require_seed
from motorprior.excitation.robot_targets import excitation_targets
from motorprior.logs.loads import with_loads
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.priors.prior_file import prior_notes
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.playback import simulated_log
from motorprior.stage import description, is_finished, working

LOG = "log.parquet"


@dataclass(frozen=True)
class Simulate:
    """Excite a simulated robot and record a motor log."""

    out: Path
    """Folder for log.parquet."""
    motors: str
    """The robot's motors, such as prior:FILE, pd or fleet; see docs/training.md."""
    excitation: str = "sine"
    """Targets of the joints around the nominal pose: the signal sine, steps, gait, creep, chirp or
    multisine, or a file of `motorprior excite`."""
    seconds: float = 10.0
    """Duration [s]."""
    amplitude: float = 0.4
    """Maximum distance of a target from the nominal pose [rad], within the joints' limits."""
    seed: int = 0
    """Seed of the motors and the excitation."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""


def run_simulate(config: Simulate, progress: Progress = SILENT) -> None:
    """Simulate, unless the stage is finished.

    SimulationFault if the gains are too high for the physics step.
    """
    require_number("seconds", config.seconds, 0.1)
    require_number("amplitude", config.amplitude)
    require_seed(config.seed)

    robot = load_robot(config.robot)
    source = simulated_motors(config.motors, robot)
    if source.prior is not None:
        for line in prior_notes(source.prior, robot):
            progress.note(line)
    targets = excitation_targets(
        robot, config.excitation, config.seconds, config.amplitude, config.seed
    )

    inputs = [*source.files, *robot.files]
    if config.excitation.endswith(".safetensors"):
        inputs.append(Path(config.excitation))
    stage = description("simulate", asdict(config), inputs)
    if is_finished(config.out, stage):
        return

    title = f"simulate {robot.name}: {config.excitation}, {config.seconds:g} s"
    with working(config.out, stage), progress.start(title, 1) as task:
        motors = source.draw(np.random.default_rng(config.seed))
        log = simulated_log(robot, motors, targets, source.physics_dt)
        write_log(config.out / LOG, with_loads(log, robot))
        task.advance()
