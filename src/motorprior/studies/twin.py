"""The twin, a held-out virtual robot (unseen motors, 1 kHz physics, encoder noise), and the evaluation of a policy."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.fleet import Fleet
from motorprior.locomotion.body import GaitName
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.env import BackendSimulator
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import Episode, WalkSimulator
from motorprior.simulation.scene import Scene, WalkConfig
from motorprior.studies.gait_quality import completed

TWIN_STREAM = 0x7717  # random stream of the twin's motors, used by no bench and no training
ENCODER_NOISE = 0.001  # [rad] standard deviation; assumption, 50 counts of the rotor's encoder
DURATION_STEPS = 500  # control steps of a walk of 5 s
DRAWS = 24  # walks of an evaluation
EVALUATION_SEED = 90_000_000  # first seed of an evaluation; those of training are hashes

# Sensors of the twin for a policy that follows commands: white noise of a MEMS sensor at 100 Hz; bias of 0.1 °/s of a
# consumer gyroscope after averaging at rest. Assumptions.
NOISY = Randomization(joint_noise=ENCODER_NOISE, tilt_noise=0.002, rate_noise=0.01, gyro_bias=0.002)
# Unknown ground and load. Masses and delays are within Tan et al. 2018 (RSS, "Sim-to-Real: Learning Agile Locomotion
# For Quadruped Robots", table of randomised parameters): ×0.8-1.2 and 0-40 ms. Assumptions: friction, an off-centre
# load, sloping floors, jitter of a busy computer, and pushes that change the speed of 2.1 kg by up to 0.14 m/s.
HARD = replace(
    NOISY, friction=(0.7, 1.3), mass=(0.9, 1.1), com=0.01, gravity_tilt=0.03, sensor_delay=(0.0, 0.02),
    sensor_jitter=0.005, command_jitter=0.005, dropped=0.02, push=0.3, push_interval=2.0,
)  # fmt: skip


def with_shared_speeds(robot: Robot, policies: Iterable[Policy]) -> Robot:
    """The robot with the range of speeds of all these policies."""
    ranges = [policy.forward for policy in policies]
    return robot.with_speed_range((max(low for low, _ in ranges), min(high for _, high in ranges)))


def straight_ahead(robot: Robot) -> Commands:
    """Constant forward command at the robot's maximum speed."""
    return Commands.steady(robot.require_legs().forward[1])


def twin_simulator(
    robot: Robot, fleet: Fleet, gait: GaitName = "trot", commands: Commands | None = None
) -> WalkSimulator:
    """Simulator with another twin of this fleet in every episode; commands are `straight_ahead` by default."""
    noise = Randomization(joint_noise=ENCODER_NOISE)
    return twin_of(
        robot, fleet, WalkConfig(DURATION_STEPS, TaskWeights(), noise, commands or straight_ahead(robot), gait)
    )


def twin_of(robot: Robot, fleet: Fleet, walk: WalkConfig) -> WalkSimulator:
    """Simulator with another twin of this fleet in every episode."""

    def sample(rng: np.random.Generator) -> Actuator:
        own = np.random.default_rng([TWIN_STREAM, *rng.integers(2**32, size=2)])
        return fleet.sample(robot.num_joints, own, of_one_robot=True).actuator()

    return WalkSimulator(Scene(robot, sample, walk, robot.twin_physics_dt))


@dataclass(frozen=True)
class Walking:
    """Means over DRAWS samples of motors, each walking for 5 s.

    Attributes:
        speed: forward displacement / 5 s, also after a fall [m/s].
        upright: share of the 5 s before a fall [-].
        drift: |final lateral displacement| [m].
    """

    speed: float
    upright: float
    drift: float


WALKING_UNITS = {"speed": "m/s", "upright": "1", "drift": "m"}


def evaluate(
    robot: Robot,
    policy: Policy,
    simulator: WalkSimulator | BackendSimulator,
    progress: Callable[[], None] = lambda: None,
) -> tuple[Walking, np.ndarray]:
    """Walk on DRAWS samples of motors.

    Args:
        robot: of the policy.
        policy: to evaluate.
        simulator: with episodes of DURATION_STEPS.
        progress: called after every episode.

    Returns:
        The means, and the (steps, 7 + joints) trace of the episode with the median distance.
    """
    episodes = []
    for draw in range(DRAWS):
        episodes.append(simulator.run(policy.arrays(), EVALUATION_SEED + draw, trace=True))
        progress()
    order = np.argsort([episode.displacement[0] for episode in episodes], kind="stable")
    return _means(episodes, robot.control_dt), episodes[int(order[len(order) // 2])].trace


def _means(episodes: list[Episode], control_dt: float) -> Walking:
    duration = DURATION_STEPS * control_dt
    forward = np.mean([episode.displacement[0] for episode in episodes])
    drift = np.mean([abs(episode.displacement[1]) for episode in episodes])
    upright = np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes])
    return Walking(float(forward / duration), float(upright), float(drift))


def share_upright(episode: Episode, steps: int) -> float:
    """Share of ``steps`` control steps before a fall or a simulation fault [-]."""
    return (episode.steps - (not completed(episode, steps))) / steps
