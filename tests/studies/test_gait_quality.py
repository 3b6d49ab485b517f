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
    """A robot in the nominal pose that glides, its feet this high above the floor [m], along its heading."""
    heading = np.broadcast_to(yaw, (STEPS,))
    along = np.stack([np.cos(heading), np.sin(heading)])
    left = np.stack([-np.sin(heading), np.cos(heading)])
    velocity = speed * along + aside * left
    trace = np.zeros((STEPS, 7 + JOINTS))
    motion = np.zeros((STEPS, 6 + 2 * JOINTS))
    trace[1:, :2] = DT * np.cumsum(velocity.T[:-1], axis=0)
    trace[:, 2] = ROBOT.standing_height + height
    trace[:, 3] = np.cos(heading / 2)
    trace[:, 6] = np.sin(heading / 2)
    trace[:, 7:] = ROBOT.nominal_pose
    motion[:, :2] = velocity.T
    nothing = np.zeros(23)
    return Episode(
        0.0, steps, 0.0, trace[-1, :2], 0, nothing, nothing, trace[:steps], motion[:steps]
    )


def measured(episode: Episode, forward: float = 0.3, yaw_rate: float = 0.0) -> dict[str, float]:
    return gait_quality(ROBOT, episode, forward, yaw_rate, STEPS)


def test_a_walk_that_follows_its_command_has_no_error():
    found = measured(gliding(height=0.1))
    assert found["speed"] == pytest.approx(0.3) and found["upright"] == 1.0
    for name in ("speed_error", "heading_deg_per_m", "lateral_share", "slip"):
        assert found[name] == pytest.approx(0.0, abs=1e-9), name


def test_speed_is_along_the_heading_and_its_error_relative_to_the_command():
    assert measured(gliding(0.27))["speed_error"] == pytest.approx(0.1)
    away = measured(gliding(0.3, aside=0.15, yaw=0.5))
    assert away["speed"] == pytest.approx(0.3)
    backward = measured(gliding(-0.1), forward=-0.2)
    assert (backward["speed"], backward["speed_error"]) == (pytest.approx(-0.1), pytest.approx(0.5))
    slowly = measured(gliding(0.04), forward=0.05)
    assert slowly["speed_error"] == pytest.approx(0.2), "a tenth of the fastest command, 0.5 m/s"


def test_lateral_share_is_relative_to_the_commanded_line_and_heading_drift_per_metre():
    assert measured(gliding(0.3, aside=0.015))["lateral_share"] == pytest.approx(0.05)
    assert measured(gliding(0.3, aside=-0.015, yaw=2.5))["lateral_share"] == pytest.approx(0.05)
    way = 0.3 * (STEPS - 1 - 100) * DT
    found = measured(gliding(0.3, yaw=0.1 * TIME))["heading_deg_per_m"]
    assert found == pytest.approx(np.degrees(0.1 * TIME[-1]) / way)


def test_a_commanded_turn_is_no_error():
    yaw = commanded_heading(0.6)
    found = measured(gliding(0.3, yaw=yaw), yaw_rate=0.6)
    assert found["heading_deg_per_m"] == pytest.approx(0.0, abs=1e-6)
    assert found["lateral_share"] == pytest.approx(0.0, abs=1e-9)
    assert measured(gliding(0.3, yaw=0.8 * yaw), yaw_rate=0.6)["heading_deg_per_m"] > 10.0


def commanded_heading(rate: float) -> np.ndarray:
    """(steps,) heading [rad] before every control step that follows `follow_command` exactly."""
    walker = walker_arrays(ROBOT)
    gait = new_gait(walker_arrays(ROBOT))
    headings = [0.0]
    for _ in range(STEPS - 1):
        gait.observation[:] = 0.0
        follow_command(walker, gait, 0.3, rate)
        headings.append(headings[-1] + DT * gait.velocity_command[1])
    return np.array(headings)


def test_foot_lift_is_the_median_of_the_maximum_clearance_of_swings():
    step, phase = np.divmod(np.arange(STEPS), 35)  # a swing of all feet in some of the steps
    lifts = np.zeros(15)
    # one is below 2 mm, and the last does not end
    lifts[[4, 6, 8, 10, 14]] = 0.01, 0.03, 0.02, 0.001, 0.9
    hopping = gliding(height=lifts[step] * np.maximum(0.0, -np.cos(2.0 * np.pi * phase / 35)))
    for episode, lift in ((hopping, 20.0), (gliding(height=0.0), 0.0)):
        found = [measured(episode)[f"foot_lift_mm/{leg.name}"] for leg in ROBOT.legs]
        assert found == pytest.approx([lift] * 4, abs=0.2)


def test_cost_of_transport_is_work_over_weight_and_distance():
    episode = gliding(height=0.1)
    velocity = episode.motion[:, 6 : 6 + JOINTS]
    torque = episode.motion[:, 6 + JOINTS :]
    velocity[:, 3] = -2.0
    torque[:, 3] = 0.6
    torque[:, 5] = 1.1
    # only the third joint moves
    assert measured(episode)["cost_of_transport"] == pytest.approx(1.2 / (ROBOT.weight * 0.3))


def test_a_walk_is_measured_up_to_its_fall_and_an_early_fall_has_speed_zero():
    fell = measured(gliding(0.3, steps=300))
    assert fell["upright"] == 0.0 and fell["speed"] == pytest.approx(0.3)
    assert measured(replace(gliding(), fault=1))["upright"] == 0.0
    late = measured(gliding(0.3, steps=250))
    early = measured(gliding(0.3, steps=249))
    assert (late["speed"], early["speed"]) == (pytest.approx(0.3), 0.0), (
        "a second is left, and a little less"
    )
    tumbles = gliding(0.3, steps=300)
    tumbles.motion[-45:, 3:5] = 9.0
    assert measured(tumbles)["body_rate"] == pytest.approx(fell["body_rate"]), (
        "tumbling is not measured"
    )
    assert measured(gliding(steps=150)) == {"upright": 0.0, "speed": 0.0, "speed_error": 1.0}


def test_metrics_of_a_study_include_the_time_after_a_fall():
    walked, fell = (
        walk_metrics(ROBOT, gliding(0.3, aside=0.03, steps=steps), 0.3, STEPS)
        for steps in (STEPS, 300)
    )
    assert walked["speed"] == pytest.approx(0.3, rel=0.01) and walked["upright"] == 1.0
    assert walked["drift"] == pytest.approx(0.15, rel=0.01) and np.isnan(fell["drift"])
    assert fell["upright"] == 299 / 500


def test_without_velocities_of_the_engine_they_are_differences_of_the_poses():
    without = measured(replace(gliding(), motion=np.zeros((0, 6 + 2 * JOINTS))))
    assert without["slip"] == pytest.approx(1.0, rel=0.01) and np.isnan(
        without["cost_of_transport"]
    )
