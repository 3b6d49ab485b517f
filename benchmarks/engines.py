"""Differences between MuJoCo and PyBullet for the same trot on the same motors, as figures and as a picture.

    python benchmarks/engines.py --prior FILE [--figure FILE]

Physical motors, motors of a prior, a PD with armature and delay and an ideal PD, at 1 kHz in both
engines, suspended and on the ground, 12 random trots of 2 s.
"""

from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import report
from motorprior.actuator.actuator import Actuator
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.signals import rmse
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from virtual_fleets.robot_fidelity import trot_targets

TROTS = 12
STEPS = 200
KINDS = ("physical", "learned", "pd_armature_delay", "ideal_pd")
# (control steps, 12) joint angles [rad] and (control steps, 3) base positions [m], before each
# control step
Motion = tuple[np.ndarray, np.ndarray]


def motors_of(kind: str, prior: mp.MotorPrior, rng: np.random.Generator) -> Actuator:
    """Twelve motors."""
    if kind == "learned":
        return prior.sample(PUPPER_V2.num_joints, rng)
    if kind == "physical":
        return mp.load_fleet("pupper_v2").sample(PUPPER_V2.num_joints, rng).actuator()
    rotors = 0.003 if kind == "pd_armature_delay" else 0.0
    return mp.IdealPd.uniform(
        12, kp=8.8, kd=0.84, torque_limit=1.26, armature=rotors, delay=0.008 if rotors else 0.0
    )


def in_mujoco(world: World, motors: Actuator, targets: np.ndarray) -> Motion:
    """Replay the targets in MuJoCo."""
    recorded = replay(world, motors, targets)
    after = recorded.joint_pos[world.substeps - 1 :: world.substeps]
    return np.vstack([PUPPER_V2.nominal_pose[None], after[:-1]]), recorded.base[:, :3]


def in_bullet(world: BulletWorld, motors: Actuator, targets: np.ndarray) -> Motion:
    """Replay the targets in PyBullet."""
    simulation = world.reset(motors)
    joints = []
    base = []
    for target in targets:
        joints.append(simulation.joints()[0])
        base.append(simulation.base()[0])
        for _ in range(world.substeps):
            simulation.physics_step(target)
    return np.array(joints), np.array(base)


def measure(prior: Path, figure: Path | None = None) -> None:
    """Print medians over the trots, and draw the first."""
    learned = mp.MotorPrior.load(prior)
    figures = dict[str, float]()
    motions: dict[str, tuple[Motion, Motion]] = {}
    for kind in KINDS:
        for place in ("suspended", "ground"):
            suspended = place == "suspended"
            mujoco = World(PUPPER_V2, 0.001, suspended)
            bullet = BulletWorld(PUPPER_V2, suspended)
            rows = []
            for trot in range(TROTS):
                rng = np.random.default_rng([trot, 77])
                motors = motors_of(kind, learned, rng)
                targets = trot_targets(PUPPER_V2, rng, STEPS)
                one = in_mujoco(mujoco, motors, targets)
                other = in_bullet(bullet, motors, targets)
                apart = 0.0 if suspended else float(np.hypot(*(one[1][-1] - other[1][-1])[:2]))
                rows.append((1e3 * float(rmse(one[0], other[0])), apart))
                motions.setdefault(f"{kind} {place}", (one, other))
            bullet.close()
            joints, base = np.median(rows, axis=0).tolist()
            figures |= {
                f"joint_rmse_mrad/{kind}/{place}": joints,
                f"base_apart_m/{kind}/{place}": base,
            }
    report(figures, None)
    if figure is not None:
        draw_figure(figure, motions)


def draw_figure(path: Path, motions: dict[str, tuple[Motion, Motion]]) -> None:
    """Knee of the first leg and path of the base, in both engines."""
    import matplotlib.pyplot as plt

    time_axis = PUPPER_V2.control_dt * np.arange(STEPS)
    figure, axes = plt.subplots(2, 2, figsize=(9, 5), constrained_layout=True)
    for row, name in zip(axes, ("physical ground", "learned ground"), strict=True):
        for motion, label, style in zip(
            motions[name], ("MuJoCo", "PyBullet"), ("-", "--"), strict=True
        ):
            row[0].plot(time_axis, motion[0][:, 2], style, label=label)
            row[1].plot(time_axis, motion[1][:, 0], style, label=f"{label}, forward")
            row[1].plot(time_axis, motion[1][:, 1], style, label=f"{label}, left", alpha=0.5)
        row[0].set(title=f"{name}: front right knee", xlabel="time [s]", ylabel="angle [rad]")
        row[1].set(title="chassis", xlabel="time [s]", ylabel="position [m]")
        row[0].legend(fontsize=7)
        row[1].legend(fontsize=7)
    figure.savefig(path)


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
