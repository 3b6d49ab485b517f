"""Contract of all physics engines; a new engine is added to WORLDS."""

from dataclasses import replace

import numpy as np
import pytest
from grey_boxes import make_grey_box

from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.locomotion.control_step import RobotState
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import Scene, WalkConfig

MUJOCO = WalkConfig()
BULLET = WalkConfig(engine="pybullet")


class Standing:
    """A robot in an engine; `reset` stands it up on new motors in a new randomised domain."""

    def __init__(self, scene: Scene):
        self._scene = scene
        self._world = scene.world()
        self.close = self._world.close

    def reset(self, seed: int) -> RobotState:
        motors, domain = self._scene.sample(seed)
        simulation = self._world.reset(motors, domain=domain)
        self.step = simulation.step

        return simulation.state()


def world_of(draw_motors, walk: WalkConfig) -> Standing:
    if walk.engine == "pybullet":
        pytest.importorskip(
            "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
        )
    return Standing(Scene(PUPPER_V2, draw_motors, walk, PUPPER_V2.twin_physics_dt))


EVERYTHING = Randomization(
    armature=(0.0, 0.001),
    damping=(0.0, 0.01),
    friction=(0.7, 1.3),
    mass=(0.9, 1.1),
    com=0.005,
    gravity_tilt=0.02,
    encoder_offset=0.01,
    command_delay=(0.0, 0.015),
    push=0.05,
    push_interval=0.1,
)
WORLDS = {  # fleet ("" for grey boxes) and walk
    "mujoco": ("pupper_v2", MUJOCO),
    "mujoco of grey boxes": ("", MUJOCO),
    "mujoco, randomized": ("pupper_v2", replace(MUJOCO, randomization=EVERYTHING)),
    "pybullet": ("pupper_v2", BULLET),
    "pybullet of grey boxes": ("", BULLET),
    "pybullet, randomized": ("mixed", replace(BULLET, randomization=EVERYTHING)),
}


@pytest.fixture(params=WORLDS)
def world(request: pytest.FixtureRequest):
    name, walk = WORLDS[request.param]
    box = make_grey_box(spread=0.05)

    def draw_motors(rng: np.random.Generator):
        if not name:
            return GreyBoxActuator(box, rng.standard_normal((PUPPER_V2.num_joints, 3)))
        return load_fleet(name).sample(PUPPER_V2.num_joints, rng).actuator()

    standing = world_of(draw_motors, walk)
    yield standing
    standing.close()


def walked(world: Standing, seed: int, steps: int = 20) -> list[RobotState]:
    """States of a small motion of all joints."""
    states = [world.reset(seed)]
    for step in range(steps):
        states.append(world.step(PUPPER_V2.nominal_pose + 0.1 * np.sin(0.3 * step)))
    return states


def test_a_state_has_the_stated_shapes_and_types(world: Standing):
    for state in (world.reset(0), world.step(PUPPER_V2.nominal_pose)):
        shapes = [np.shape(value) for value in state]
        assert shapes == [(3,), (4,), (3,), (3,), (12,), (4, 3), (), ()]
        assert state.fault == 0
        if np.isnan(state.foot_pos).all():  # not every engine measures the feet
            state = state._replace(foot_pos=np.zeros(0))
        assert all(np.all(np.isfinite(value)) for value in state)
        assert np.linalg.norm(state.base_quat) == pytest.approx(1.0, abs=1e-9)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_motors(world: Standing):
    states = walked(world, seed=1)
    repeated = walked(world, seed=1)
    of_another_seed = walked(world, seed=2)

    for state, state_again in zip(states, repeated, strict=True):
        for value, value_again in zip(state, state_again, strict=True):
            np.testing.assert_array_equal(value, value_again)
    assert not np.array_equal(states[-1][4], of_another_seed[-1][4])


def test_the_feet_of_a_standing_robot_are_on_the_ground_below_it(
    world: Standing,
):
    state = world.reset(0)
    for _ in range(30):
        state = world.step(PUPPER_V2.nominal_pose)

    feet = state.foot_pos

    if np.isnan(feet).all():
        pytest.skip("this engine does not measure the positions of the feet")

    np.testing.assert_allclose(feet[:, :2], [leg.rest for leg in PUPPER_V2.legs], atol=0.03)
    np.testing.assert_allclose(feet[:, 2], PUPPER_V2.legs[0].foot_radius, atol=0.005)


def test_a_robot_commanded_to_stand_stands(world: Standing):
    state = world.reset(0)
    for _ in range(100):
        state = world.step(PUPPER_V2.nominal_pose)

    # after 1 s; the motors give way under the weight of 2.135 kg: about 0.4 N·m at each of 8 leg
    # joints, divided by kp = 8.8 N·m/rad
    assert np.abs(state.measured_joint_pos - PUPPER_V2.nominal_pose).max() < 0.15
    assert 0.13 < state.base_pos[2] < 0.18
    assert np.abs(state.base_lin_vel).max() < 0.05
    assert state.torque_squared_sum > 0.0


def test_joints_follow_their_targets(world: Standing):
    state = world.reset(0)
    target = PUPPER_V2.nominal_pose + np.tile([0.0, 0.2, -0.4], 4)
    for _ in range(100):
        state = world.step(target)

    assert np.abs(state.measured_joint_pos - target).max() < 0.15


ABSURD = IdealPd.uniform(12, kp=1e300, kd=0.84, torque_limit=1e308, armature=0.003)
UNDEFINED = IdealPd.uniform(12, kp=8.8, kd=np.nan, torque_limit=1.26, armature=0.003)
BUZZING = IdealPd.uniform(12, kp=1e3, kd=0.0, torque_limit=1e9)
TELEPORTING = IdealPd.uniform(12, kp=1e8, kd=0.0, torque_limit=1e9)  # all values stay finite


@pytest.mark.parametrize("walk", [MUJOCO, BULLET], ids=["mujoco", "pybullet"])
@pytest.mark.parametrize(
    "motors",
    [ABSURD, UNDEFINED, BUZZING, TELEPORTING],
    ids=["absurd", "NaN", "buzzing", "teleporting"],
)
def test_an_unstable_simulation_reports_a_fault_and_the_next_episode_is_sound(
    walk: WalkConfig, motors: IdealPd
):
    sound = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003)
    queue = [motors, sound]
    world = world_of(lambda rng: queue.pop(0), walk)
    world.reset(0)

    assert [world.step(PUPPER_V2.nominal_pose + 0.1).fault for _ in range(3)][-1] == 1
    assert world.reset(0).fault == 0
    assert [world.step(PUPPER_V2.nominal_pose).fault for _ in range(20)] == [0] * 20

    world.close()
