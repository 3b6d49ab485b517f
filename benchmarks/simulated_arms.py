"""Constants of simulated arms, fitted to their logs: coverage of the intervals, bias of the delay, spurious terms.

    python benchmarks/simulated_arms.py --out runs/arms

Every arm has JOINTS joints, whose motors are a PD with delayed commands, an armature, Coulomb and
viscous friction in MuJoCo: there is no gear, no filter and no optional term to find. Commands are
held at the arm's rate (RATES), angles are rounded to ENCODER counts per turn, gains are logged.
figures.json has

    arms/coverage90  share of true delay, armature, Coulomb and viscous friction inside the 90 %
    intervals of
                     `MotorPrior.intervals` [-]
    arms/delay_bias  mean of fitted minus true delay [s]
    arms/spurious    number of arms with an optional term
"""

# pyright: reportAttributeAccessIssue=false
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import motorprior as mp
from figures import PROGRESS, run_benchmark
from motorprior.identification.presets import recipe_of
from motorprior.logs.loads import with_loads
from motorprior.logs.operations import smooth_on_grid

JOINTS = 3
RATES = (100.0, 200.0, 333.0, 500.0)  # of the logs, in turns [Hz]
ENCODER = 4096  # counts per turn
PHYSICS_DT = 0.00025  # [s]
PERIOD = 0.002  # of the fit [s]
# lower and upper bound of the constants' uniform distributions (of the logarithm)
RANGES = {
    "kp": (8.0, 30.0), "kd_over_kp": (0.03, 0.08), "delay": (0.005, 0.02), "armature": (0.005, 0.02),
    "coulomb": (0.05, 0.2), "viscous_damping": (0.05, 0.3),
}  # fmt: skip
# attributes of joints
MJCF = {"armature": "armature", "coulomb": "frictionloss", "viscous_damping": "damping"}
FITTED = ("delay", "armature", "coulomb", "viscous_damping")  # kp and kd are logged
# MuJoCo's default creeps when it sticks
FRICTION = 'solreffriction="0.0006 1" solimpfriction="0.998 0.999 0.001"'
ROBOT = 'name = "arm"\nmotor = "simulated"\nmodel = "arm.xml"\nbase = "fixed"\nnominal_pose = 0.0\nkp = 10.0\n'
ROBOT += "kd = 0.5\ntorque_limit = 100.0\n"


@dataclass(frozen=True)
class Settings:
    """Fit the constants of simulated arms."""

    out: Path  # run folder
    arms: int = 20
    seconds: float = 20.0  # duration of the log of each [s]
    preset: str = "rollout"  # recipe of the fits
    seed: int = 0


def write_arm(folder: Path, constants: dict[str, np.ndarray]) -> Path:
    """Model of the arm, with the armature and friction of its motors if ``constants`` has them, and its description."""
    folder.mkdir(parents=True, exist_ok=True)
    body = ""
    end = ""
    for joint in range(JOINTS):
        motor = " ".join(
            f'{mjcf}="{constants[name][joint]:.12g}"'
            for name, mjcf in MJCF.items()
            if name in constants
        )
        axis, place = ("0 0 1", "0 0 0") if joint == 0 else ("0 1 0", "0.2 0 0")
        body += f'<body pos="{place}"><joint name="j{joint}" axis="{axis}" range="-3 3" {FRICTION} {motor}/>'
        body += '<geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.3" contype="0" conaffinity="0"/>'
        end += "</body>"
    model = f'<mujoco><compiler angle="radian"/><worldbody>{body}{end}</worldbody></mujoco>'
    (folder / "arm.xml").write_text(model, "utf-8")
    (folder / "arm.toml").write_text(ROBOT, "utf-8")
    return folder / "arm.toml"


def commands(rng: np.random.Generator, seconds: float, rate: float) -> np.ndarray:
    """(rows, JOINTS) sums of sines up to 4 Hz and steps every second [rad], a row per command."""
    time = np.arange(round(seconds * rate)) / rate
    frequency = np.exp(rng.uniform(np.log(0.2), np.log(4.0), (4, JOINTS)))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (2, 4, JOINTS))
    waves = (
        np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
        * (0.3 + size / (2.0 * np.pi))
        * 0.15
    )
    steps = rng.uniform(-0.4, 0.4, (int(seconds) + 1, JOINTS))[time.astype(int)]
    return waves.sum(axis=1) + steps * (time.astype(int) % 3 == 0)[:, None]


def recorded(
    folder: Path, constants: dict[str, np.ndarray], seconds: float, rate: float, seed: int
) -> mp.MotorLog:
    """The log of an arm, on the grid of the fit and with loads."""
    truth = mujoco.MjModel.from_xml_path(
        str(write_arm(folder / "true", constants).with_suffix(".xml"))
    )
    truth.opt.timestep = PHYSICS_DT
    truth.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(truth)
    target = commands(np.random.default_rng(seed), seconds, rate)
    kp = constants["kp"]
    kd = constants["kp"] * constants["kd_over_kp"]
    angles = np.empty_like(target)
    joints = np.arange(JOINTS)
    data.qpos[:] = target[0]
    step = 0
    for row in range(len(target)):
        angles[row] = data.qpos
        while step * PHYSICS_DT < (row + 1) / rate - 1e-9:
            sent = np.floor((step * PHYSICS_DT - constants["delay"]) * rate + 1e-9).astype(int)
            delayed = target[np.maximum(sent, 0), joints]
            data.qfrc_applied[:] = kp * (delayed - data.qpos) - kd * data.qvel
            mujoco.mj_step(truth, data)
            step += 1
    quantum = 2.0 * np.pi / ENCODER
    ones = np.ones_like(target)
    robot = mp.load_robot(str(write_arm(folder / "known", {})))
    log = mp.MotorLog(
        time=np.arange(len(target)) / rate,
        position_target=target,
        joint_pos=quantum * np.round(angles / quantum),
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=f"arm {seed}",
        logged_kp=kp * ones,
        logged_kd=kd * ones,
    )
    return with_loads(smooth_on_grid(log, PERIOD), robot)


def figures(settings: Settings) -> dict[str, float]:
    """The figures of all arms, by their keys."""
    inside: dict[str, list[np.ndarray]] = {name: [] for name in FITTED}
    bias = []
    spurious = 0.0
    for arm in range(settings.arms):
        rng = np.random.default_rng([settings.seed, arm])
        folder = settings.out / f"arm_{arm}"
        drawn = (
            (name, rng.uniform(np.log(low), np.log(high), JOINTS))
            for name, (low, high) in RANGES.items()
        )
        constants = {name: np.exp(logarithms) for name, logarithms in drawn}
        log = recorded(
            folder, constants, settings.seconds, RATES[arm % len(RATES)], settings.seed + arm
        )
        prior = mp.fit_prior(
            log, settings.preset, settings.seed, out=folder / "prior", progress=PROGRESS
        )
        for name, (low, high) in prior.intervals().items():
            if name in FITTED:
                inside[name].append((low <= constants[name]) & (constants[name] <= high))
        bias.append(prior.model.constants(prior.mean)["delay"] - constants["delay"])
        spurious += bool(recipe_of(prior).terms)
    shares = {f"arms/coverage90/{name}": float(np.mean(each)) for name, each in inside.items()}
    overall = {"arms/coverage90": float(np.mean(list(shares.values()))), "arms/spurious": spurious}
    return shares | overall | {"arms/delay_bias": float(np.mean(bias))}


if __name__ == "__main__":
    run_benchmark(Settings, figures, __doc__)
