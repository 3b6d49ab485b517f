"""Exports of motors: contents and losses of each format; the user's file stays as it was."""

# pyright: reportMissingImports=false
import json
import re
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from motor_logs import log_of

import motorprior as mp
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial, run
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.exports.bam import BamMotor, read_motor
from motorprior.exports.cards import shipped_cards
from motorprior.exports.exporter import sampled
from motorprior.exports.registry import EXPORTERS, is_supported
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rms

DETAILED = pytest.mark.skipif(not is_supported(EXPORTERS["mjcf-detailed"]), reason="needs MuJoCo 4")

# A model with comments, classes, a second actuator and a default that must stay.
MODEL = """<mujoco model="arm"> <!-- keep > me -->
  <compiler angle="radian" autolimits="true"/>
  <default><joint damping="7"/>
    <default class="big"><motor ctrlrange="-1 1" gear="3"/></default></default>
  <worldbody>
    <body name="upper" pos="0 0 1" quat="0.8 0.6 0 0">
      <joint name="shoulder" axis="0 1 0" armature="0.5" range="-2 2"/><!-- shoulder -->
      <geom type="capsule" fromto="0 0 0 0 0 -0.12" size="0.01" mass="0.5"/>
      <body name="fore" pos="0 0 -0.12">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.2"/>
        <body name="hand" pos="0 0 -0.1"><joint name="wrist" axis="0 0 1"/>
          <geom size="0.01"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="first" class="big" joint="shoulder"/>
    <position name="last" joint="wrist" kp="3"/>
  </actuator>
</mujoco>
"""


def with_joints(model: str, shoulder: str, elbow: str) -> str:
    """The model with other names of two joints, those of a prior."""
    return model.replace('"shoulder"', f'"{shoulder}"').replace('"elbow"', f'"{elbow}"')


@pytest.fixture(scope="module")
def prior() -> MotorPrior:
    return mp.from_pretrained("pupper_v2")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Path]:
    """Path of the model, in the working folder."""
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    with chdir(tmp_path):
        yield path


def simulation_of(path: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Model and state of a file; the state is the first keyframe, if there is one."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    return model, data


def samples_in(folder: Path) -> dict[str, list[list[float]]]:
    """Samples of the constants, (motors, joints) by name, in the table of an export."""
    return json.loads((folder / "motors.json").read_text())["samples"]


TENDON = '<tendon><fixed name="t"><joint joint="{}" coef="1"/></fixed></tendon>{}'
COUPLED = '<equality><joint joint1="wrist" joint2="elbow"/></equality>'


@pytest.mark.parametrize(
    ("format", "options", "value"),
    [
        ("urdf", {}, "urdf"),
        ("mjcf", {}, "mjcf"),
        ("mjcf", {"model": "arm.xml", "joints": ("knee",)}, "knee"),
    ],
)
def test_a_bad_request_is_refused_with_a_remedy(
    prior: MotorPrior, arm: Path, format: str, options: dict, value: str
):
    with pytest.raises(ConfigError, match=value) as refused:
        mp.export(prior, format, arm.parent / "out", **options)

    assert refused.value.remedy


SECOND_ACTUATOR = '<actuator><velocity joint="wrist" kv="1"/></actuator>'
TENDON_MOTOR = TENDON.format("wrist", '<actuator><motor tendon="t"/></actuator>')


@pytest.mark.parametrize(
    ("added", "joints", "value"),
    [
        (SECOND_ACTUATOR, ("wrist",), "2 actuators"),
        (TENDON_MOTOR, ("wrist",), "2 actuators"),
        (COUPLED, ("wrist", "elbow"), "couples"),
    ],
)
def test_a_model_that_would_be_driven_wrongly_is_refused_with_a_remedy(
    prior: MotorPrior, arm: Path, added: str, joints: tuple[str, ...], value: str
):
    arm.write_text(MODEL.replace("</mujoco>", f"{added}</mujoco>"))

    with pytest.raises(ConfigError, match=value) as refused:
        mp.export(prior, "mjcf", arm.parent / "out", model="arm.xml", joints=joints)

    assert refused.value.remedy


def prior_of_commands(prior: MotorPrior, command_mode: str) -> MotorPrior:
    """The prior, as if its logs had commands of this mode."""
    assert isinstance(prior.model, GreyBox)
    return replace(prior, model=replace(prior.model, command_mode=command_mode))


@pytest.mark.parametrize("format", ["mjcf", pytest.param("mjcf-detailed", marks=DETAILED)])
@pytest.mark.parametrize("command_mode", ["velocity", "torque"])
def test_motors_of_velocity_or_torque_commands_are_no_position_servos(
    prior: MotorPrior, arm: Path, format: str, command_mode: str
):
    key = '<key name="home" qpos="0.1 0.2 0.3" qvel="0 0 0" ctrl="5 0.6"/>'
    arm.write_text(MODEL.replace("</actuator>", f"</actuator><keyframe>{key}</keyframe>"))
    source = prior_of_commands(prior, command_mode)

    exported = mp.export(source, format, arm.parent / "out", model=arm, joints=("shoulder",))

    assert command_mode in str(exported)
    assert max(exported.losses.values()) < 0.06, "they move as the learned motors"
    model, data = simulation_of(exported.files[0])
    shoulder = model.actuator("first").id
    assert model.actuator_biasprm[shoulder, 1] == 0.0, "no torque for an angle"
    assert data.ctrl[0] == 0.0, "the angle of the keyframe is no control"


def test_a_format_of_position_servos_refuses_motors_of_other_commands(
    prior: MotorPrior, tmp_path: Path
):
    with pytest.raises(ConfigError, match="torque commands") as refused:
        mp.export(prior_of_commands(prior, "torque"), "bam", tmp_path)

    # its logs have no gains, so none can be given
    assert prior.gains is None
    assert refused.value.remedy == "choose format mjcf or table"


@pytest.mark.parametrize("format", ["mjcf", pytest.param("mjcf-detailed", marks=DETAILED)])
def test_keyframes_keep_their_pose_and_hold_it(prior: MotorPrior, arm: Path, format: str):
    key = '<key name="home" qpos="0.1 0.2 0.3" qvel="1 2 3" ctrl="5 0.6" act="7"/>'
    slow = MODEL.replace('kp="3"', 'kp="3" timeconst="0.1" ctrlrange="-1 1"')
    arm.write_text(slow.replace("</actuator>", f"</actuator><keyframe>{key}</keyframe>"))
    joints = ("elbow", "shoulder", "wrist")

    exported = mp.export(prior, format, arm.parent / "out", model=arm, joints=joints)

    model, data = simulation_of(exported.files[0])
    for joint, pos, vel in (("shoulder", 0.1, 1.0), ("elbow", 0.2, 2.0), ("wrist", 0.3, 3.0)):
        assert data.joint(joint).qpos[0] == pos
        assert data.joint(joint).qvel[0] == vel
        if format == "mjcf-detailed":
            assert abs(data.joint(f"{joint}_rotor").qpos[0] - pos) < 0.05

    # The first control was a torque and becomes the pose; the last one was a position and stays.
    controls = [data.actuator(name).ctrl[0] for name in ("first", "elbow", "last")]
    assert controls == pytest.approx([0.1, 0.2, 0.6])
    assert model.actuator("last").ctrlrange.tolist() == [-1.0, 1.0]
    assert not data.act.any()


@DETAILED
def test_keyframes_keep_the_pose_of_another_body_in_the_frame(prior: MotorPrior, arm: Path):
    base = '<body name="base" pos="1 0 2"><freejoint/><geom size="0.1"/></body>'
    text = MODEL.replace('<body name="upper"', f'<frame>{base}<body name="upper"')
    text = text.replace("</worldbody>", "</frame></worldbody>")
    key = '<keyframe><key qpos="1 0 2 1 0 0 0 0.1 0.2 0.3"/></keyframe>'
    arm.write_text(text.replace("</actuator>", f"</actuator>{key}"))
    out = arm.parent / "out"

    exported = mp.export(prior, "mjcf-detailed", out, model=arm, joints=("shoulder",))

    model, data = simulation_of(exported.files[0])
    free = model.jnt_qposadr[model.body("base").jntadr[0]]
    assert data.qpos[free : free + 7].tolist() == [1.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]
    assert [data.joint(name).qpos[0] for name in ("shoulder", "elbow", "wrist")] == [0.1, 0.2, 0.3]
    assert abs(data.joint("shoulder_rotor").qpos[0] - 0.1) < 0.05


@DETAILED
def test_a_rotor_is_beside_its_link_in_frames(prior: MotorPrior, arm: Path):
    text = MODEL
    geom = '<geom size="0.01"/></body>'
    for body in ("upper", "hand"):
        text = text.replace(f'<body name="{body}"', f'<frame pos="0 0 0.1"><body name="{body}"')
    text = text.replace("</worldbody>", "</frame></worldbody>").replace(geom, f"{geom}</frame>")
    arm.write_text(text)
    out = arm.parent / "out"

    exported = mp.export(prior, "mjcf-detailed", out, model=arm, joints=("shoulder", "wrist"))

    model, data = simulation_of(exported.files[0])
    mujoco.mj_kinematics(model, data)
    for joint, link in (("shoulder", "upper"), ("wrist", "hand")):
        assert model.body(f"{joint}_rotor").parentid[0] == model.body(link).parentid[0]
        rotor = model.joint(f"{joint}_rotor").id
        driven = model.joint(joint).id
        np.testing.assert_allclose(data.xanchor[rotor], data.xanchor[driven])
        np.testing.assert_allclose(data.xaxis[rotor], data.xaxis[driven], atol=1e-9)


TETRAHEDRON = """
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def test_meshes_beside_the_models_folder_are_copied_with_it(prior: MotorPrior, tmp_path: Path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "part.obj").write_text(TETRAHEDRON)
    path = tmp_path / "scene" / "arm.xml"
    path.parent.mkdir()
    mesh = '<compiler meshdir="../assets"/><asset><mesh name="part" file="part.obj"/></asset>'
    text = MODEL.replace("<worldbody>", f"{mesh}<worldbody>")
    path.write_text(text.replace('<geom size="0.01"/>', '<geom type="mesh" mesh="part"/>'))

    exported = mp.export(prior, "mjcf", tmp_path / "out", model=path, joints=("elbow",))

    assert exported.files[0] == tmp_path / "out" / "scene" / "arm_000.xml"
    model, _ = simulation_of(exported.files[0])
    assert model.nmesh == 1


def test_defaults_of_the_model_do_not_change_the_servo_and_its_range_of_commands_stays(
    prior: MotorPrior, arm: Path
):
    slow = '<default><position timeconst="0.05" forcerange="-0.3 0.3"/>'
    arm.write_text(MODEL.replace("<default>", slow, 1).replace('kp="3"', 'kp="3" ctrlrange="-1 1"'))

    exported = mp.export(prior, "mjcf", arm.parent / "out", model=arm, joints=("wrist",))

    model, _ = simulation_of(exported.files[0])
    servo = model.actuator("last")
    assert servo.dyntype[0] == mujoco.mjtDyn.mjDYN_NONE
    assert servo.forcerange[1] > 1.0
    assert servo.ctrlrange.tolist() == [-1.0, 1.0]


@pytest.mark.parametrize(
    ("name", "leg", "shank"),
    [
        pytest.param("mjcf-detailed", 0.005, 0.008, marks=DETAILED),
        ("mjcf", 0.02, 0.02),
        ("bam", 0.02, 0.02),
    ],
)
def test_exported_motors_move_as_ours(
    name: str, leg: float, shank: float, prior: MotorPrior, arm: Path, tmp_path: Path
):
    joints = ("shoulder", "elbow")

    exported = mp.export(prior, name, tmp_path, motors=2, model=arm, joints=joints)

    assert 0.0 < exported.losses["leg"] < leg  # [rad]
    assert 0.0 < exported.losses["shank"] < shank
    missing_constant = "backlash" if name == "bam" else "load_friction"
    assert exported.not_expressed[missing_constant] > 0.0


def test_the_loss_on_the_users_model_is_measured_at_its_own_step(
    prior: MotorPrior, arm: Path, tmp_path: Path
):
    losses = {}
    for step in (0.002, 0.01):
        model = MODEL.replace("<compiler", f'<option timestep="{step}"/><compiler')
        arm.write_text(model)
        exported = mp.export(
            prior, "mjcf", tmp_path / f"{step}", motors=2, model=arm, joints=("shoulder", "elbow")
        )
        losses[step] = exported.model_losses

        assert exported.model_losses.keys() == {"shoulder", "elbow"}
        assert all(f"{1e3 * loss:.1f}" in str(exported) for loss in exported.model_losses.values())

    assert 0.0 < max(losses[0.002].values()) < 0.02  # [rad]
    assert max(losses[0.01].values()) > max(losses[0.002].values())


@DETAILED
def test_motors_that_diverge_on_the_users_model_are_refused_with_the_step_that_they_need(
    arm: Path, tmp_path: Path
):
    go2 = mp.from_pretrained("go2")
    options = {"motors": 2, "joints": ("thigh", "calf")}
    arm.write_text(with_joints(MODEL, "thigh", "calf"))
    out = tmp_path / "out"

    with pytest.raises(ConfigError, match="diverge on the model") as refused:
        mp.export(go2, "mjcf-detailed", out, model=arm, **options)

    assert list(out.glob("*.xml")) == []

    needed = re.search(r'timestep="([\d.]+)"', refused.value.remedy or "")
    assert needed is not None

    arm.write_text(arm.read_text().replace("<compiler", f"<option {needed[0]}/><compiler"))
    exported = mp.export(go2, "mjcf-detailed", out, model=arm, **options)

    assert max(exported.model_losses.values()) < 0.02


def test_a_servo_with_a_motion_profile_is_usable_as_a_plain_joint(arm: Path, tmp_path: Path):
    so101 = mp.from_pretrained("so101")
    options = {"motors": 2, "model": arm, "joints": ("shoulder_lift", "elbow_flex")}
    arm.write_text(with_joints(MODEL, "shoulder_lift", "elbow_flex"))
    exported = mp.export(so101, "mjcf", tmp_path / "out", **options)

    assert "MotionProfile" in str(exported)
    assert max(exported.model_losses.values()) < 0.05  # [rad]; 0.14 to 0.24 without the profile

    start = np.zeros(2)
    profile = mp.MotionProfile.load(
        tmp_path / "out" / "motors.json", dt=0.002, start=start, robot=1
    )
    references = np.array([profile.step(np.full(2, 0.5)) for _ in range(1000)])
    speed = np.diff(references, axis=0, prepend=0.0) / 0.002
    limit = 39.0  # the register of these servos [rad/s²]

    np.testing.assert_allclose(references[-1], 0.5)
    assert np.abs(np.diff(speed, axis=0)).max() <= 1.01 * limit * 0.002


def test_motors_without_a_motion_profile_have_none_to_load(
    prior: MotorPrior, arm: Path, tmp_path: Path
):
    mp.export(prior, "mjcf", tmp_path / "out", model=arm, joints=("shoulder", "elbow"))
    with pytest.raises(ArtifactError, match="no motion profile"):
        mp.MotionProfile.load(tmp_path / "out" / "motors.json", dt=0.002, start=np.zeros(2))


@pytest.fixture
def log() -> MotorLog:
    """A log of two joints that swing a known load."""
    time = 0.002 * np.arange(1000)
    ones = np.ones((1000, 2))
    target = 0.3 * np.sin(6.0 * time)[:, None] * ones
    return log_of(time, target, external_torque=0.0 * ones, load_inertia=0.004 * ones)


def test_the_loss_on_a_log_is_part_of_the_export(prior: MotorPrior, log: MotorLog, tmp_path: Path):
    exported = mp.export(prior, "table", tmp_path, motors=2, joints=log.joint_names, log=log)

    table = json.loads((tmp_path / "motors.json").read_text())
    assert 1e-4 < exported.losses["log"] < 0.03  # [rad]
    assert table["loss_rad"]["log"] == exported.losses["log"]


def test_a_log_without_loads_cannot_be_replayed(prior: MotorPrior, log: MotorLog, tmp_path: Path):
    without_loads = replace(log, external_torque=None)
    with pytest.raises(LogError, match="loads"):
        mp.export(prior, "table", tmp_path, joints=log.joint_names, log=without_loads)


def test_a_log_of_other_joints_is_refused(prior: MotorPrior, log: MotorLog, tmp_path: Path):
    with pytest.raises(ConfigError, match="joints"):
        mp.export(prior, "table", tmp_path, joints=("a", "b", "c"), log=log)


def test_the_motors_of_a_posterior_are_exported_by_name(prior: MotorPrior):
    mean = np.outer(np.arange(3.0), np.ones(prior.mean.shape[1]))
    covariance = np.tile(1e-12 * np.eye(prior.mean.shape[1]), (3, 1, 1))
    posterior = MotorPosterior(prior, mean, covariance, ("a", "b", "c"), 10.0, (0.5,) * 3)

    motors = sampled(posterior, 1, 0, ("c", "a"), None)

    np.testing.assert_allclose(motors.z[:, 0], [2.0, 0.0], atol=1e-4)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_motors(
    prior: MotorPrior, tmp_path: Path
):
    def table(folder: str, seed: int) -> bytes:
        mp.export(prior, "table", tmp_path / folder, motors=3, seed=seed)
        return (tmp_path / folder / "motors.json").read_bytes()

    first = table("first", seed=1)
    assert table("repeated", seed=1) == first
    assert table("second", seed=2) != first


def test_correlations_of_a_table_are_those_between_units_of_a_joint(tmp_path: Path):
    go2 = mp.from_pretrained("go2")

    def correlation(*joints: str) -> float:
        """Correlation of armature and friction loss."""
        mp.export(go2, "table", tmp_path, motors=40, joints=joints)
        table = json.loads((tmp_path / "motors.json").read_text())["correlation_of_logarithms"]
        row = table["order"].index("armature")
        column = table["order"].index("frictionloss")
        return table["matrix"][row][column]

    both_joints = correlation("FL_hip_joint", "FL_calf_joint")
    single_joints = [correlation("FL_hip_joint"), correlation("FL_calf_joint")]
    assert abs(both_joints - np.mean(single_joints)) < 0.2


def test_a_table_has_samples_quantiles_and_its_loss(prior: MotorPrior, tmp_path: Path):
    mp.export(prior, "table", tmp_path, motors=40, joints=("a", "b"))

    table = json.loads((tmp_path / "motors.json").read_text())
    kp = np.array(table["samples"]["kp"])
    assert kp.shape == (40, 2)
    assert np.median(kp) == pytest.approx(9.0, rel=0.1)
    quantiles = np.quantile(kp, (0.05, 0.5, 0.95), axis=0).T
    assert np.allclose(table["quantiles_5_50_95"]["kp"], quantiles)
    assert set(table["loss_rad"]) == {"leg", "shank", "leg_steps"}
    assert "backlash" in table["not_expressed"]


SHOULDER_AND_ELBOW = ("shoulder", "elbow")


def test_only_lines_of_the_joints_and_their_actuators_change(
    prior: MotorPrior, arm: Path, tmp_path: Path
):
    out = tmp_path / "out"

    exported = mp.export(prior, "mjcf", out, motors=2, model=arm, joints=SHOULDER_AND_ELBOW)

    assert arm.read_text() == MODEL
    texts = [path.read_text() for path in exported.files if path.suffix == ".xml"]
    assert len(texts) == 2
    assert texts[0] != texts[1]
    lines = [line.strip() for line in texts[0].splitlines()]
    changed = [line for line in MODEL.splitlines() if line.strip() not in lines]
    assert [line.split('"')[1] for line in changed] == ["shoulder", "elbow", "first"]


def test_a_model_has_the_constants_of_its_samples(prior: MotorPrior, arm: Path, tmp_path: Path):
    out = tmp_path / "out"

    exported = mp.export(prior, "mjcf", out, motors=2, model=arm, joints=SHOULDER_AND_ELBOW)

    model, _ = simulation_of(exported.files[0])
    samples = samples_in(out)
    for column, (joint, driver_name) in enumerate((("shoulder", "first"), ("elbow", "elbow"))):
        sample = {name: values[0][column] for name, values in samples.items()}
        dof = model.joint(joint).dofadr[0]
        damping = np.ravel(model.dof_damping[dof])[0]
        assert model.dof_armature[dof] == pytest.approx(sample["armature"], rel=1e-5)
        assert damping == pytest.approx(sample["damping"], rel=1e-5)

        driver = model.actuator(driver_name)
        assert driver.gear[0] == 1.0
        assert not driver.ctrllimited[0]
        assert driver.gainprm[0] == pytest.approx(sample["kp"], rel=1e-5)
        assert driver.biasprm[2] == pytest.approx(-sample["kv"], rel=1e-5)
        assert driver.forcerange[1] == pytest.approx(sample["forcerange"], rel=1e-5)

    assert model.actuator("last").gainprm[0] == 3.0
    assert np.ravel(model.dof_damping[2])[0] == 7.0


@DETAILED
def test_the_rotor_of_a_detailed_model_turns_the_joint_the_same_way(
    prior: MotorPrior, arm: Path, tmp_path: Path
):
    exported = mp.export(prior, "mjcf-detailed", tmp_path, model=arm, joints=SHOULDER_AND_ELBOW)
    model, data = simulation_of(exported.files[0])
    model.opt.gravity[:] = 0.0

    for _ in range(1000):
        data.ctrl[0] = 0.5  # the first control stays the first
        mujoco.mj_step(model, data)

    offset = samples_in(tmp_path)["offset"][0][0]
    joint_pos = float(data.joint("shoulder").qpos[0])
    rotor_pos = float(data.joint("shoulder_rotor").qpos[0])
    assert joint_pos == pytest.approx(0.5 - offset, abs=0.03)
    assert abs(rotor_pos - 0.5) < 0.03, "the encoder reads the angle of the rotor"


@DETAILED
def test_a_rotor_starts_at_its_joint_in_a_model_in_degrees(prior: MotorPrior, arm: Path):
    in_degrees = MODEL.replace('angle="radian" ', "")
    arm.write_text(in_degrees.replace('name="elbow"', 'name="elbow" ref="-20"'))

    exported = mp.export(prior, "mjcf-detailed", arm.parent / "out", model=arm, joints=("elbow",))

    _, data = simulation_of(exported.files[0])
    joint_pos = float(data.joint("elbow").qpos[0])
    rotor_pos = float(data.joint("elbow_rotor").qpos[0])
    assert joint_pos == pytest.approx(np.radians(-20.0))
    assert abs(rotor_pos - joint_pos) < 0.05


def test_an_exported_bam_json_is_read_with_the_same_constants(prior: MotorPrior, tmp_path: Path):
    exported = mp.export(prior, "bam", tmp_path, motors=1)

    table = json.loads(exported.files[0].read_text())
    assert table["model"] == "m5"
    assert table["motorprior"]["loss_rad"] == exported.losses
    motor = mp.read_motor(exported.files[0]).constants()
    assert motor["kp"][0] == pytest.approx(table["kp"])
    assert motor["kp"][0] * motor["kd_over_kp"][0] == pytest.approx(table["damping"])
    assert motor["load_friction"][0] == pytest.approx(2.0 * table["load_friction_motor"])


SERVO = {
    "kt": 1.2,
    "R": 2.7,
    "armature": 0.028,
    "q_offset": -0.05,
    "friction_base": 0.05,
    "friction_viscous": 0.06,
    "model": "m1",
    "actuator": "sts3215",
}


def pendulum(dt: float, seconds: float = 2.0) -> Trial:
    """A pendulum of 0.5 N·m and 0.005 kg·m² that follows a sine, with a step after 1 s."""
    time = np.arange(round(seconds / dt)) * dt
    targets = 0.6 * np.sin(2 * np.pi * 0.8 * time)[:, None] + 0.8 * (time > 1.0)[:, None]
    weight = np.full_like(targets, -0.5)
    return Trial(targets, 0.0 * weight, np.array([0.005]), dt, load_stiffness=weight)


@DETAILED
def test_strong_damping_of_a_stiff_gear_adds_no_inertia():
    """A gear that hardly gives moves like a plain joint, whatever its damping."""
    motor = {
        "kp": 6.0,
        "kd": 0.12,
        "velocity_filter": 0.0005,
        "delay": 0.01,
        "torque_limit": 1.6,
        "armature": 0.008,
        "viscous_damping": 0.05,
        "friction": 0.06,
        "gear_stiffness": 190.0,
        "gear_damping": 2.6,
        "backlash": 0.0,
        "encoder_zero": 0.0,
    }
    values = {name: np.array([value]) for name, value in motor.items()}
    trial = pendulum(0.002)

    angles = {}
    for name in ("mjcf", "mjcf-detailed"):
        replay = EXPORTERS[name].replay
        assert replay is not None
        angles[name] = replay(values, trial)

    assert float(rms(angles["mjcf-detailed"] - angles["mjcf"])) < 0.02  # [rad]; 0.09 unlimited


def test_a_published_servo_moves_here_as_in_its_own_simulation(tmp_path: Path):
    path = tmp_path / "m1.json"
    path.write_text(json.dumps(SERVO))
    trial = pendulum(0.0005)

    in_bam = BamMotor.of(SERVO, kp=16.0).simulate(trial, 0)
    ours = run(read_motor(path, kp=16.0), trial).joint_pos[:, 0]

    assert np.ptp(in_bam) > 1.0  # [rad]
    assert float(rms(ours - in_bam)) < 5e-3


def test_the_stiffness_of_a_published_servo_follows_from_its_supply_and_winding():
    # gain · duty per rad · supply [V] · kt [N·m/A] / R [Ω]
    stiffness = 16 * 0.166 * 7.4 * 1.2 / 2.7
    assert BamMotor.of(SERVO, kp=16.0).kp == pytest.approx(stiffness)


DIRECTIONAL = {
    "model": "m5",
    "load_friction_motor": 0.1,
    "load_friction_external": 0.05,
    "friction_stribeck": 0.05,
    "load_friction_motor_stribeck": 0.0,
    "load_friction_external_stribeck": 0.02,
    "dtheta_stribeck": 1.0,
    "alpha": 1.3,
}


@pytest.mark.parametrize("table", [SERVO, SERVO | DIRECTIONAL], ids=["m1", "m5"])
def test_our_simulation_of_a_bam_servo_equals_the_installed_bam(table: dict):
    pytest.importorskip("bam", reason="needs better-actuator-models (Python 3.12)")
    from bam.model import load_model_from_dict
    from bam.simulate import Simulator

    trial = pendulum(0.002)
    length = 0.1  # [m]
    mass = 0.5  # [kg]
    rest = {"position": 0.0, "speed": 0.0, "torque_enable": True}
    targets = trial.position_target[:, 0].tolist()
    log = {
        "mass": mass,
        "arm_mass": 0.0,
        "length": length,
        "kp": 16.0,
        "vin": 7.4,
        "dt": 0.002,
        "entries": [rest | {"goal_position": target} for target in targets],
    }
    model = load_model_from_dict(table)
    model.max_velocity.value = 1e9

    in_bam = np.array(Simulator(model).rollout_log(log, simulate_control=True)[0])

    # The angles of BAM are readings of the encoder.
    offset = table["q_offset"]
    weight = mass * 9.80665 * length
    torque = -weight * np.sin(in_bam + offset)[:, None]
    same_trial = replace(
        trial, joint_pos=np.array([offset]), external_torque=torque, load_stiffness=0.0 * torque
    )
    ours = BamMotor.of(table, kp=16.0).simulate(same_trial, 0) - offset
    assert np.ptp(in_bam) > 1.0  # [rad]
    assert float(np.abs(in_bam - ours).max()) < 1e-6


@pytest.mark.parametrize(
    ("key", "value"), [("model", "m9"), ("actuator", "unknown"), ("kt", "strong")]
)
def test_a_bad_bam_json_is_refused_with_its_value(key: str, value: str, tmp_path: Path):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(SERVO | {key: value}))

    with pytest.raises(ArtifactError, match=value) as refused:
        read_motor(path)

    assert refused.value.where == path


def test_a_card_is_a_folder_that_loads(prior: MotorPrior, tmp_path: Path):
    mp.export(prior, "card", tmp_path / "mine")

    assert mp.from_pretrained(tmp_path / "mine").sha256() == prior.sha256()
    file = str(tmp_path / "mine" / "prior.safetensors")
    assert mp.from_pretrained(file).sha256() == prior.sha256()
    page = (tmp_path / "mine" / "README.md").read_text()
    assert page.startswith("---\nrobot:")
    assert "| armature | kg·m² |" in page


def test_an_unknown_card_is_refused_with_its_name():
    with pytest.raises(ArtifactError, match="nothing"):
        mp.from_pretrained("nothing")


@pytest.mark.parametrize("name", shipped_cards())
def test_shipped_cards_sample_motors_and_state_their_licence(name: str):
    prior = mp.from_pretrained(name)
    motors = prior.sample(prior.classes.names[:1] * 12, seed=0)
    assert motors.num_motors == 12
    assert np.isfinite(motors.arrays(0.002).parameters).all()

    folder = Path(mp.__file__).parent / "exports" / "library" / name
    assert "licence:" in (folder / "README.md").read_text()
    assert sum(path.stat().st_size for path in folder.iterdir()) < 120_000  # bytes
