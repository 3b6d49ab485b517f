"""A robot is loaded from a TOML next to its model, or refused with joint, file and remedy."""

from pathlib import Path

import numpy as np
import pytest
from dog import LEGS_TOML, quadruped, written
from weighed_arm import DESCRIPTION
from weighed_arm import MODEL as ARM

from motorprior.actuator.generic_fleet import generic_parameters
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.exports.cards import from_pretrained
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gait import walker_arrays
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.build_model import build_model
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.playback import replay, simulate
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator
from motorprior.simulation.world import World

EXAMPLES = Path(__file__).parents[2] / "examples" / "robots"
ARM_TOML = DESCRIPTION.replace("nominal_pose = 0.0", "nominal_pose = [0.1, -0.2]")
ARM_TOML = ARM_TOML.replace("5.0", "[4.0, 2.0]")  # the torque limits


@pytest.fixture
def dog(tmp_path: Path) -> Robot:
    return load_robot(written(tmp_path, LEGS_TOML, "dog", quadruped()))


def test_the_default_robot_is_shipped_and_an_unknown_name_is_refused_with_the_shipped_names():
    assert load_robot(DEFAULT_ROBOT).num_joints == len(load_robot(DEFAULT_ROBOT).joint_names) > 0
    with pytest.raises(ArtifactError, match=f"'spot'.*{DEFAULT_ROBOT}"):
        load_robot("spot")


def test_an_arm_has_the_values_of_its_description_and_model(tmp_path: Path):
    arm = load_robot(written(tmp_path, ARM_TOML, "arm", ARM))

    assert (arm.name, arm.base, arm.num_links) == ("arm", "fixed", 2)
    assert arm.joint_names == ("shoulder", "elbow")
    np.testing.assert_allclose([arm.lower, arm.upper], np.radians([[-120, -120], [120, 120]]))

    limits = arm.limits_of(("elbow", "tail"))

    np.testing.assert_allclose(limits, [[-np.radians(120), np.radians(120)], [np.nan, np.nan]])
    assert [joint.kp for joint in arm.joints] == [20.0, 20.0]
    assert [joint.kd for joint in arm.joints] == [0.5, 0.5]
    assert [joint.torque_limit for joint in arm.joints] == [4.0, 2.0]
    np.testing.assert_array_equal(arm.nominal_pose, [0.1, -0.2])

    with pytest.raises(ConfigError, match="'arm'"):
        walker_arrays(arm)


def test_an_arm_may_leave_its_gains_to_a_fit(tmp_path: Path):
    text = ARM_TOML.replace("kp = 20.0\nkd = 0.5\n", "")
    arm = load_robot(written(tmp_path, text, "arm", ARM))

    assert text != ARM_TOML
    assert arm.gains is None
    assert "a fit identifies them" in str(arm)

    # motors of a card have their own gains
    motors = from_pretrained("xl330").sample(arm, seed=0)
    played = simulate(arm, motors, np.full((20, 2), 0.1))

    assert np.all(np.isfinite(played.joint_pos))

    with pytest.raises(ConfigError, match="'arm' has no gains") as refused:
        generic_parameters(arm)
    assert "kp" in str(refused.value.remedy)


def test_legs_need_gains_and_kp_needs_kd(tmp_path: Path):
    for name, text, body in (
        ("arm", ARM_TOML.replace("kd = 0.5\n", ""), ARM),
        ("dog", LEGS_TOML.replace("kp = 20.0\nkd = 0.5\n", ""), quadruped()),
    ):
        with pytest.raises(ArtifactError, match=r"no (kp and no )?kd"):
            load_robot(written(tmp_path, text, name, body))


def test_lengths_of_legs_and_standing_height_come_from_the_model(dog: Robot):
    for leg in dog.legs:
        assert (leg.thigh, leg.shank, leg.foot_radius) == pytest.approx((0.2, 0.2, 0.02))

    # two links of 0.2 m at ±0.8 rad, and the radius of the foot
    height = 0.4 * np.cos(0.8) + 0.02

    assert dog.standing_height == pytest.approx(height)
    assert dog.legs[0].hip_height(dog.nominal_pose) == pytest.approx(height)

    world = World(dog)

    assert world.data.qpos[2] == pytest.approx(height)
    assert (world.model.npair, world.model.nu) == (4, 0)


@pytest.mark.parametrize(
    ("original", "replacement", "words"),
    [
        ('_h" axis="0 1 0"', '_h" axis="0 -1 0"', "foot 'FR' is"),
        ('_a" axis="1 0 0"', '_a" axis="-1 0 0"', "foot 'FR' .*'FR_a'"),
        ('pos="0 0 -0.2" mass="0.02"', 'pos="0.2 0 0" mass="0.02"', "foot 'FR' is"),
    ],
)
def test_a_robot_whose_legs_turn_another_way_loads_but_has_no_gait(
    tmp_path: Path, original: str, replacement: str, words: str
):
    assert original in quadruped()

    (tmp_path / "dog.xml").write_text(quadruped().replace(original, replacement))
    (tmp_path / "dog.toml").write_text(LEGS_TOML)
    robot = load_robot(tmp_path / "dog.toml")

    with pytest.raises(ConfigError, match=words):
        robot.require_gait()


def test_a_users_quadruped_trots_in_the_compiled_rollout(dog: Robot):
    motors = IdealPd.uniform(12, 20.0, 0.5, 10.0, 0.01)
    walk = WalkConfig(30, commands=Commands.steady(0.3))
    simulator = WalkSimulator(Scene(dog, lambda rng: motors, walk))

    episode = simulator.run(PolicyShape(12).untrained(), seed=0, trace=True)

    assert episode.fault == 0
    assert episode.trace.shape == (episode.steps, 19)


def test_a_users_quadruped_has_the_gait_of_its_size(dog: Robot):
    hips = 0.4 * np.cos(0.8) + 0.02  # height [m]

    gait = dog.require_gait()

    assert gait.frequency == 3.0
    assert gait.swing_height == pytest.approx(0.24 * hips, abs=5e-4)

    speed = np.sqrt(9.81 * hips)

    assert gait.forward == pytest.approx((-0.16 * speed, 0.5 * speed), abs=0.005)
    assert (gait.yaw_rate, gait.residual) == (0.6, 0.3)

    feet = walker_arrays(dog).nominal_feet

    # all legs are folded equally
    np.testing.assert_allclose(np.abs(feet[:, :2]), np.tile([0.2, 0.1], (4, 1)), atol=1e-9)
    np.testing.assert_allclose(feet[:, 2:], np.tile([0.0, 0.4 * np.cos(0.8)], (4, 1)), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[0.1, -0.2]", "[0.1, -0.2, 0.3]"), "nominal_pose .*3"),
        (("[0.1, -0.2]", "[0.1, -9.0]"), "nominal_pose -9 rad.*'elbow'"),
        (("kp = 20.0", "kp = -1"), "kp = -1"),
        (("kp = 20.0", "kP = 20.0"), r"'kP'.*\bkp\b"),
        (("arm.xml", "leg.xml"), "leg.xml"),
        (('"fixed"', '"free"'), "arm.xml.*free"),
        (('"arm"', f'"{DEFAULT_ROBOT}"'), f"name = '{DEFAULT_ROBOT}'"),
        (("kp = 20.0", "kp = 20.0\nphysics_dt = 0.003"), "physics_dt 0.003 s.*0.01 s"),
        (("kp = 20.0", "kp = 20.0\nload_inertia = [2.0, 1.0]"), r"load_inertia = \[2.0, 1.0\]"),
        (('"elbow" axis="0 1 0" range="-120 120"', '"elbow" axis="0 1 0"'), "arm.xml: .*'elbow'"),
        (('name="elbow"', 'type="slide" name="elbow"'), "arm.xml: .*'elbow'"),
        (("</worldbody>", '<body><geom size="0.1"/></body></worldbody>'), "arm.xml: .*2 bodies"),
    ],
)
def test_an_invalid_description_or_model_is_refused_with_key_file_and_remedy(
    tmp_path: Path, change: tuple[str, str], words: str
):
    path = written(tmp_path, ARM_TOML.replace(*change), "arm", ARM.replace(*change))

    with pytest.raises(ArtifactError, match=words) as refused:
        load_robot(path)
    assert refused.value.remedy
    assert str(tmp_path) in str(refused.value)


def test_actuators_floor_and_lights_of_a_model_are_removed(tmp_path: Path):
    extra = '<worldbody><light pos="0 0 3"/><geom name="floor" type="plane" size="1 1 .1"/>'
    xml = quadruped().replace("<worldbody>", extra)
    xml = xml.replace(
        "</mujoco>", '<actuator><motor name="pull" joint="FR_k"/></actuator></mujoco>'
    )

    with pytest.raises(ArtifactError, match="'pull'"):
        load_robot(written(tmp_path, LEGS_TOML, "dog", xml))

    toml = LEGS_TOML.replace("base =", 'actuators = "remove"\nbase =')
    model = build_model(load_robot(written(tmp_path, toml, "dog", xml)))

    assert model.nu == model.nlight == 0
    assert list(model.geom_type).count(0) == 1, "only the floor of the simulation"


def test_an_included_file_is_part_of_the_model(tmp_path: Path):
    """Meshes count as well: their shape may give their inertia."""
    path = written(tmp_path, ARM_TOML, "arm", '<mujoco><include file="parts/upper.xml"/></mujoco>')
    corners = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
    part = ARM.replace(
        "<worldbody>", f'<asset><mesh name="m" vertex="{corners}"/></asset><worldbody>', 1
    )
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "upper.xml").write_text(part)
    arm = load_robot(path)

    assert [file.name for file in arm.files] == ["arm.toml", "arm.xml", "upper.xml"]

    build_model(arm)
    (tmp_path / "parts" / "upper.xml").write_text(part.replace('mass="0.5"', 'mass="5"'))

    with pytest.raises(ArtifactError, match=r"arm\.xml"):
        build_model(arm)
    assert load_robot(path).weight > 2.0 * arm.weight


SERVOS = """
[servos]
model = "STS3215"
ids = [4, 2]
signs = [1, -1]
zeros = [2048, 1000]
"""


def test_an_arm_names_its_servos(tmp_path: Path):
    chain = load_robot(written(tmp_path, ARM_TOML + SERVOS, "arm", ARM)).require_servos()

    assert (chain.model, chain.ids) == ("STS3215", (4, 2))
    assert (chain.signs, chain.zeros) == ((1, -1), (2048, 1000))

    with pytest.raises(ConfigError, match=r"\[servos\]"):
        load_robot(written(tmp_path, ARM_TOML, "arm", ARM)).require_servos()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[4, 2]", "[4]", "ids has 1"),
        ("[4, 2]", "[4, 4]", "one id"),
        ("[1, -1]", "[1, 0]", "signs"),
        ("[2048, 1000]", "[0.5, 1]", "zeros"),
        ('model = "STS3215"', "", "model"),
    ],
)
def test_a_wrong_table_of_servos_is_refused(tmp_path: Path, old: str, new: str, words: str):
    with pytest.raises(ArtifactError, match=words):
        load_robot(written(tmp_path, ARM_TOML + SERVOS.replace(old, new), "arm", ARM))


@pytest.mark.parametrize(("name", "joints"), [("go2", 12)])
def test_published_models_load_and_can_be_simulated(
    shared_data: Path, tmp_path: Path, name: str, joints: int
):
    for path in (shared_data / "robots" / f"{name}.xml", EXAMPLES / f"{name}.toml"):
        (tmp_path / path.name).write_bytes(path.read_bytes())

    robot = load_robot(tmp_path / f"{name}.toml")

    assert robot.num_joints == joints

    motors = IdealPd.uniform(joints, 20.0, 1.0, 20.0, 0.01)
    target = np.tile(robot.nominal_pose, (50, 1))

    played = replay(World(robot), motors, target)

    assert np.isfinite(played.joint_pos).all()
