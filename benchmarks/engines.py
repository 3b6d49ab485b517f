"""Differences between MuJoCo and PyBullet for the same trot on the same motors.

    python benchmarks/engines.py --prior FILE [--figure FILE]

Physical motors, motors of a prior, a PD with armature and delay and an ideal PD, at 1 kHz in both
engines, suspended and on the ground, on random trots. The result is figures and a picture.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import report
from motorprior.actuator.actuator import Actuator
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.signals import rmse
from motorprior.simulation.bullet_world import PHYSICS_DT, BulletWorld
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from virtual_fleets.robot_fidelity import trot_targets

MOTORS = ("physical", "learned", "pd_armature_delay", "ideal_pd")
SUPPORTS = ("suspended", "ground")
_STREAM = 77


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    prior: Path  # prior of pupper_v2
    figure: Path | None = None  # file of the picture
    trots: int = 12  # random trots
    steps: int = 200  # control steps of a trot


@dataclass(frozen=True)
class Motion:
    """Motion of a robot, before each of C control steps."""

    joint_pos: np.ndarray  # (C, 12) joint angles [rad]
    base_pos: np.ndarray  # (C, 3) base positions [m]


def sample_motors(name: str, prior: mp.MotorPrior, rng: np.random.Generator) -> Actuator:
    """Twelve motors of one of MOTORS."""
    if name == "learned":
        return prior.sample(PUPPER_V2.num_joints, rng)
    if name == "physical":
        return mp.load_fleet("pupper_v2").sample(PUPPER_V2.num_joints, rng).actuator()
    has_rotor = name == "pd_armature_delay"
    return mp.IdealPd.uniform(
        12,
        kp=8.8,
        kd=0.84,
        torque_limit=1.26,
        armature=0.003 if has_rotor else 0.0,
        delay=0.008 if has_rotor else 0.0,
    )


def in_mujoco(world: World, motors: Actuator, targets: np.ndarray) -> Motion:
    """Replay the targets in MuJoCo."""
    played = replay(world, motors, targets)
    after_steps = played.joint_pos[world.substeps - 1 :: world.substeps]
    joint_pos = np.vstack([PUPPER_V2.nominal_pose[None], after_steps[:-1]])
    return Motion(joint_pos, played.base[:, :3])


def in_bullet(world: BulletWorld, motors: Actuator, targets: np.ndarray) -> Motion:
    """Replay the targets in PyBullet."""
    simulation = world.reset(motors)
    joint_pos = []
    base_pos = []
    for target in targets:
        joint_pos.append(simulation.joints()[0])
        base_pos.append(simulation.base()[0])
        for _ in range(world.substeps):
            simulation.physics_step(target)
    return Motion(np.array(joint_pos), np.array(base_pos))


def compute(settings: Settings) -> dict[str, float]:
    """Medians over the trots; draws the first trot, if a picture is wanted."""
    prior = mp.MotorPrior.load(settings.prior)
    figures: dict[str, float] = {}
    first_motions: dict[str, tuple[Motion, Motion]] = {}
    for motors_name in MOTORS:
        for support in SUPPORTS:
            suspended = support == "suspended"
            mujoco = World(PUPPER_V2, PHYSICS_DT, suspended)
            bullet = BulletWorld(PUPPER_V2, suspended)

            joint_errors = []
            distances = []
            for trot in range(settings.trots):
                rng = np.random.default_rng([trot, _STREAM])
                motors = sample_motors(motors_name, prior, rng)
                targets = trot_targets(PUPPER_V2, rng, settings.steps)
                in_one = in_mujoco(mujoco, motors, targets)
                in_other = in_bullet(bullet, motors, targets)
                first_motions.setdefault(f"{motors_name} {support}", (in_one, in_other))

                joint_errors.append(1e3 * float(rmse(in_one.joint_pos, in_other.joint_pos)))
                distance = 0.0
                if not suspended:
                    offset = in_one.base_pos[-1] - in_other.base_pos[-1]
                    distance = float(np.hypot(offset[0], offset[1]))
                distances.append(distance)
            bullet.close()

            name = f"{motors_name}/{support}"
            figures[f"joint_rmse_mrad/{name}"] = float(np.median(joint_errors))
            figures[f"base_apart_m/{name}"] = float(np.median(distances))
    if settings.figure is not None:
        draw_figure(settings.figure, first_motions)
    return figures


def draw_figure(path: Path, motions: dict[str, tuple[Motion, Motion]]) -> None:
    """Draw the knee of the first leg and the path of the base, in both engines."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 5), constrained_layout=True)
    for row, name in zip(axes, ("physical ground", "learned ground"), strict=True):
        knee, base = row
        in_one, in_other = motions[name]
        for motion, label, style in ((in_one, "MuJoCo", "-"), (in_other, "PyBullet", "--")):
            time = PUPPER_V2.control_dt * np.arange(len(motion.joint_pos))
            knee.plot(time, motion.joint_pos[:, 2], style, label=label)
            base.plot(time, motion.base_pos[:, 0], style, label=f"{label}, forward")
            base.plot(time, motion.base_pos[:, 1], style, label=f"{label}, left", alpha=0.5)
        knee.set(title=f"{name}: front right knee", xlabel="time [s]", ylabel="angle [rad]")
        base.set(title="chassis", xlabel="time [s]", ylabel="position [m]")
        knee.legend(fontsize=7)
        base.legend(fontsize=7)
    figure.savefig(path)


if __name__ == "__main__":
    report(compute(tyro.cli(Settings, description=__doc__)), None)
