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
from motorprior.simulation.scene import Scene, WalkConfig, WalkEnv
from simulated_port import SimulatedPort, on_its_clock

WIRE = PUPPER_V2.require_wire()


class CopiedBody:
    """A body in a given state, in the robot's own signs."""

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
    for command in (Command(kp=30.0, kd=0.5, max_current=2.0), Command(pos=PUPPER_V2.nominal_pose)):
        firmware.receive(framed(command, 12))
    firmware.advance(10)
    assert body.command is not None and body.command.max_current == 2.0
    assert np.all(body.command.kp == 30.0) and np.all(body.command.kd == 0.5)
    firmware.receive(framed(Command(idle=True), 12))
    firmware.advance(10)
    assert not body.command.kp.any() and not body.command.kd.any()


def test_a_policy_observes_and_commands_on_the_robot_what_it_does_in_simulation():
    """Two seconds of a random policy: env and wire side by side; the wire's float32 is all that is lost."""
    policy = as_file_content(random_policy(0.05, seed=1, std=0.5, units=4))
    fleet = load_fleet("pupper_v2")
    walk = WalkConfig(commands=Commands(hold=0.4))
    scene = Scene(
        PUPPER_V2, lambda draw: fleet.sample(12, draw).actuator(), walk, PUPPER_V2.twin_physics_dt
    )
    env = WalkEnv(scene)
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
        (frame,) = [m for m in reader.feed(firmware.advance(10)) if isinstance(m, Telemetry)]
        assert body.command is not None
        np.testing.assert_allclose(
            WIRE.joint_signs * body.command.target, target, rtol=0, atol=1e-6
        )
        motion.forward, motion.yaw_rate = schedule[step]
        target = motion(Measurement(frame.with_signs(WIRE.joint_signs), 0.0, 0.0))
        np.testing.assert_allclose(motion.gait.observation, observation, rtol=0, atol=2e-6)
        act(policy.arrays, observation, action)
        observation, _, terminated, _, info = env.step(action)
        np.testing.assert_allclose(target, info["position_target"], rtol=0, atol=2e-6)
        firmware.receive(framed(gate.limited(target, 0.01 * (step + 1)), 12))
        assert not terminated
    assert gate.slew_clips == gate.position_clips == 0, "the gate does not change a walking policy"


def test_a_ramp_begins_and_ends_softly_and_keeps_its_speed():
    start = np.zeros(12)
    goal = np.linspace(-1.0, 2.0, 12)
    motion = ramp(start, goal, 1.5, 0.01, hold=0.1)
    row = []
    while (target := motion(Measurement(telemetry(), 0.0, 0.0))) is not None:
        row.append(target)
    speeds = np.abs(np.diff([start, *row], axis=0)) / 0.01
    assert speeds.max() <= 1.5 and speeds[0].max() < 0.05 and np.array_equal(row[-1], goal)
    assert len([target for target in row if np.array_equal(target, goal)]) >= 10


def test_a_gyroscope_s_bias_does_not_change_the_heading():
    still = telemetry(pos=PUPPER_V2.nominal_pose)
    turning = telemetry(pos=PUPPER_V2.nominal_pose, yaw_rate=0.03, roll_rate=-0.02)
    motions = [
        PolicyMotion(PUPPER_V2, as_file_content(random_policy(0.05, seed=1))) for _ in range(3)
    ]
    motions[1].gyro_bias = np.array([-0.02, 0.0, 0.03])
    for motion, seen in zip(motions, (still, turning, turning), strict=True):
        motion.forward = 0.2
        for _ in range(50):
            motion(Measurement(seen, 0.0, 0.0))
    right, corrected, wrong = (motion.gait.observation for motion in motions)
    np.testing.assert_allclose(corrected, right, atol=1e-12)
    assert not np.allclose(wrong, right, atol=1e-3)


class _Witness(SimulatedPort):
    """It stores the targets that the motors had in every millisecond."""

    def __init__(self) -> None:
        self.targets: list[np.ndarray] = []
        super().__init__(PUPPER_V2, 0, suspended=True, period=5)
        advance = self.body.advance

        def remembered(milliseconds: int, command) -> None:
            self.targets += [PUPPER_V2.require_wire().joint_signs * command.target] * milliseconds
            advance(milliseconds, command)

        self.body.advance = remembered


def test_targets_on_a_grid_are_those_that_acted(tmp_path: Path):
    port = _Witness()
    with on_its_clock(port):
        settings = RunSettings(tmp_path, yes=True)
        every_joint = tuple(range(PUPPER_V2.num_joints))
        targets = hardware_targets(PUPPER_V2, "sine", every_joint, 4.0, 0.4, 8.0, seed=0)
        record(PUPPER_V2, port.port, settings, targets, lambda _: None, max_speed=8.0)
    log = read_deploy_recording(tmp_path / "run.csv", PUPPER_V2, period=0.001)
    first = round(1e3 * log.time[0])
    count = log.num_rows - 20
    acted = np.array(port.targets)
    errors = {
        late: float(
            np.sqrt(
                np.mean(
                    (log.position_target[10 : 10 + count] - acted[first + 10 + late :][:count]) ** 2
                )
            )
        )
        for late in range(-4, 5)
    }
    assert min(errors, key=lambda late: errors[late]) == 0, errors
