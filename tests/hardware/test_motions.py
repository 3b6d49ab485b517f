"""A policy on the robot: the same observations and targets as in simulation for the same states."""

from pathlib import Path

import numpy as np
from drawn_motors import draw_pd
from policies import as_file_content, random_policy
from telemetry import telemetry

from motorprior.actuator.fleet import load_fleet
from motorprior.excitation.robot_targets import hardware_targets
from motorprior.hardware.control_loop import ramp
from motorprior.hardware.health import Measurement
from motorprior.hardware.motions import PolicyMotion
from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.hardware.runs import record
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.hardware.settings import RunSettings
from motorprior.hardware.virtual_robot import Firmware
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import act
from motorprior.logs.readers.deploy_recording import read_deploy_recording
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import MotorCommand, SensorReadings
from motorprior.rotations import roll_pitch_yaw
from motorprior.signals import rms
from motorprior.simulation.scene import Scene, WalkConfig, WalkEnv
from simulated_port import SimulatedPort, on_its_clock

WIRE = PUPPER_V2.require_wire()


class CopiedBody:
    """A body whose sensors read ``state``, in the signs of the wire."""

    def __init__(self, state):
        self.state = state
        self.command = None

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        self.command = command

    def sense(self) -> SensorReadings:
        attitude = np.array(roll_pitch_yaw(self.state.base_quat))
        pos = PUPPER_V2.require_wire().joint_signs * self.state.measured_joint_pos
        return SensorReadings(
            pos, np.zeros(12), np.zeros(12), attitude, self.state.base_ang_vel.copy()
        )


def test_motors_have_the_gains_that_were_sent_until_idle():
    env = WalkEnv(Scene(PUPPER_V2, draw_pd))
    env.reset(seed=0)
    body = CopiedBody(env.simulation.state())
    firmware = Firmware(PUPPER_V2, body)

    firmware.receive(framed(Command(kp=30.0, kd=0.5, max_current=2.0), 12))
    firmware.receive(framed(Command(pos=PUPPER_V2.nominal_pose), 12))
    firmware.advance(10)
    assert body.command is not None
    assert body.command.max_current == 2.0
    assert np.all(body.command.kp == 30.0)
    assert np.all(body.command.kd == 0.5)

    firmware.receive(framed(Command(idle=True), 12))
    firmware.advance(10)
    assert not body.command.kp.any()
    assert not body.command.kd.any()


def test_a_policy_observes_and_commands_on_the_robot_what_it_does_in_simulation():
    """Two seconds of a random policy: environment and wire differ by float32 of the wire only."""
    policy = as_file_content(random_policy(0.05, seed=1, std=0.5, units=4))
    fleet = load_fleet("pupper_v2")
    walk = WalkConfig(commands=Commands(hold=0.4))

    def draw_motors(rng: np.random.Generator):
        return fleet.sample(12, rng).actuator()

    env = WalkEnv(Scene(PUPPER_V2, draw_motors, walk, PUPPER_V2.twin_physics_dt))
    motion = PolicyMotion(PUPPER_V2, policy)
    action = np.zeros(17)
    observation, _ = env.reset(seed=0)
    schedule = Commands(hold=0.4).schedule(PUPPER_V2, 0, 500)

    body = CopiedBody(env.simulation.state())
    firmware = Firmware(PUPPER_V2, body)
    reader = FrameReader(Telemetry, 12)
    gate = SafetyGate(PUPPER_V2, WIRE.safety)
    target = body.state.measured_joint_pos
    gate.arm(Gains.of(WIRE), PUPPER_V2.nominal_pose, 0.0)

    for step in range(200):
        body.state = env.simulation.state()
        messages = reader.feed(firmware.advance(10))
        (frame,) = [message for message in messages if isinstance(message, Telemetry)]
        assert body.command is not None
        target_of_motors = WIRE.joint_signs * body.command.target
        np.testing.assert_allclose(target_of_motors, target, rtol=0, atol=1e-6)

        motion.forward, motion.yaw_rate = schedule[step]
        target = motion(Measurement(frame.with_signs(WIRE.joint_signs), 0.0, 0.0))
        np.testing.assert_allclose(motion.gait.observation, observation, rtol=0, atol=2e-6)

        act(policy.arrays, observation, action)
        observation, _, terminated, _, info = env.step(action)
        np.testing.assert_allclose(target, info["position_target"], rtol=0, atol=2e-6)
        firmware.receive(framed(gate.limited(target, 0.01 * (step + 1)), 12))
        assert not terminated

    assert gate.slew_clips == 0, "the gate does not change a walking policy"
    assert gate.position_clips == 0


def test_a_ramp_begins_and_ends_softly_and_keeps_its_speed():
    start = np.zeros(12)
    goal = np.linspace(-1.0, 2.0, 12)
    motion = ramp(start, goal, 1.5, 0.01, hold=0.1)

    targets = []
    while (target := motion(Measurement(telemetry(), 0.0, 0.0))) is not None:
        targets.append(target)

    speeds = np.abs(np.diff([start, *targets], axis=0)) / 0.01
    assert speeds.max() <= 1.5
    assert speeds[0].max() < 0.05
    np.testing.assert_array_equal(targets[-1], goal)
    steps_at_goal = sum(np.array_equal(target, goal) for target in targets)
    assert steps_at_goal >= 10  # 0.1 s


def observation_after_walking(frame: Telemetry, gyro_bias: np.ndarray) -> np.ndarray:
    """Observation of a policy after half a second of the same telemetry."""
    motion = PolicyMotion(PUPPER_V2, as_file_content(random_policy(0.05, seed=1)))
    motion.gyro_bias = gyro_bias
    motion.forward = 0.2
    for _ in range(50):
        motion(Measurement(frame, 0.0, 0.0))
    return motion.gait.observation


def test_the_bias_of_a_gyroscope_does_not_change_the_heading():
    still = telemetry(pos=PUPPER_V2.nominal_pose)
    biased = telemetry(pos=PUPPER_V2.nominal_pose, yaw_rate=0.03, roll_rate=-0.02)
    bias = np.array([-0.02, 0.0, 0.03])

    true_observation = observation_after_walking(still, np.zeros(3))

    corrected = observation_after_walking(biased, bias)
    np.testing.assert_allclose(corrected, true_observation, atol=1e-12)
    uncorrected = observation_after_walking(biased, np.zeros(3))
    assert not np.allclose(uncorrected, true_observation, atol=1e-3)


class _Witness(SimulatedPort):
    """A simulated robot that stores the targets of its motors in every millisecond."""

    def __init__(self) -> None:
        self.targets: list[np.ndarray] = []
        super().__init__(PUPPER_V2, 0, suspended=True, period=5)
        advance = self.body.advance

        def remembered(milliseconds: int, command) -> None:
            target = WIRE.joint_signs * command.target
            self.targets += [target] * milliseconds
            advance(milliseconds, command)

        self.body.advance = remembered


def test_the_targets_of_a_log_acted_at_the_times_of_the_log(tmp_path: Path):
    port = _Witness()
    with on_its_clock(port):
        settings = RunSettings(tmp_path, yes=True)
        every_joint = tuple(range(PUPPER_V2.num_joints))
        targets = hardware_targets(PUPPER_V2, "sine", every_joint, 4.0, 0.4, 8.0, seed=0)
        record(PUPPER_V2, port.port, settings, targets, lambda _: None, max_speed=8.0)

    log = read_deploy_recording(tmp_path / "run.csv", PUPPER_V2, period=0.001)

    first = round(1e3 * log.time[0])
    count = log.num_rows - 20
    logged = log.position_target[10 : 10 + count]
    acted = np.array(port.targets)
    errors = {}
    for shift in range(-4, 5):  # [ms]
        acted_later = acted[first + 10 + shift :][:count]
        errors[shift] = float(rms(logged - acted_later))
    assert min(errors, key=lambda shift: errors[shift]) == 0, errors
