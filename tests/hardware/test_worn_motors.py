"""Virtual robots with weak, worn and damaged motors, and the figures of what adapting to them pays."""

from pathlib import Path

import numpy as np
import pytest

from closing_the_loop import CONTROL, Outcome, VirtualRobot, by_wear, figures_file
from motorprior.actuator.physical import MotorParameters
from motorprior.bench.fleet import load_fleet
from motorprior.pipeline.virtual.twin_body import TwinBody, draw_motors
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from simulated_port import SimulatedPort
from worn_motors import DAMAGED, FRICTION, PLAY, WEAK, WEAR

TORQUES = ("kp", "kd", "torque_limit", "stall_torque")


@pytest.fixture(scope="module")
def new() -> MotorParameters:
    robot = load_robot(DEFAULT_ROBOT)
    return draw_motors(robot, load_fleet(robot.fleets[0][0]), 5)


def left(motors: MotorParameters, new: MotorParameters) -> np.ndarray:
    """What is left of the torque, of all that makes one."""
    shares = np.array([getattr(motors, name) / getattr(new, name) for name in TORQUES])
    np.testing.assert_allclose(shares, np.tile(shares[0], (len(TORQUES), 1)))
    return shares[0]


def test_weak_motors_have_less_torque(new: MotorParameters):
    np.testing.assert_allclose(left(WEAR["weak"](new, 5), new), WEAK)


def test_worn_motors_have_more_play_and_friction(new: MotorParameters):
    worn = WEAR["worn"](new, 5)
    np.testing.assert_allclose(left(worn, new), 1.0)
    np.testing.assert_allclose(worn.backlash, PLAY * new.backlash)
    for name in ("coulomb", "load_friction"):
        np.testing.assert_allclose(getattr(worn, name), FRICTION * getattr(new, name))


def test_any_one_joint_of_a_robot_may_be_damaged(new: MotorParameters):
    shares = np.array([left(WEAR["damaged"](new, number), new) for number in range(40)])
    assert np.all((shares < 1.0).sum(axis=1) == 1) and np.unique(shares).tolist() == pytest.approx([DAMAGED, 1.0])
    assert set(np.argmin(shares, axis=1) % 3) == {0, 1, 2}  # abduction, hip and knee


def test_the_virtual_robot_has_the_worn_motors(new: MotorParameters):
    robot = load_robot(DEFAULT_ROBOT)
    target = np.array(robot.nominal) + 0.3

    def moved(body: TwinBody) -> np.ndarray:
        body.live.advance(100, target)
        return body.live.state().joint_pos

    found = {name: moved(SimulatedPort(robot, 5, hung=True, wear=WEAR[name]).body) for name in WEAR}
    np.testing.assert_array_equal(found["none"], moved(SimulatedPort(robot, 5, hung=True).body))
    for name in ("weak", "worn", "damaged"):
        np.testing.assert_array_equal(found[name], moved(TwinBody(robot, WEAR[name](new, 5), True, 0)))
        assert np.abs(found[name] - found["none"]).max() > 1e-3


def test_figures_of_every_kind_of_wear():
    robots = [VirtualRobot(number, wear) for wear in ("none", "worn") for number in (0, 1)]

    def walks(gain: float) -> dict[str, list[Outcome]]:
        return {CONTROL: [Outcome(2.0, 2.0, None)], "adapted": [Outcome(2.0 + gain, 2.0, None)]}

    pairs = [(robot, walks(1.0 if robot.wear == "worn" else 0.0)) for robot in robots]
    figures = by_wear(pairs, {robot: robot == VirtualRobot(1, "worn") for robot in robots})
    assert [figures[f"{kind}adapted/gain_path_m/p50"] for kind in ("", "none/", "worn/")] == [0.5, 0.0, 1.0]
    assert [figures[f"{kind}pairs"] for kind in ("", "none/", "worn/")] == [4.0, 2.0, 2.0]
    assert [figures[f"{kind}robots_unlike_the_prior"] for kind in ("", "none/", "worn/")] == [1.0, 0.0, 1.0]
    alone = by_wear(pairs[2:], {robot: False for robot in robots[2:]})
    assert alone["adapted/gain_path_m/p50"] == 1.0 and not any("worn" in key for key in alone)


def test_no_two_kinds_share_a_file():
    out = Path("loop")
    kinds = (["none"], ["weak"], ["none", "weak"], ["weak", "worn"])
    names = [figures_file(out, 0.5, wear).name for wear in kinds]
    assert names == [f"figures_0.5{rest}.json" for rest in ("", "_weak", "_none_weak", "_weak_worn")]
    assert figures_file(out, 0.5, ["weak"], (0.6, 1.0)).name == "figures_0.5_weak_limit_0.6_1.json"
    assert {VirtualRobot(1).folder(out), VirtualRobot(1, "worn").folder(out)} == {out / "robot_1", out / "robot_1_worn"}
