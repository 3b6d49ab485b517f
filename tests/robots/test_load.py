"""A robot is loaded from a TOML beside its model; what does not fit is refused with joint, file and remedy."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.body import body_of
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import zero_policy
from motorprior.locomotion.trajectory_generator import open_loop_gait
from motorprior.robots.load import load_robot
from motorprior.robots.model_files import model_files
from motorprior.robots.robot import Gait, Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.build_model import FLOOR, build_model
from motorprior.simulation.playback import replay
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.skeleton import skeleton
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig

ARM = """<mujoco><worldbody><body name="base"><geom size="0.1" mass="1"/>
  <body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0" range="-90 90" armature="0.5"
      frictionloss="0.3"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.4"/>
    <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" range="-120 120"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.2"/></body></body></body></worldbody></mujoco>"""
ARM_TOML = """
name = "arm"
motor = "a servo"
model = "arm.xml"
base = "fixed"
nominal_pose = [0.1, -0.2]
kp = 20.0
kd = 1.0
torque_limit = [4.0, 2.0]
"""
FOOT = "FR"
"""A geom of the quadruped's."""


def quadruped(feet: bool = True) -> str:
    """Four legs of three joints, thigh 0.2 m and shank 0.2 m."""
    legs = ""
    for x, front in ((0.2, "F"), (-0.2, "R")):
        for y, side in ((-0.1, "R"), (0.1, "L")):
            leg = front + side
            foot = f'<geom name="{leg}" size="0.02" pos="0 0 -0.2" mass="0.02"/>' if feet else ""
            legs += f"""
  <body pos="{x} {y} 0"><joint name="{leg}_a" axis="1 0 0" range="-50 50"/><geom size="0.03" mass="0.2"/>
    <body><joint name="{leg}_h" axis="0 1 0" range="-90 180"/><geom size="0.03" pos="0 0 -0.1" mass="0.4"/>
      <body pos="0 0 -0.2"><joint name="{leg}_k" axis="0 1 0" range="-160 0"/>
        <geom size="0.02" pos="0 0 -0.1" mass="0.1"/>{foot}</body></body></body>"""
    return f"""<mujoco><worldbody><body name="body" pos="0 0 1"><freejoint/>
  <geom type="box" size="0.2 0.1 0.05" mass="3"/>{legs}</body></worldbody></mujoco>"""


LEGS_TOML = """
name = "dog"
motor = "a motor"
model = "dog.xml"
base = "free"
nominal_pose = [0.0, 0.8, -1.6]
kp = 20.0
kd = 0.5
torque_limit = 10.0
""" + "".join(
    f'[legs.{leg}]\njoints = ["{leg}_a", "{leg}_h", "{leg}_k"]\nfoot = "{leg}"\nphase = {phase}\n'
    for leg, phase in (("FR", 0.0), ("FL", 0.5), ("RR", 0.5), ("RL", 0.0))
)


def written(folder: Path, toml: str, name: str, xml: str) -> Path:
    (folder / f"{name}.xml").write_text(xml, encoding="utf-8")
    (folder / f"{name}.toml").write_text(toml, encoding="utf-8")
    return folder / f"{name}.toml"


@pytest.fixture
def dog(tmp_path: Path) -> Robot:
    return load_robot(written(tmp_path, LEGS_TOML, "dog", quadruped()))


def test_the_default_robot_is_shipped_and_an_unknown_name_lists_the_known():
    assert load_robot(DEFAULT_ROBOT).num_joints == len(load_robot(DEFAULT_ROBOT).joint_names) > 0
    with pytest.raises(ArtifactError, match=f"no robot 'spot'.*{DEFAULT_ROBOT}"):
        load_robot("spot")


def test_an_arm_is_what_its_two_files_say(tmp_path: Path):
    arm = load_robot(written(tmp_path, ARM_TOML, "arm", ARM))
    assert (arm.name, arm.base, arm.joint_names, arm.num_links) == ("arm", "fixed", ("shoulder", "elbow"), 3)
    np.testing.assert_allclose(arm.limits, np.radians([[-90, 90], [-120, 120]]))
    asked = arm.limits_of(("elbow", "tail"))
    np.testing.assert_allclose(asked, [[-np.radians(120), np.radians(120)], [np.nan, np.nan]])
    assert [(joint.kp, joint.kd, joint.torque_limit) for joint in arm.joints] == [(20.0, 1.0, 4.0), (20.0, 1.0, 2.0)]
    np.testing.assert_array_equal(arm.nominal_pose, [0.1, -0.2])
    with pytest.raises(ConfigError, match="robot 'arm' cannot walk"):
        body_of(arm)


def test_an_arm_is_simulated_on_its_motors_alone(tmp_path: Path):
    arm = load_robot(written(tmp_path, ARM_TOML, "arm", ARM))
    world = World(WorldConfig.of(arm))
    assert not world.model.dof_armature.any() and not world.model.dof_frictionloss.any()  # the file's own are gone
    motors = IdealPd.uniform(2, 40.0, 2.0, 20.0, 0.01)
    target = np.array([0.3, 0.4])
    played = replay(world, motors, np.tile(target, (400, 1)))
    # at rest the PD carries the arm: kp·error = gravity about the joint, with the centres of mass at half length
    shoulder, both = played.joint_pos[-1, 0], played.joint_pos[-1].sum()
    lower = 0.2 * 9.81 * 0.1 * np.cos(both)
    upper = lower + 9.81 * (0.4 * 0.15 + 0.2 * 0.3) * np.cos(shoulder)
    np.testing.assert_allclose(40.0 * (played.joint_pos[-1] - target), [upper, lower], rtol=1e-3)
    np.testing.assert_allclose(played.joint_torque[-1], [-upper, -lower], rtol=1e-3)


def test_legs_get_their_lengths_and_the_height_of_the_base_from_the_model(dog: Robot):
    assert [(leg.thigh, leg.shank, leg.foot_radius) for leg in dog.legs] == [pytest.approx((0.2, 0.2, 0.02))] * 4
    height = 0.4 * np.cos(0.8) + 0.02
    assert dog.standing_height == pytest.approx(height)
    assert dog.legs[0].drop(dog.nominal_pose) == pytest.approx(height)
    world = World(WorldConfig.of(dog))
    assert world.data.qpos[2] == pytest.approx(height)
    assert (world.model.npair, world.model.nu) == (4, 0)


@pytest.mark.parametrize(
    ("turned", "into", "words"),
    [
        ('_h" axis="0 1 0"', '_h" axis="0 -1 0"', "foot 'FR' is"),
        ('_k" axis="0 1 0" range="-160 0"', '_k" axis="0 -1 0" range="-160 160"', "foot 'FR' is"),
        ('_a" axis="1 0 0"', '_a" axis="-1 0 0"', "foot 'FR' goes right as 'FR_a' grows"),
        ('pos="0 0 -0.2" mass="0.02"', 'pos="0.2 0 0" mass="0.02"', "foot 'FR' is"),
    ],
)
def test_legs_that_turn_another_way_load_but_do_not_walk(tmp_path: Path, turned: str, into: str, words: str):
    assert turned in quadruped()
    (tmp_path / "dog.xml").write_text(quadruped().replace(turned, into))
    (tmp_path / "dog.toml").write_text(LEGS_TOML)
    robot = load_robot(tmp_path / "dog.toml")
    with pytest.raises(ConfigError, match=f"cannot walk: .*{words}"):
        robot.require_legs()


def test_a_users_quadruped_trots_in_the_compiled_rollout(dog: Robot):
    motors = IdealPd.uniform(12, 20.0, 0.5, 10.0, 0.01)
    walk = WalkConfig(30, commands=Commands.steady(0.3))
    episode = WalkSimulator(lambda rng: motors, WorldConfig.of(dog), walk).run(zero_policy(12), seed=0, trace=True)
    assert episode.fault == 0 and episode.trace.shape == (episode.steps, 19)
    targets = open_loop_gait(body_of(dog), 80, 0.3, 1.25, 0.0, 1.0, dog.control_dt).reshape(-1, 4, 3)
    front_right, front_left, rear_right, rear_left = targets.swapaxes(0, 1)
    np.testing.assert_allclose(front_right, rear_left)
    np.testing.assert_allclose(front_right[:40], front_left[40:], atol=1e-9)  # half a cycle of 0.8 s apart
    assert np.ptp(rear_right[:, 2]) > 0.3


def test_a_users_quadruped_has_the_gait_of_its_size(dog: Robot):
    hips = 0.4 * np.cos(0.8) + 0.02
    gait = dog.require_legs()
    assert gait.frequency == 3.0
    assert gait.swing_height == pytest.approx(0.24 * hips, abs=5e-4)
    speed = np.sqrt(9.81 * hips)
    assert gait.forward == pytest.approx((-0.16 * speed, 0.5 * speed), abs=0.005)
    assert (gait.yaw_rate, gait.residual) == (0.6, 0.3)
    body = body_of(dog)
    assert (body.slowest, body.fastest, body.frequency) == (*gait.forward, gait.frequency)
    np.testing.assert_allclose(np.abs(body.rest[:, :2]), np.tile([0.2, 0.1], (4, 1)), atol=1e-9)  # folded evenly
    np.testing.assert_allclose(body.rest[:, 2:], np.tile([0.0, 0.4 * np.cos(0.8)], (4, 1)), atol=1e-9)


def test_robots_of_equal_froude_number_move_alike():
    small, large = Gait.of_size(0.025), Gait.of_size(0.1)
    assert large.swing_height == pytest.approx(4.0 * small.swing_height)
    assert large.frequency == pytest.approx(0.5 * small.frequency, rel=0.01)
    assert large.forward[1] == pytest.approx(2.0 * small.forward[1], rel=0.02)


def test_large_robots_step_three_times_a_second():
    assert Gait.of_size(0.1).frequency > 3.0
    assert [Gait.of_size(height).frequency for height in (0.15, 0.3, 0.8)] == [3.0, 3.0, 3.0]


def test_the_table_gait_replaces_what_it_names(tmp_path: Path, dog: Robot):
    table = "\n[gait]\nfrequency = 2.5\nforward = [0, 1.5]\nresidual = 0.2\n"
    gait = load_robot(written(tmp_path, LEGS_TOML + table, "dog", quadruped())).require_legs()
    usual = dog.require_legs()
    assert gait == Gait(2.5, usual.swing_height, (0.0, 1.5), usual.yaw_rate, 0.2)
    assert all(isinstance(value, float) for value in (gait.frequency, *gait.forward))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("forward = [0.1, 0.5]", r"\[gait\]: forward \[0.1, 0.5\] m/s is not two speeds with standing still between"),
        ("forward = [-0.5, 0.0]", r"forward \[-0.5, 0.0\] m/s is not two speeds.*0 or negative, then the fastest"),
        ("forward = [-0.2, 0.1, 0.5]", r"forward \[-0.2, 0.1, 0.5\] m/s is not two speeds"),
        ("forward = [0.5]", r"forward"),
        ("forward = 0.5", r"forward = 0.5 is not"),
        ("forward = [-0.2, 11.0]", r"forward = \[-0.2, 11.0\] is not"),
        ("frequency = 0.0", r"frequency = 0 is not a finite number from 0.2 to 10"),
        ("swing_height = -0.1", r"swing_height = -0.1 is not"),
        ("yaw_rate = -1.0", r"yaw_rate = -1 is not"),
        ('residual = "some"', r"residual = 'some' is not"),
        ("amplitude = 0.5", r"unknown keys \['amplitude'\].*the keys are"),
    ],
)
def test_a_gait_that_no_robot_can_walk_is_refused_with_key_and_remedy(tmp_path: Path, line: str, words: str):
    with pytest.raises(ArtifactError, match=words) as refused:
        load_robot(written(tmp_path, f"{LEGS_TOML}\n[gait]\n{line}\n", "dog", quadruped()))
    assert refused.value.remedy and "dog.toml" in str(refused.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("[0.1, -0.2]", "[0.1, -0.2, 0.3]"), "nominal_pose has 3 numbers.*give 1 or 2 numbers"),
        (("[0.1, -0.2]", "[0.1, -9.0]"), "nominal_pose -9 rad of joint 'elbow' is outside its limits"),
        (("kp = 20.0", "kp = -1"), "kp -1 of joint 'shoulder' is not above 0"),
        (("kp = 20.0", 'kp = "stiff"'), "kp = 'stiff' is not a number, or a list of numbers"),
        (("kp = 20.0", "kP = 20.0"), r"unknown keys \['kP'\] and missing keys \['kp'\].*the keys are"),
        (("arm.xml", "leg.xml"), "leg.xml: no such model file"),
        (("fixed", "flying"), "base = 'flying' is not free or fixed"),
        (('"fixed"', '"free"'), "arm.xml: its base is free, but the model has no free joint"),
        (('name = "arm"', 'name = "arm"\njoints = ["shoulder", "wrist"]'), "no joint 'wrist'.*shoulder, elbow"),
        (('name = "arm"', 'name = "arm"\njoints = ["shoulder"]'), "joint 'elbow' of the model is not in.*weld it"),
        (('name = "arm"', 'name = "arm"\njoints = ["elbow", "shoulder"]'), "another order.*list them as"),
        (("name", "name = 1\nname"), "not valid TOML"),
        (('"arm"', f'"{DEFAULT_ROBOT}"'), "name '.*' is a shipped robot's"),
        (('"arm"', '"an arm"'), "name 'an arm' .* other characters"),
        (("kp = 20.0", "kp = 20.0\nphysics_dt = 0.003"), "physics_dt 0.003 s does not divide control_dt 0.01 s"),
        (("kp = 20.0", "kp = 20.0\nload_inertia = [2.0, 1.0]"), r"load_inertia \[2.0, 1.0\] is no range"),
    ],
)
def test_a_description_that_does_not_fit_is_refused_with_key_and_remedy(tmp_path: Path, change, words: str):
    path = written(tmp_path, ARM_TOML.replace(*change), "arm", ARM)
    with pytest.raises(ArtifactError, match=words) as refused:
        load_robot(path)
    assert refused.value.remedy and str(tmp_path) in str(refused.value)


ACTUATOR = '<actuator><motor name="pull" joint="elbow"/></actuator></mujoco>'


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((' range="-120 120"', ""), "joint 'elbow' has no limits.*give it range"),
        (("</mujoco>", ACTUATOR), "1 actuators of its own, the first is 'pull'.*delete the <actuator> section"),
        (('name="elbow"', ""), r"joint number 1 \(''\) is no hinge with a name"),
        (('name="elbow"', 'type="slide" name="elbow"'), r"joint number 1 \('elbow'\) is no hinge"),
        (("</worldbody>", '<body><geom size="0.1"/></body></worldbody>'), "the world holds 2 bodies"),
        (("<mujoco>", "<mujoco><nonsense/>"), "MuJoCo cannot read it"),
    ],
)
def test_a_model_that_does_not_fit_is_refused_with_joint_file_and_remedy(tmp_path: Path, change, words: str):
    path = written(tmp_path, ARM_TOML, "arm", ARM.replace(*change))
    with pytest.raises(ArtifactError, match=f"arm.xml: .*{words}") as refused:
        load_robot(path)
    assert refused.value.remedy


def test_nothing_of_the_current_folder_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A robot's folder may come from anywhere."""
    (tmp_path / "resource.py").write_text("open('ran', 'w')")
    path = written(tmp_path, ARM_TOML, "arm", ARM)
    monkeypatch.chdir(tmp_path)
    assert load_robot(path).name == "arm" and not (tmp_path / "ran").exists()


def test_a_part_of_the_model_that_changed_meanwhile_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = written(tmp_path, ARM_TOML, "arm", '<mujoco><include file="part.xml"/></mujoco>')
    (tmp_path / "part.xml").write_text(ARM)
    assert load_robot(path).num_joints == 2
    (tmp_path / "part.xml").write_text("<mujoco><nonsense/></mujoco>")
    with pytest.raises(ArtifactError, match=r"arm\.xml: MuJoCo cannot read it"):
        load_robot(path)


def test_the_models_own_actuators_are_removed_where_the_user_says_so(tmp_path: Path):
    toml = ARM_TOML.replace('base = "fixed"', 'base = "fixed"\nactuators = "remove"')
    arm = load_robot(written(tmp_path, toml, "arm", ARM.replace("</mujoco>", ACTUATOR)))
    assert World(WorldConfig.of(arm)).model.nu == 0


@pytest.mark.parametrize(
    ("toml", "xml", "words"),
    [
        (LEGS_TOML, quadruped(feet=False), "no foot 'FR' among its geoms.*none has a name"),
        (LEGS_TOML.replace('foot = "FR"', 'foot = "toe"'), quadruped(), "no foot 'toe'.*its geoms are FR"),
        (
            LEGS_TOML.replace("phase = 0.5", "phase = 1.5"),
            quadruped(),
            "phase = 1.5 is not a finite number from 0 to 1",
        ),
        (LEGS_TOML.replace('"FR_k"', '"FR_x"'), quadruped(), "are not three joints of the robot"),
        (LEGS_TOML.replace('"FR_k"', '"FR_h"'), quadruped(), "are not three joints of the robot"),
        (LEGS_TOML.replace('"FL_k"', '"FR_k"'), quadruped(), "joint 'FR_k' is in two legs"),
        (LEGS_TOML.replace('foot = "FL"', 'foot = "FR"'), quadruped(), "foot 'FR' is in two legs"),
        (
            LEGS_TOML[: LEGS_TOML.index("[legs")] + "[legs]\nFL = 3",
            quadruped(),
            r"legs.FL\]: its content is not a table",
        ),
        (LEGS_TOML.replace('"free"', '"fixed"'), quadruped(), "its base is fixed, but the model has a free joint"),
    ],
)
def test_legs_that_do_not_fit_are_refused(tmp_path: Path, toml: str, xml: str, words: str):
    with pytest.raises(ArtifactError, match=words) as refused:
        load_robot(written(tmp_path, toml, "dog", xml))
    assert refused.value.remedy


def test_a_model_that_changed_since_it_was_loaded_is_refused(tmp_path: Path):
    arm = load_robot(written(tmp_path, ARM_TOML, "arm", ARM))
    (tmp_path / "arm.xml").write_text(ARM.replace("0.4", "0.5"), encoding="utf-8")
    with pytest.raises(ArtifactError, match="the model is gone or has changed"):
        World(WorldConfig.of(arm))


def test_what_a_model_includes_is_part_of_it(tmp_path: Path):
    """Meshes, too: their shape may be their inertia."""
    path = written(tmp_path, ARM_TOML, "arm", '<mujoco><include file="parts/upper.xml"/></mujoco>')
    corners = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
    part = ARM.replace("<worldbody>", f'<asset><mesh name="m" vertex="{corners}"/></asset><worldbody>', 1)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "upper.xml").write_text(part)
    arm = load_robot(path)
    assert [file.name for file in arm.files] == ["arm.toml", "arm.xml", "upper.xml"]
    build_model(arm)
    (tmp_path / "parts" / "upper.xml").write_text(part.replace('mass="0.4"', 'mass="4"'))
    with pytest.raises(ArtifactError, match=r"arm\.xml: the model is gone or has changed -> load the robot again"):
        build_model(arm)
    assert load_robot(path).weight > 2.0 * arm.weight


def test_meshes_are_found_where_the_compiler_looks_for_them(tmp_path: Path):
    (tmp_path / "meshes").mkdir()
    for name in ("a.stl", "meshes/b.stl"):
        (tmp_path / name).write_text("solid")
    urdf = '<robot name="r"><mesh filename="package://somewhere/b.stl"/><mesh filename="gone.stl"/></robot>'
    (tmp_path / "arm.urdf").write_text(urdf.replace("<mesh", '<mujoco><compiler meshdir="meshes"/></mujoco><mesh', 1))
    (tmp_path / "arm.xml").write_text('<mujoco><model file="arm.urdf"/><asset><mesh file="a.stl"/></asset></mujoco>')
    assert {file.name for file in model_files(tmp_path / "arm.xml")} == {"arm.xml", "arm.urdf", "a.stl", "b.stl"}


def test_a_floor_sensors_and_contacts_of_the_models_own_are_no_trouble(tmp_path: Path):
    own = """<contact><pair geom1="floor" geom2="FR"/></contact>
  <actuator><motor name="m" joint="FR_k"/></actuator><sensor><actuatorfrc actuator="m"/></sensor></mujoco>"""
    xml = quadruped().replace("<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>', 1)
    toml = LEGS_TOML.replace('base = "free"', 'base = "free"\nactuators = "remove"')
    model = build_model(load_robot(written(tmp_path, toml, "dog", xml.replace("</mujoco>", own))))
    assert (model.npair, model.nsensor, model.nu) == (4, 0, 0)


def test_a_model_that_cannot_be_changed_is_an_error_of_its_file(tmp_path: Path):
    xml = quadruped().replace("<worldbody>", f'<worldbody><geom name="{FLOOR}" size="1"/>', 1)
    dog = load_robot(written(tmp_path, LEGS_TOML, "dog", xml))
    with pytest.raises(ArtifactError, match=r"dog\.xml: MuJoCo cannot read it .*repeated name"):
        build_model(dog)


def test_a_base_without_a_shape_is_drawn_around_its_legs(tmp_path: Path):
    bare = quadruped().replace(
        '<geom type="box" size="0.2 0.1 0.05" mass="3"/>', '<inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>'
    )
    dog = load_robot(written(tmp_path, LEGS_TOML, "dog", bare))
    pose = np.concatenate([[0.0, 0.0, dog.standing_height, 1.0, 0.0, 0.0, 0.0], dog.nominal_pose])
    (chassis,) = skeleton(dog, pose[None]).chassis
    np.testing.assert_allclose(np.ptp(chassis, axis=0), [0.4, 0.2, 0.04], atol=1e-9)
    np.testing.assert_allclose(chassis.mean(axis=0), pose[:3], atol=1e-9)


@pytest.mark.parametrize(("name", "joints"), [("go2", 12), ("so101", 6)])
def test_published_models_load(shared_data: Path, tmp_path: Path, name: str, joints: int):
    source = shared_data / "robots" / f"{name}.xml"
    if not source.is_file():
        pytest.skip(f"no {name}.xml in {shared_data}")
    (tmp_path / source.name).write_bytes(source.read_bytes())
    base = "free" if name == "go2" else "fixed"
    pose = "[0.0, 0.9, -1.8]" if name == "go2" else "0.0"
    legs = "".join(
        f'[legs.{leg}]\njoints = ["{leg}_hip_joint", "{leg}_thigh_joint", "{leg}_calf_joint"]\nfoot = "{leg}"\n'
        f"phase = {phase}\n"
        for leg, phase in (("FL", 0.5), ("FR", 0.0), ("RL", 0.0), ("RR", 0.5))
    )
    toml = (
        f'name = "{name}"\nmotor = "m"\nmodel = "{name}.xml"\nactuators = "remove"\nbase = "{base}"\n'
        f"nominal_pose = {pose}\nkp = 20\nkd = 0.5\ntorque_limit = 20\n{legs if name == 'go2' else ''}"
    )
    (tmp_path / "robot.toml").write_text(toml, encoding="utf-8")
    robot = load_robot(tmp_path / "robot.toml")
    assert robot.num_joints == joints
    played = replay(World(WorldConfig.of(robot)), IdealPd.uniform(joints, 20.0, 1.0, 20.0, 0.01),
                    np.tile(robot.nominal_pose, (50, 1)))  # fmt: skip
    assert np.isfinite(played.joint_pos).all()
