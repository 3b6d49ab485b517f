"""A policy on the robot: the same observations and targets as in simulation for the same states."""

import numpy as np
from policies import as_file_content, random_policy

from motorprior.bench.fleet import load_fleet
from motorprior.hardware.deploy import PolicyMotion
from motorprior.hardware.protocol import FrameReader, Telemetry, framed
from motorprior.hardware.safety_gate import Gains, SafetyGate
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.hardware.virtual_robot import Firmware, FirmwareConfig
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import act
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.wire import Drive, SensorReadings
from motorprior.rotations import roll_pitch_yaw
from motorprior.simulation.env import WalkEnv
from motorprior.simulation.scene import Scene, SimulatedBackend, WalkConfig

WIRE = PUPPER_V2.require_wire()
JOINTS = 12


class CopiedBody:
    """A body in a given state, in the robot's own signs."""

    def __init__(self, state):
        self.state, self.drive = state, None

    def advance(self, milliseconds: int, drive: Drive) -> None:
        self.drive = drive

    def sense(self) -> SensorReadings:
        attitude = np.array(roll_pitch_yaw(self.state.base_quat))
        pos = spec.JOINT_SIGNS * self.state.measured_joint_pos
        return SensorReadings(pos, np.zeros(12), np.zeros(12), attitude, self.state.base_ang_vel.copy())


class Spy(SimulatedBackend):
    """Remembers its last state."""

    def reset(self, seed: int):
        self.state = super().reset(seed)
        return self.state

    def step(self, position_target: np.ndarray):
        self.state = super().step(position_target)
        return self.state


def test_a_policy_observes_and_commands_on_the_robot_what_it_does_in_simulation():
    """Two seconds of a random policy: env and wire side by side; the wire's float32 is all that is lost."""
    policy = as_file_content(random_policy(0.05, seed=1, std=0.5, units=4))
    fleet = load_fleet("pupper_v2")
    walk = WalkConfig(commands=Commands(hold=0.4))
    spy = Spy(Scene(PUPPER_V2, lambda draw: fleet.sample(12, draw).actuator(), walk, spec.TWIN_PHYSICS_DT))
    env, motion = WalkEnv(PUPPER_V2, spy, walk), PolicyMotion(PUPPER_V2, policy)
    action = np.zeros(17)
    observation, _ = env.reset(seed=0)
    schedule = Commands(hold=0.4).schedule(PUPPER_V2, 0, 500)
    body = CopiedBody(spy.state)
    firmware, reader = Firmware(PUPPER_V2, body, FirmwareConfig()), FrameReader(Telemetry, JOINTS)
    gate = SafetyGate(PUPPER_V2, WIRE.safety)
    gate.arm(Gains.of(WIRE), spec.NOMINAL_POSE, 0.0)
    for step in range(200):
        body.state = spy.state
        (frame,) = [m for m in reader.feed(firmware.advance(10)) if isinstance(m, Telemetry)]
        motion.forward, motion.yaw_rate = schedule[step]
        target = motion(Measurement(frame.with_signs(WIRE.joint_signs), 0.0, 0.0))
        np.testing.assert_allclose(motion.gait.observation, observation, rtol=0, atol=2e-6)
        act(policy.arrays, observation, action)
        observation, _, terminated, _, info = env.step(action)
        np.testing.assert_allclose(target, info["position_target"], rtol=0, atol=2e-6)
        firmware.receive(framed(gate.limited(target, 0.01 * (step + 1)), JOINTS))
        firmware.advance(0)
        assert not terminated
        np.testing.assert_allclose(firmware._target * spec.JOINT_SIGNS, target, rtol=0, atol=1e-6)
    assert gate.slew_clips == gate.position_clips == 0, "the gate does not change a walking policy"
