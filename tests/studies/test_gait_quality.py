"""Measures of constructed walks with known values."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.locomotion.control_step import follow_command, new_gait
from motorprior.locomotion.gait import walker_arrays
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.simulation.scene import Episode
from motorprior.studies.gait_quality import gait_quality, walk_metrics

DT = ROBOT.control_dt
STEPS = 500
JOINTS = ROBOT.num_joints
TIME = DT * np.arange(STEPS)
Series = np.ndarray | float


def gliding(
    speed: float = 0.3,
    aside: float = 0.0,
    yaw: Series = 0.0,
    steps: int = STEPS,
    height: Series = 0.0,
) -> Episode:
    """Walk of a robot in the nominal pose that glides along its heading.

    ``height`` is the height of its feet above the floor [m], ``aside`` its speed to the left [m/s].
    """
    heading = np.broadcast_to(yaw, (STEPS,))
    along = np.stack([np.cos(heading), np.sin(heading)])
    left = np.stack([-np.sin(heading), np.cos(heading)])
    velocity = speed * along + aside * left

    trace = np.zeros((STEPS, 7 + JOINTS))
    trace[1:, :2] = DT * np.cumsum(velocity.T[:-1], axis=0)
    trace[:, 2] = ROBOT.standing_height + height
    trace[:, 3] = np.cos(heading / 2)
    trace[:, 6] = np.sin(heading / 2)
    trace[:, 7:] = ROBOT.nominal_pose

    motion = np.zeros((STEPS, 6 + 2 * JOINTS))
    motion[:, :2] = velocity.T

    return Episode(
        total=0.0,
        steps=steps,
        speed_error=0.0,
        displacement=trace[-1, :2],
        fault=0,
        mean=np.zeros(23),
        m2=np.zeros(23),
        trace=trace[:steps],
        motion=motion[:steps],
    )


def measured(episode: Episode, forward: float = 0.3, yaw_rate: float = 0.0) -> dict[str, float]:
    return gait_quality(ROBOT, episode, forward, yaw_rate, STEPS)


def test_a_walk_that_follows_its_command_has_no_error():
    quality = measured(gliding(height=0.1))
    assert quality["speed"] == pytest.approx(0.3)
    assert quality["upright"] == 1.0
    for name in ("speed_error", "heading_deg_per_m", "lateral_share", "slip"):
        assert quality[name] == pytest.approx(0.0, abs=1e-9), name


def test_speed_is_along_the_heading():
    assert measured(gliding(0.3, aside=0.15, yaw=0.5))["speed"] == pytest.approx(0.3)
    assert measured(gliding(-0.1), forward=-0.2)["speed"] == pytest.approx(-0.1)


def test_the_error_of_the_speed_is_relative_to_the_command():
    assert measured(gliding(0.27))["speed_error"] == pytest.approx(0.1)
    assert measured(gliding(-0.1), forward=-0.2)["speed_error"] == pytest.approx(0.5)

    slow = measured(gliding(0.04), forward=0.05)
    assert slow["speed_error"] == pytest.approx(0.2), "a tenth of the fastest command, 0.5 m/s"


def test_the_lateral_share_is_relative_to_the_commanded_line():
    assert measured(gliding(0.3, aside=0.015))["lateral_share"] == pytest.approx(0.05)
    assert measured(gliding(0.3, aside=-0.015, yaw=2.5))["lateral_share"] == pytest.approx(0.05)


def test_the_heading_drift_is_per_metre_after_the_first_second():
    drift = measured(gliding(0.3, yaw=0.1 * TIME))["heading_deg_per_m"]
    metres = 0.3 * (STEPS - 1 - 100) * DT
    assert drift == pytest.approx(np.degrees(0.1 * TIME[-1]) / metres)


def test_a_commanded_turn_is_no_error():
    yaw = commanded_heading(0.6)
    quality = measured(gliding(0.3, yaw=yaw), yaw_rate=0.6)
    assert quality["heading_deg_per_m"] == pytest.approx(0.0, abs=1e-6)
    assert quality["lateral_share"] == pytest.approx(0.0, abs=1e-9)

    too_slow = measured(gliding(0.3, yaw=0.8 * yaw), yaw_rate=0.6)
    assert too_slow["heading_deg_per_m"] > 10.0


def commanded_heading(rate: float) -> np.ndarray:
    """(steps,) headings [rad] before every control step of a robot that turns as commanded."""
    walker = walker_arrays(ROBOT)
    gait = new_gait(walker)
    headings = [0.0]
    for _ in range(STEPS - 1):
        gait.observation[:] = 0.0
        follow_command(walker, gait, 0.3, rate)
        headings.append(headings[-1] + DT * gait.velocity_command[1])
    return np.array(headings)


def test_foot_lift_is_the_median_of_the_maximum_clearance_of_swings():
    hop, phase = np.divmod(np.arange(STEPS), 35)
    lifts = np.zeros(15)  # of all feet, in every hop [m]
    lifts[[4, 6, 8]] = 0.01, 0.03, 0.02
    lifts[10] = 0.001  # below 2 mm
    lifts[14] = 0.9  # does not end
    hopping = gliding(height=lifts[hop] * np.maximum(0.0, -np.cos(2.0 * np.pi * phase / 35)))

    assert foot_lifts(hopping) == pytest.approx([20.0] * 4, abs=0.2)
    measured_time = (STEPS - 100) * DT  # after the first second
    assert measured(hopping)["step_frequency"] == pytest.approx(3 / measured_time)
    assert foot_lifts(gliding(height=0.0)) == pytest.approx([0.0] * 4, abs=0.2)


def foot_lifts(episode: Episode) -> list[float]:
    """Lift of every leg [mm]."""
    quality = measured(episode)
    return [quality[f"foot_lift_mm/{leg.name}"] for leg in ROBOT.legs]


def test_cost_of_transport_is_work_over_weight_and_distance():
    episode = gliding(height=0.1)
    velocity = episode.motion[:, 6 : 6 + JOINTS]
    torque = episode.motion[:, 6 + JOINTS :]
    velocity[:, 3] = -2.0
    torque[:, 3] = 0.6
    torque[:, 5] = 1.1  # on a joint at rest

    # 0.6 N·m · 2 rad/s
    cost = 1.2 / (ROBOT.weight * 0.3)
    assert measured(episode)["cost_of_transport"] == pytest.approx(cost)


def test_a_walk_is_measured_up_to_its_fall():
    fell = measured(gliding(0.3, steps=300))
    assert fell["upright"] == 0.0
    assert fell["speed"] == pytest.approx(0.3)
    assert measured(replace(gliding(), fault=1))["upright"] == 0.0

    tumbling = gliding(0.3, steps=300)
    tumbling.motion[-45:, 3:5] = 9.0
    assert measured(tumbling)["body_rate"] == pytest.approx(fell["body_rate"])


def test_an_early_fall_has_speed_zero():
    second_left = measured(gliding(0.3, steps=250))
    assert second_left["speed"] == pytest.approx(0.3)

    less_than_a_second_left = measured(gliding(0.3, steps=249))
    assert less_than_a_second_left["speed"] == 0.0

    nothing_left = measured(gliding(steps=150))
    assert nothing_left == {"upright": 0.0, "speed": 0.0, "speed_error": 1.0}


def test_metrics_of_a_study_include_the_time_after_a_fall():
    walked = walk_metrics(ROBOT, gliding(0.3, aside=0.03), 0.3, STEPS)
    assert walked["speed"] == pytest.approx(0.3, rel=0.01)
    assert walked["upright"] == 1.0
    assert walked["drift"] == pytest.approx(0.15, rel=0.01)

    fell = walk_metrics(ROBOT, gliding(0.3, aside=0.03, steps=300), 0.3, STEPS)
    assert fell["upright"] == 299 / 500
    assert np.isnan(fell["drift"])


def test_without_velocities_of_the_engine_they_are_differences_of_the_poses():
    quality = measured(replace(gliding(), motion=np.zeros((0, 6 + 2 * JOINTS))))
    assert quality["slip"] == pytest.approx(1.0, rel=0.01)
    assert np.isnan(quality["cost_of_transport"])
