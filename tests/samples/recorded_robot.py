"""Logs of simulated robots: short recordings of known motors, suspended in the air or standing."""

import numpy as np
from motor_logs import joints_of, log_of

from motorprior.actuator.actuator import Actuator
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.log_replay import COMMAND_PERIOD

STEPS = 600
LEAD_IN = 500


def record_log(
    actuator: Actuator, suspended: bool = True, seed: int = 0, speed: float = 1.0
) -> MotorLog:
    """Log of sines of hips and knees, read by encoders; ``speed`` scales the frequencies."""
    world = World(ROBOT, 0.001, suspended, COMMAND_PERIOD)
    rng = np.random.default_rng(seed)
    time = COMMAND_PERIOD * np.arange(STEPS)
    targets = np.tile(ROBOT.nominal_pose, (STEPS, 1))
    for leg in ROBOT.legs:
        for joint in leg.joints[1:]:
            frequency = speed * rng.uniform(0.8, 2.5)
            phase = rng.uniform(0.0, 2.0 * np.pi)
            wave = np.sin(2.0 * np.pi * frequency * time + phase)
            targets[:, joint] += 0.25 * (wave - np.sin(phase))

    lead_in = np.tile(ROBOT.nominal_pose, (LEAD_IN, 1))
    played = replay(world, actuator, targets, ROBOT.nominal_pose, lead_in)
    log = log_of(
        time,
        targets,
        played.measured_joint_pos,
        base_orientation=np.zeros((STEPS, 2)),
        encoder=ROBOT.encoder,
        **joints_of(ROBOT),
    )
    return checked(log)
