"""Exports of motors: what each format contains and loses, and that the user's file is otherwise untouched."""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
import json
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from motor_logs import log_of

import motorprior as mp
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import Trial, run
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.exports.bam import BamMotor, read_motor
from motorprior.exports.cards import shipped_cards
from motorprior.exports.exporter import sampled
from motorprior.exports.registry import EXPORTERS, is_supported
from motorprior.signals import rms

DETAILED = pytest.mark.skipif(not is_supported(EXPORTERS["mjcf-detailed"]), reason="needs MuJoCo 4")
# comments, classes, a second actuator and a default that must stay
MODEL = """<mujoco model="arm"> <!-- keep > me -->
  <compiler angle="radian" autolimits="true"/>
  <default><joint damping="7"/> <default class="big"><motor ctrlrange="-1 1" gear="3"/></default></default>
  <worldbody>
    <body name="upper" pos="0 0 1" quat="0.8 0.6 0 0">
      <joint name="shoulder" axis="0 1 0" armature="0.5" range="-2 2"/><!-- shoulder -->
      <geom type="capsule" fromto="0 0 0 0 0 -0.12" size="0.01" mass="0.5"/>
      <body name="fore" pos="0 0 -0.12">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.2"/>
        <body name="hand" pos="0 0 -0.1"><joint name="wrist" axis="0 0 1"/><geom size="0.01"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="first" class="big" joint="shoulder"/>
    <position name="last" joint="wrist" kp="3"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def prior() -> MotorPrior:
    return mp.from_pretrained("pupper_v2")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    with chdir(tmp_path):
        yield path


TENDON = '<tendon><fixed name="t"><joint joint="{}" coef="1"/></fixed></tendon>{}'
COUPLED = '<equality><joint joint1="wrist" joint2="elbow"/></equality>'
ON_WRIST = {"model": "arm.xml", "joints": ("wrist",)}


@pytest.mark.parametrize(
    ("format", "options", "before_end", "value"),
    [
        ("urdf", {}, "", "urdf"),
        ("mjcf", {}, "", "mjcf"),
        ("mjcf", ON_WRIST | {"joints": ("knee",)}, "", "knee"),
        ("mjcf", ON_WRIST, '<actuator><velocity joint="wrist" kv="1"/></actuator>', "2 actuators"),
        (
            "mjcf",
            ON_WRIST,
            TENDON.format("wrist", '<actuator><motor tendon="t"/></actuator>'),
            "2 actuators",
        ),
        ("mjcf", ON_WRIST | {"joints": ("wrist", "elbow")}, COUPLED, "couples"),
    ],
)
def test_a_bad_request_or_a_model_that_would_be_driven_wrongly_is_refused(
    prior: MotorPrior, arm: Path, format: str, options: dict, before_end: str, value: str
):
    arm.write_text(MODEL.replace("</mujoco>", f"{before_end}</mujoco>"))
    with pytest.raises(ConfigError, match=value) as refused:
        mp.export(prior, format, arm.parent / "out", **options)
    assert refused.value.remedy


@pytest.mark.parametrize("format", ["mjcf", pytest.param("mjcf-detailed", marks=DETAILED)])
def test_keyframes_keep_their_pose_and_hold_it(prior: MotorPrior, arm: Path, format: str):
    key = '<key name="home" qpos="0.1 0.2 0.3" qvel="1 2 3" ctrl="5 0.6" act="7"/>'
    slow = MODEL.replace('kp="3"', 'kp="3" timeconst="0.1" ctrlrange="-1 1"')
    arm.write_text(slow.replace("</actuator>", f"</actuator><keyframe>{key}</keyframe>"))
    found = mp.export(
        prior, format, arm.parent / "out", model=arm, joints=("elbow", "shoulder", "wrist")
    )
    model = mujoco.MjModel.from_xml_path(str(found.files[0]))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for joint, pos, vel in (("shoulder", 0.1, 1.0), ("elbow", 0.2, 2.0), ("wrist", 0.3, 3.0)):
        assert (data.joint(joint).qpos[0], data.joint(joint).qvel[0]) == (pos, vel)
        if format == "mjcf-detailed":
            assert abs(data.joint(f"{joint}_rotor").qpos[0] - pos) < 0.05
    # a torque is no position, a position stays
    assert [data.actuator(name).ctrl[0] for name in ("first", "elbow", "last")] == pytest.approx(
        [0.1, 0.2, 0.6]
    )
    assert model.actuator("last").ctrlrange.tolist() == [-1.0, 1.0] and not data.act.any()


@DETAILED
def test_keyframes_keep_the_pose_of_another_body_in_the_frame(prior: MotorPrior, arm: Path):
    base = '<frame><body name="base" pos="1 0 2"><freejoint/><geom size="0.1"/></body><body name="upper"'
    text = MODEL.replace('<body name="upper"', base).replace("</worldbody>", "</frame></worldbody>")
    key = '<keyframe><key qpos="1 0 2 1 0 0 0 0.1 0.2 0.3"/></keyframe>'
    arm.write_text(text.replace("</actuator>", f"</actuator>{key}"))
    found = mp.export(prior, "mjcf-detailed", arm.parent / "out", model=arm, joints=("shoulder",))
    model = mujoco.MjModel.from_xml_path(str(found.files[0]))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
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
    found = mp.export(
        prior, "mjcf-detailed", arm.parent / "out", model=arm, joints=("shoulder", "wrist")
    )
    model = mujoco.MjModel.from_xml_path(str(found.files[0]))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for joint, link in (("shoulder", "upper"), ("wrist", "hand")):
        assert model.body(f"{joint}_rotor").parentid[0] == model.body(link).parentid[0]
        rotor = model.joint(f"{joint}_rotor").id
        driven = model.joint(joint).id
        np.testing.assert_allclose(data.xanchor[rotor], data.xanchor[driven])
        np.testing.assert_allclose(data.xaxis[rotor], data.xaxis[driven], atol=1e-9)


def test_meshes_beside_the_models_folder_are_copied_with_it(prior: MotorPrior, tmp_path: Path):
    (tmp_path / "assets").mkdir()
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "assets" / "part.obj").write_text(tetrahedron)
    path = tmp_path / "scene" / "arm.xml"
    path.parent.mkdir()
    mesh = '<compiler meshdir="../assets"/><asset><mesh name="part" file="part.obj"/></asset>'
    text = MODEL.replace("<worldbody>", f"{mesh}<worldbody>")
    path.write_text(text.replace('<geom size="0.01"/>', '<geom type="mesh" mesh="part"/>'))
    found = mp.export(prior, "mjcf", tmp_path / "out", model=path, joints=("elbow",))
    assert found.files[0] == tmp_path / "out" / "scene" / "arm_000.xml"
    assert mujoco.MjModel.from_xml_path(str(found.files[0])).nmesh == 1


def test_defaults_of_the_model_do_not_change_the_servo_and_its_range_of_commands_stays(
    prior: MotorPrior, arm: Path
):
    slow = '<default><position timeconst="0.05" forcerange="-0.3 0.3"/>'
    arm.write_text(MODEL.replace("<default>", slow, 1).replace('kp="3"', 'kp="3" ctrlrange="-1 1"'))
    found = mp.export(prior, "mjcf", arm.parent / "out", model=arm, joints=("wrist",))
    model = mujoco.MjModel.from_xml_path(str(found.files[0]))
    servo = model.actuator("last")
    assert servo.dyntype[0] == mujoco.mjtDyn.mjDYN_NONE and servo.forcerange[1] > 1.0
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
    found = mp.export(prior, name, tmp_path, motors=2, model=arm, joints=("shoulder", "elbow"))
    assert 0.0 < found.losses["leg"] < leg and 0.0 < found.losses["shank"] < shank
    assert found.not_expressed["load_friction" if name != "bam" else "backlash"] > 0.0


def test_a_log_is_replayed_too(prior: MotorPrior, tmp_path: Path):
    time = 0.002 * np.arange(1000)
    ones = np.ones((1000, 2))
    target = 0.3 * np.sin(6.0 * time)[:, None] * ones
    log = log_of(time, target, external_torque=0.0 * ones, load_inertia=0.004 * ones)
    found = mp.export(prior, "table", tmp_path, motors=2, joints=log.joint_names, log=log)
    table = json.loads((tmp_path / "motors.json").read_text())
    assert 1e-4 < found.losses["log"] < 0.03 and table["loss_rad"]["log"] == found.losses["log"]
    with pytest.raises(LogError, match="no loads"):
        mp.export(
            prior, "table", tmp_path, joints=log.joint_names, log=replace(log, external_torque=None)
        )
    with pytest.raises(ConfigError, match="joints"):
        mp.export(prior, "table", tmp_path, joints=("a", "b", "c"), log=log)


def test_the_motors_of_a_posterior_are_exported_by_name(prior: MotorPrior):
    mean = np.outer(np.arange(3.0), np.ones(prior.mean.shape[1]))
    covariance = np.tile(1e-12 * np.eye(prior.mean.shape[1]), (3, 1, 1))
    found = MotorPosterior(prior, mean, covariance, ("a", "b", "c"), 10.0, (0.5,) * 3)
    chosen = sampled(found, 1, 0, ("c", "a"), None)
    np.testing.assert_allclose(chosen.z[:, 0], [2.0, 0.0], atol=1e-4)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_motors(
    prior: MotorPrior, tmp_path: Path
):
    texts = []
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        mp.export(prior, "table", tmp_path / folder, motors=3, seed=seed)
        texts.append((tmp_path / folder / "motors.json").read_bytes())
    assert texts[0] == texts[1] != texts[2]


def test_correlations_of_a_table_are_those_between_units_of_a_joint(tmp_path: Path):
    go2 = mp.from_pretrained("go2")

    def correlation(*joints: str) -> float:
        mp.export(go2, "table", tmp_path, motors=40, joints=joints)
        table = json.loads((tmp_path / "motors.json").read_text())["correlation_of_logarithms"]
        return table["matrix"][table["order"].index("armature")][
            table["order"].index("frictionloss")
        ]

    both = correlation("FL_hip_joint", "FL_calf_joint")
    alone = [correlation(joint) for joint in ("FL_hip_joint", "FL_calf_joint")]
    assert abs(both - np.mean(alone)) < 0.2


def test_a_table_has_samples_quantiles_and_its_loss(prior: MotorPrior, tmp_path: Path):
    mp.export(prior, "table", tmp_path, motors=40, joints=("a", "b"))
    table = json.loads((tmp_path / "motors.json").read_text())
    kp = np.array(table["samples"]["kp"])
    assert kp.shape == (40, 2) and np.median(kp) == pytest.approx(9.0, rel=0.1)
    assert np.allclose(
        table["quantiles_5_50_95"]["kp"], np.quantile(kp, (0.05, 0.5, 0.95), axis=0).T
    )
    assert (
        set(table["loss_rad"]) == {"leg", "shank", "leg_steps"}
        and "backlash" in table["not_expressed"]
    )


def test_only_joints_and_their_actuators_change(prior: MotorPrior, arm: Path, tmp_path: Path):
    found = mp.export(
        prior, "mjcf", tmp_path / "out", motors=2, model=arm, joints=("shoulder", "elbow")
    )
    assert arm.read_text() == MODEL
    variants = [path for path in found.files if path.suffix == ".xml"]
    assert len(variants) == 2 and variants[0].read_text() != variants[1].read_text()
    before, after = (
        [line.strip() for line in text.splitlines()] for text in (MODEL, variants[0].read_text())
    )
    changed = [line for line in before if line not in after]
    assert [line.split('"')[1] for line in changed] == ["shoulder", "elbow", "first"]
    model = mujoco.MjModel.from_xml_path(str(variants[0]))
    table = json.loads((tmp_path / "out" / "motors.json").read_text())["samples"]
    for column, name in enumerate(("shoulder", "elbow")):
        joint = model.joint(name)
        driver = model.actuator("first" if name == "shoulder" else name)
        assert model.dof_armature[joint.dofadr[0]] == pytest.approx(
            table["armature"][0][column], rel=1e-5
        )
        assert np.ravel(model.dof_damping[joint.dofadr[0]])[0] == pytest.approx(
            table["damping"][0][column], rel=1e-5
        )
        assert driver.gear[0] == 1.0 and not driver.ctrllimited[0]
        assert driver.gainprm[0] == pytest.approx(table["kp"][0][column], rel=1e-5)
        assert driver.biasprm[2] == pytest.approx(-table["kv"][0][column], rel=1e-5)
        assert driver.forcerange[1] == pytest.approx(table["forcerange"][0][column], rel=1e-5)
    assert model.actuator("last").gainprm[0] == 3.0 and np.ravel(model.dof_damping[2])[0] == 7.0


@DETAILED
def test_the_rotor_of_a_detailed_model_turns_the_joint_the_same_way(
    prior: MotorPrior, arm: Path, tmp_path: Path
):
    found = mp.export(prior, "mjcf-detailed", tmp_path, model=arm, joints=("shoulder", "elbow"))
    model = mujoco.MjModel.from_xml_path(str(found.files[0]))
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    for _ in range(1000):
        data.ctrl[0] = 0.5  # the first control stays the first
        mujoco.mj_step(model, data)
    zero = json.loads((tmp_path / "motors.json").read_text())["samples"]["offset"][0][0]
    assert float(data.joint("shoulder").qpos[0]) == pytest.approx(0.5 - zero, abs=0.03)
    assert abs(float(data.joint("shoulder_rotor").qpos[0]) - 0.5) < 0.03, (
        "the rotor's angle is the encoder's"
    )


@DETAILED
def test_a_rotor_starts_at_its_joint_in_a_model_in_degrees(prior: MotorPrior, arm: Path):
    arm.write_text(
        MODEL.replace('angle="radian" ', "").replace('name="elbow"', 'name="elbow" ref="-20"')
    )
    found = mp.export(prior, "mjcf-detailed", arm.parent / "out", model=arm, joints=("elbow",))
    data = mujoco.MjData(mujoco.MjModel.from_xml_path(str(found.files[0])))
    assert float(data.joint("elbow").qpos[0]) == pytest.approx(np.radians(-20.0))
    assert abs(float(data.joint("elbow_rotor").qpos[0] - data.joint("elbow").qpos[0])) < 0.05


def test_bam_json_reads_back_as_the_same_law(prior: MotorPrior, tmp_path: Path):
    found = mp.export(prior, "bam", tmp_path, motors=1)
    table = json.loads(found.files[0].read_text())
    assert table["model"] == "m5" and table["motorprior"]["loss_rad"] == found.losses
    motor = mp.read_motor(found.files[0]).constants()
    assert motor["kp"][0] == pytest.approx(table["kp"])
    assert motor["kp"][0] * motor["kd_over_kp"][0] == pytest.approx(table["damping"])
    assert motor["load_friction"][0] == pytest.approx(2.0 * table["load_friction_motor"])


SERVO = {
    "kt": 1.2, "R": 2.7, "armature": 0.028, "q_offset": -0.05, "friction_base": 0.05, "friction_viscous": 0.06,
    "model": "m1", "actuator": "sts3215",
}  # fmt: skip


def pendulum(dt: float, seconds: float = 2.0) -> Trial:
    time = np.arange(round(seconds / dt)) * dt
    targets = 0.6 * np.sin(2 * np.pi * 0.8 * time)[:, None] + 0.8 * (time > 1.0)[:, None]
    weight = np.full_like(targets, -0.5)
    return Trial(targets, 0.0 * weight, np.array([0.005]), dt, load_stiffness=weight)


def test_a_published_servo_moves_here_as_in_its_own_simulation(tmp_path: Path):
    path = tmp_path / "m1.json"
    given = pendulum(0.0005)
    path.write_text(json.dumps(SERVO))
    own = BamMotor.of(SERVO, kp=16.0).simulate(given, 0)
    ours = run(read_motor(path, kp=16.0), given).joint_pos[:, 0]
    assert np.ptp(own) > 1.0 and float(rms(ours - own)) < 5e-3
    assert BamMotor.of(SERVO, kp=16.0).kp == pytest.approx(16 * 0.166 * 7.4 * 1.2 / 2.7)


DIRECTIONAL = {
    "model": "m5", "load_friction_motor": 0.1, "load_friction_external": 0.05, "friction_stribeck": 0.05,
    "load_friction_motor_stribeck": 0.0, "load_friction_external_stribeck": 0.02, "dtheta_stribeck": 1.0, "alpha": 1.3,
}  # fmt: skip


def test_the_simulation_is_that_of_the_installed_bam():
    pytest.importorskip("bam", reason="needs better-actuator-models (Python 3.12)")
    from bam.model import load_model_from_dict
    from bam.simulate import Simulator

    for table in (SERVO, SERVO | DIRECTIONAL):
        given = pendulum(0.002)
        model = load_model_from_dict(table)
        length = 0.1
        mass = 0.5
        rest = {"position": 0.0, "speed": 0.0, "torque_enable": True}
        entries = [rest | {"goal_position": float(each)} for each in given.position_target[:, 0]]
        log = {
            "mass": mass,
            "arm_mass": 0.0,
            "length": length,
            "kp": 16.0,
            "vin": 7.4,
            "dt": 0.002,
            "entries": entries,
        }
        model.max_velocity.value = 1e9
        found = np.array(Simulator(model).rollout_log(log, simulate_control=True)[0])
        weight = mass * 9.80665 * length
        offset = table["q_offset"]  # BAM's angles are those of the encoder
        torque = -weight * np.sin(found + offset)[:, None]
        same = replace(
            given, joint_pos=np.array([offset]), external_torque=torque, load_stiffness=0.0 * torque
        )
        own = BamMotor.of(table, kp=16.0).simulate(same, 0) - offset
        assert np.ptp(found) > 1.0 and float(np.abs(found - own).max()) < 1e-6


@pytest.mark.parametrize("change", [{"model": "m9"}, {"actuator": "unknown"}, {"kt": "strong"}])
def test_a_bad_bam_json_is_refused_with_its_value(change: dict, tmp_path: Path):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(SERVO | change))
    with pytest.raises(ArtifactError, match=str(next(iter(change.values())))) as refused:
        read_motor(path)
    assert refused.value.where == path


def test_a_card_is_a_folder_that_loads(prior: MotorPrior, tmp_path: Path):
    mp.export(prior, "card", tmp_path / "mine")
    assert mp.from_pretrained(tmp_path / "mine").sha256() == prior.sha256()
    page = (tmp_path / "mine" / "README.md").read_text()
    assert page.startswith("---\nrobot:") and "| armature | kg·m² |" in page
    with pytest.raises(ArtifactError, match="nothing"):
        mp.from_pretrained("nothing")


@pytest.mark.parametrize("name", shipped_cards())
def test_shipped_cards_sample_motors_and_state_their_licence(name: str):
    motors = mp.from_pretrained(name).sample(12, seed=0)
    assert motors.num_motors == 12 and np.isfinite(motors.arrays(0.002).parameters).all()
    folder = Path(mp.__file__).parent / "exports" / "library" / name
    assert "licence:" in (folder / "README.md").read_text()
    assert sum(path.stat().st_size for path in folder.iterdir()) < 70_000
