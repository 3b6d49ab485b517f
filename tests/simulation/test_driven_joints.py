"""Motors on the joints of a user's model: coupled fingers stay stable, and every guard fires."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motors import Motors
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.simulation.driven_joints import DrivenJoints

HAND = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<site name="out" pos=".1 0 0"/><body name="palm"><joint name="wrist" axis="0 1 0"/>
<site name="in" pos=".02 0 -.05"/><geom type="capsule" fromto="0 0 0 0 0 -.12" size=".01" mass=".06"/>
<body pos="0 0 -.12"><joint name="finger_l" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .02 0 -.05" size=".006" mass=".02" contype="0"/></body>
<body pos="0 0 -.12"><joint name="finger_r" axis="0 -1 0"/>
  <geom type="capsule" fromto="0 0 0 -.02 0 -.05" size=".006" mass=".02" contype="0"/></body>
<body pos="0 0 -.2"><joint name="slide" type="slide"/><geom size=".01" mass=".1" contype="0"/></body>
</body></worldbody>
<tendon><fixed name="pull"><joint joint="finger_r" coef="1"/></fixed>
<spatial name="cable"><site site="out"/><site site="in"/></spatial></tendon>
<equality><joint joint1="finger_r" joint2="finger_l"/></equality></mujoco>"""


@pytest.fixture
def motors(grey_box: Callable[..., GreyBox]) -> Callable[[int], GreyBoxActuator]:
    def make(count: int) -> GreyBoxActuator:
        box = grey_box()
        return box.motors(np.zeros((count, box.num_latents)))

    return make


def compiled(xml: str = HAND) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(xml)
    return model, mujoco.MjData(model)


def tracking(xml: str, motors: GreyBoxActuator) -> np.ndarray:
    """RMS errors of wrist and left finger [rad] over 2 s."""
    model, data = compiled(xml)
    driven = DrivenJoints(model, data, motors, ["wrist", "finger_l"])
    errors = []
    for _ in range(1000):
        target = 0.4 * np.sin(np.pi * data.time + np.arange(2))
        driven.drive(target)
        mujoco.mj_step(model, data)
        errors.append(target - data.qpos[:2])
    assert not data.warning.number.sum()
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_a_finger_that_an_equality_couples_to_a_driven_one_follows_it(motors):
    alone = tracking(HAND.replace("<equality>", "<!--").replace("</equality>", "-->"), motors(2))
    coupled = tracking(HAND, motors(2))
    assert (coupled < 1.5 * alone + 0.005).all(), (alone, coupled)


def test_the_damping_is_the_implicit_one(motors):
    """The same motion as with the damping in ``dof_damping``, which MuJoCo's Euler treats implicitly."""
    xml = (
        HAND.replace("implicitfast", "Euler")
        .replace("<equality>", "<!--")
        .replace("</equality>", "-->")
    )
    model, data = compiled(xml)
    other, there = compiled(xml)
    driven = DrivenJoints(model, data, motors(1), ["wrist"])
    loose = Motors(motors(1), 0.002, np.zeros(1))
    other.dof_armature[0] = loose.armature[0]
    for step in range(200):
        target = np.array([0.5 * np.sin(0.02 * step)])
        driven.drive(target)
        mujoco.mj_step(model, data)
        torque, damping = loose.step(target, there.qpos[:1], there.qvel[:1])
        there.qfrc_applied[0] = torque[0]
        other.dof_damping[0] = damping[0]
        mujoco.mj_step(other, there)
    np.testing.assert_allclose(data.qpos, there.qpos, atol=1e-9)
    assert abs(data.qpos[0]) > 0.1


@pytest.mark.parametrize(
    ("joints", "change", "problem"),
    [
        (
            ["wrist"],
            ("</mujoco>", '<actuator><position name="servo" joint="wrist"/></actuator></mujoco>'),
            "'servo'",
        ),
        (
            ["wrist"],
            ("</mujoco>", '<actuator><motor name="m" jointinparent="wrist"/></actuator></mujoco>'),
            "'m'",
        ),
        (
            ["finger_r"],
            ("</mujoco>", '<actuator><motor name="t" tendon="pull"/></actuator></mujoco>'),
            "'t'",
        ),
        (
            ["wrist"],
            ("</mujoco>", '<actuator><motor name="c" tendon="cable"/></actuator></mujoco>'),
            "'c'",
        ),
        (["elbow"], ("", ""), "no joint 'elbow'"),
        (["slide"], ("", ""), "'slide' is no hinge"),
        (["wrist"], ("implicitfast", "RK4"), "RK4"),
        (["wrist", "wrist"], ("", ""), "2 joints for 1 motors"),
        (["finger_l", "finger_r"], ("", ""), "'finger_r' to 'finger_l': one motor drives both"),
    ],
)
def test_every_guard_fires(motors, joints: list[str], change: tuple[str, str], problem: str):
    model, data = compiled(HAND.replace(*change))
    count = 1 if "for 1" in problem else len(joints)
    with pytest.raises(ConfigError, match=problem) as refused:
        DrivenJoints(model, data, motors(count), joints)
    assert refused.value.remedy


def test_a_simulation_that_mujoco_reset_is_a_fault(motors):
    model, data = compiled()
    driven = DrivenJoints(model, data, motors(1), ["wrist"])
    driven.drive(np.zeros(1))
    data.qvel[1] = 1e20
    mujoco.mj_step(model, data)
    with pytest.raises(SimulationFault, match="diverged"):
        driven.drive(np.zeros(1))
    mujoco.mj_resetData(model, data)
    driven.drive(np.zeros(1))
