"""A legged URDF as ROS writes it becomes a robot, or is refused in the terms of URDF."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from dog import LEGS_TOML, quadruped, written

from motorprior.exceptions import ArtifactError
from motorprior.robots.build_model import build_model
from motorprior.robots.load import load_robot

SIDES = {"FR": (0.2, -0.1), "FL": (0.2, 0.1), "RR": (-0.2, -0.1), "RL": (-0.2, 0.1)}
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = '<mesh filename="package://dog_description/meshes/body.obj"/>'


def link(name: str, mass: float, shape: str = '<box size=".05 .05 .1"/>') -> str:
    moment = mass / 1e3  # [kg·m²]
    diagonal = f'ixx="{moment}" iyy="{moment}" izz="{moment}"'
    inertia = f'<mass value="{mass}"/><inertia {diagonal} ixy="0" ixz="0" iyz="0"/>'
    collision = f"<collision><geometry>{shape}</geometry></collision>"

    return f'<link name="{name}"><inertial>{inertia}</inertial>{collision}</link>'


def joint(
    name: str, parent: str, child: str, origin: str, axis: str, joint_type: str = "revolute"
) -> str:
    limit = ""
    if joint_type == "revolute":
        limit = '<limit lower="-2.8" upper="2.8" effort="3" velocity="20"/>'

    return (
        f'<joint name="{name}" type="{joint_type}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def urdf() -> str:
    """A quadruped: the base is the root link, and feet are links on fixed joints."""
    elements = [link("body", 3.0)]
    for leg, (x, y) in SIDES.items():
        elements += [
            link(f"{leg}_hip", 0.2),
            joint(f"{leg}_a", "body", f"{leg}_hip", f"{x} {y} 0", "1 0 0"),
            link(f"{leg}_thigh", 0.4),
            joint(f"{leg}_h", f"{leg}_hip", f"{leg}_thigh", "0 0 0", "0 1 0"),
            link(f"{leg}_shank", 0.1),
            joint(f"{leg}_k", f"{leg}_thigh", f"{leg}_shank", "0 0 -.2", "0 1 0"),
            link(leg, 0.02, '<sphere radius=".02"/>'),
            joint(f"{leg}_f", f"{leg}_shank", leg, "0 0 -.2", "1 0 0", "fixed"),
        ]

    return '<robot name="dog">' + "".join(elements) + "</robot>"


def robot_file(folder: Path, text: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dog.urdf").write_text(text)
    (folder / "dog.toml").write_text(LEGS_TOML.replace("dog.xml", "dog.urdf"))

    return folder / "dog.toml"


def test_a_urdf_stands_on_the_links_that_are_its_feet(tmp_path: Path):
    robot = load_robot(robot_file(tmp_path, urdf()))

    assert robot.standing_height == pytest.approx(0.4 * np.cos(0.8) + 0.02)
    assert robot.weight == pytest.approx(9.81 * (3.0 + 4 * 0.72))
    assert not robot.leg_mismatch
    for leg in robot.legs:
        assert (leg.thigh, leg.shank, leg.foot_radius) == pytest.approx((0.2, 0.2, 0.02))

    model = build_model(robot)
    suspended_model = build_model(robot, suspended=True)

    assert (model.nq, model.npair, suspended_model.nq) == (19, 4, 12)
    assert model.nbody - 1 == suspended_model.nbody - 1 == robot.num_links

    data = mujoco.MjData(model)
    data.qpos[7:] = robot.nominal_pose
    mujoco.mj_step(model, data)

    assert data.ncon == 0
    assert np.isfinite(data.qpos).all()


def test_a_world_link_with_a_floating_joint_is_the_same_robot(tmp_path: Path):
    root = joint("root", "world", "body", "0 0 0", "1 0 0", "floating")
    world = f'<robot name="dog"><link name="world"/>{root}'
    robot = load_robot(robot_file(tmp_path, urdf().replace('<robot name="dog">', world)))

    assert build_model(robot).nq == 19


def test_the_mesh_of_a_package_is_read_or_left_out(tmp_path: Path):
    text = urdf().replace('<box size=".05 .05 .1"/>', MESH, 1)
    without = load_robot(robot_file(tmp_path / "urdf", text))

    assert build_model(without).nmesh == 0

    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "body.obj").write_text(TETRAHEDRON)
    robot = load_robot(tmp_path / "urdf" / "dog.toml")

    assert build_model(robot).nmesh == 1
    assert robot.files[-1].name == "body.obj"
    assert robot.weight == pytest.approx(without.weight)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ('"FR_k" type="revolute"', '"FR_k" type="continuous"'),
            "'FR_k'.*type=\"revolute\" and <limit",
        ),
        (
            ('"FR_k" type="revolute">', '"FR_k" type="revolute"><mimic joint="FR_h"/>'),
            "'FR_k' to 'FR_h' .*fixed",
        ),
        (
            ('"FR_k" type="revolute"', '"FR_k" type="prismatic"'),
            "'FR_k'.*type=\"fixed\"",
        ),
        (
            ('ixx="0.0002" iyy="0.0002" izz="0.0002"', 'ixx="2000" iyy="2000" izz="2000"'),
            "'FR_hip' .*2e.03 kg·m².*100 m",
        ),
        (
            ('<link name="FR">', '<link name="toe">'),
            "'FR' .*<collision>",
        ),
        (('<inertial><mass value="3.0"/>', "<!--"), "body.obj"),
    ],
)
def test_an_invalid_urdf_is_refused_with_the_name_and_a_remedy_in_terms_of_urdf(
    tmp_path: Path, change: tuple[str, str], words: str
):
    text = urdf()

    assert change[0] in text

    link = "toe" if "toe" in change[1] else "FR"
    text = text.replace(change[0], change[1], 1).replace(
        '<child link="FR"/>', f'<child link="{link}"/>'
    )

    if "<!--" in change[1]:
        text = text.replace("</inertial>", "-->", 1).replace('<box size=".05 .05 .1"/>', MESH, 1)

    with pytest.raises(ArtifactError, match=words) as refused:
        load_robot(robot_file(tmp_path, text))
    assert refused.value.remedy
    assert "<freejoint" not in str(refused.value)


def test_a_foot_of_an_mjcf_may_be_a_body_with_one_sphere(tmp_path: Path):
    xml = quadruped().replace('<geom name="FR" size', "<geom size")
    xml = xml.replace('<body pos="0 0 -0.2">', '<body name="FR" pos="0 0 -0.2">', 1)

    with pytest.raises(ArtifactError, match="'FR'"):
        load_robot(written(tmp_path, LEGS_TOML, "dog", xml))

    sphere_of_shank = '<geom size="0.02" pos="0 0 -0.1" mass="0.1"/>'
    with_one_sphere = xml.replace(sphere_of_shank, "", 1)
    robot = load_robot(written(tmp_path, LEGS_TOML, "dog", with_one_sphere))

    assert robot.legs[0].foot == "FR"


def test_an_mjcf_with_coupled_joints_is_refused(tmp_path: Path):
    equality = '<equality><joint joint1="FR_k" joint2="FL_k"/></equality>'
    xml = quadruped().replace("</worldbody>", f"</worldbody>{equality}")

    with pytest.raises(ArtifactError, match=r"'FR_k'.*'FL_k'"):
        load_robot(written(tmp_path, LEGS_TOML, "dog", xml))
