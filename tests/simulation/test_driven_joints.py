"""Motors on the joints of a user's model: coupled fingers stay stable, and every guard fires."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motors import Motors
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.priors.prior_file import prior_notes
from motorprior.simulation.driven_joints import DrivenJoints
from motorprior.simulation.motors import simulated_motors

HAND = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<site name="out" pos=".1 0 0"/><body name="palm"><joint name="wrist" axis="0 1 0"/>
<site name="in" pos=".02 0 -.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -.12" size=".01" mass=".06"/>
<body pos="0 0 -.12"><joint name="finger_l" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .02 0 -.05" size=".006" mass=".02" contype="0"/></body>
<body pos="0 0 -.12"><joint name="finger_r" axis="0 -1 0"/>
  <geom type="capsule" fromto="0 0 0 -.02 0 -.05" size=".006" mass=".02" contype="0"/></body>
<body pos="0 0 -.2"><joint name="slide" type="slide"/>
  <geom size=".01" mass=".1" contype="0"/></body>
</body></worldbody>
<tendon><fixed name="pull"><joint joint="finger_r" coef="1"/></fixed>
<spatial name="cable"><site site="out"/><site site="in"/></spatial></tendon>
<equality><joint joint1="finger_r" joint2="finger_l"/></equality></mujoco>"""

UNCOUPLED_HAND = HAND.replace("<equality>", "<!--").replace("</equality>", "-->")


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
    """Root-mean-square errors of wrist and left finger [rad] over 2 s."""
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
    alone = tracking(UNCOUPLED_HAND, motors(2))
    coupled = tracking(HAND, motors(2))

    assert (coupled < 1.5 * alone + 0.005).all(), (alone, coupled)


def test_driven_joints_are_damped_implicitly(motors):
    """The motion is the same with ``dof_damping``, which MuJoCo's Euler treats implicitly."""
    xml = UNCOUPLED_HAND.replace("implicitfast", "Euler")
    model, data = compiled(xml)
    driven = DrivenJoints(model, data, motors(1), ["wrist"])
    reference_model, reference_data = compiled(xml)
    loose = Motors(motors(1), 0.002, np.zeros(1))
    reference_model.dof_armature[0] = loose.armature[0]

    for step in range(200):
        target = np.array([0.5 * np.sin(0.02 * step)])
        driven.drive(target)
        mujoco.mj_step(model, data)

        pos = reference_data.qpos[:1]
        vel = reference_data.qvel[:1]
        torque, damping = loose.step(target, pos, vel)
        reference_data.qfrc_applied[0] = torque[0]
        reference_model.dof_damping[0] = damping[0]
        mujoco.mj_step(reference_model, reference_data)

    np.testing.assert_allclose(data.qpos, reference_data.qpos, atol=1e-9)
    assert abs(data.qpos[0]) > 0.1


def with_actuator(actuator: str) -> str:
    return HAND.replace("</mujoco>", f"<actuator>{actuator}</actuator></mujoco>")


REFUSED = {
    "servo on the joint": (
        with_actuator('<position name="servo" joint="wrist"/>'),
        ["wrist"],
        "'servo'",
    ),
    "motor in the frame of the parent": (
        with_actuator('<motor name="m" jointinparent="wrist"/>'),
        ["wrist"],
        "'m'",
    ),
    "motor at a fixed tendon": (
        with_actuator('<motor name="t" tendon="pull"/>'),
        ["finger_r"],
        "'t'",
    ),
    "motor at a spatial tendon": (
        with_actuator('<motor name="c" tendon="cable"/>'),
        ["wrist"],
        "'c'",
    ),
    "unknown joint": (HAND, ["elbow"], "'elbow'"),
    "sliding joint": (HAND, ["slide"], "'slide'"),
    "integrator": (HAND.replace("implicitfast", "RK4"), ["wrist"], "RK4"),
    "coupled joints": (HAND, ["finger_l", "finger_r"], "'finger_r' to 'finger_l'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_model_that_the_motors_would_drive_wrongly_is_refused_with_a_remedy(motors, name: str):
    xml, joints, value = REFUSED[name]
    model, data = compiled(xml)

    with pytest.raises(ConfigError, match=value) as refused:
        DrivenJoints(model, data, motors(len(joints)), joints)

    assert refused.value.remedy


def test_one_motor_for_two_joints_is_refused_with_both_numbers(motors):
    model, data = compiled()

    with pytest.raises(ConfigError, match="2 joints for 1 motors") as refused:
        DrivenJoints(model, data, motors(1), ["wrist", "wrist"])

    assert refused.value.remedy


def test_a_simulation_that_mujoco_reset_is_a_fault(motors):
    model, data = compiled()
    driven = DrivenJoints(model, data, motors(1), ["wrist"])
    driven.drive(np.zeros(1))

    data.qvel[1] = 1e20
    mujoco.mj_step(model, data)
    with pytest.raises(SimulationFault):
        driven.drive(np.zeros(1))

    mujoco.mj_resetData(model, data)
    driven.drive(np.zeros(1))


@pytest.mark.parametrize(
    ("command_mode", "command"),
    [("velocity", {"velocity_target": 2.0}), ("torque", {"torque_feedforward": 1.0})],
)
def test_motors_of_other_commands_follow_these_and_no_position_target(
    motors: Callable[[int], GreyBoxActuator], command_mode: str, command: dict[str, float]
):
    def turned(position_target: float, **other: float) -> float:
        """Angle [rad] of the wrist after 0.1 s."""
        model = mujoco.MjModel.from_xml_string(UNCOUPLED_HAND)
        data = mujoco.MjData(model)
        driven = DrivenJoints(
            model, data, replace(motors(1), command_mode=command_mode), ("wrist",)
        )
        for _ in range(50):
            driven.drive(np.array([position_target]), **other)
            mujoco.mj_step(model, data)
        return float(data.joint("wrist").qpos[0])

    assert abs(turned(1.0)) < 1e-3
    assert turned(0.0, **command) > 0.05


def test_a_robot_that_is_sent_position_targets_refuses_motors_of_velocity_commands():
    prior = mp.from_pretrained("pupper_v2")
    assert isinstance(prior.model, GreyBox)
    prior = replace(prior, model=replace(prior.model, command_mode="velocity"))

    with pytest.raises(ConfigError, match="velocity commands"):
        simulated_motors(prior, mp.load_robot("pupper_v2"))


@pytest.mark.parametrize(("command_mode", "is_noted"), [("torque", True), ("mit", False)])
def test_a_prior_whose_logs_have_no_position_gains_is_noted(command_mode: str, is_noted: bool):
    prior = mp.from_pretrained("go2")
    assert isinstance(prior.model, GreyBox)
    prior = replace(prior, model=replace(prior.model, command_mode=command_mode))

    notes = list(prior_notes(prior, mp.load_robot("pupper_v2")))

    assert any("the scale of position gains is not" in note for note in notes) == is_noted
