"""Constants of simulated arms, fitted to their logs: coverage of the intervals, bias of the delay.

    python benchmarks/simulated_arms.py --out runs/arms

Every arm has JOINTS joints, whose motors are a PD with delayed commands, an armature, Coulomb and
viscous friction in MuJoCo: there is no gear, no filter and no optional term to find. Commands are
held at the arm's rate (RATES), angles are rounded to ENCODER counts per turn, gains are logged.
figures.json has

    arms/coverage90  share of true delay, armature, Coulomb and viscous friction inside the 90 %
                     intervals of `MotorPrior.intervals` [-]
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
# lower and upper bounds of the constants, whose logarithms are uniformly distributed
RANGES = {
    "kp": (8.0, 30.0),
    "kd_over_kp": (0.03, 0.08),
    "delay": (0.005, 0.02),
    "armature": (0.005, 0.02),
    "coulomb": (0.05, 0.2),
    "viscous_damping": (0.05, 0.3),
}
# constant -> attribute of a joint
MJCF = {"armature": "armature", "coulomb": "frictionloss", "viscous_damping": "damping"}
FITTED = ("delay", "armature", "coulomb", "viscous_damping")  # kp and kd are logged
# MuJoCo's default creeps when it sticks
FRICTION = 'solreffriction="0.0006 1" solimpfriction="0.998 0.999 0.001"'
ROBOT = """name = "arm"
motor = "simulated"
model = "arm.xml"
base = "fixed"
nominal_pose = 0.0
kp = 10.0
kd = 0.5
torque_limit = 100.0
"""
LINK = """<body pos="{pos}">
<joint name="j{joint}" axis="{axis}" range="-3 3" {friction} {motor}/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.3" contype="0" conaffinity="0"/>
"""
MODEL = """<mujoco><compiler angle="radian"/><worldbody>
{links}
</worldbody></mujoco>"""
Constants = dict[str, np.ndarray]  # (JOINTS,) by name


@dataclass(frozen=True)
class Settings:
    """Fit the constants of simulated arms."""

    out: Path  # run folder
    arms: int = 20
    seconds: float = 20.0  # duration of the log of each arm [s]
    preset: str = "rollout"  # recipe of the fits
    seed: int = 0


def figures(settings: Settings) -> dict[str, float]:
    """The figures of all arms, by their keys."""
    is_inside: dict[str, list[np.ndarray]] = {name: [] for name in FITTED}
    bias = []  # of the delay [s]
    spurious = 0.0
    for arm in range(settings.arms):
        constants = drawn_constants(np.random.default_rng([settings.seed, arm]))
        prior = fitted(settings, arm, constants)
        for name, (low, high) in prior.intervals().items():
            if name in FITTED:
                is_inside[name].append((low <= constants[name]) & (constants[name] <= high))
        bias.append(prior.model.constants(prior.mean)["delay"] - constants["delay"])
        spurious += bool(recipe_of(prior).terms)

    shares = {}
    for name, of_arms in is_inside.items():
        shares[f"arms/coverage90/{name}"] = float(np.mean(of_arms))
    return shares | {
        "arms/coverage90": float(np.mean(list(shares.values()))),
        "arms/spurious": spurious,
        "arms/delay_bias": float(np.mean(bias)),
    }


def drawn_constants(rng: np.random.Generator) -> Constants:
    """Constants of the motors of an arm."""
    constants = {}
    for name, (low, high) in RANGES.items():
        constants[name] = np.exp(rng.uniform(np.log(low), np.log(high), JOINTS))
    return constants


def fitted(settings: Settings, arm: int, constants: Constants) -> mp.MotorPrior:
    """The prior of an arm, fitted to its log."""
    folder = settings.out / f"arm_{arm}"
    rate = RATES[arm % len(RATES)]
    log = recorded(folder, constants, settings.seconds, rate, settings.seed + arm)
    out = folder / "prior"
    return mp.fit_prior(log, settings.preset, settings.seed, out=out, progress=PROGRESS)


def recorded(
    folder: Path, constants: Constants, seconds: float, rate: float, seed: int
) -> mp.MotorLog:
    """The log of an arm, on the grid of the fit and with loads."""
    target = commands(np.random.default_rng(seed), seconds, rate)
    angles = simulated(write_arm(folder / "true", constants), constants, target, rate)
    quantum = 2.0 * np.pi / ENCODER
    kp = constants["kp"]
    kd = constants["kp"] * constants["kd_over_kp"]
    ones = np.ones_like(target)

    # the robot description without the constants, which the fit must find
    description = write_arm(folder / "known", {}).with_suffix(".toml")
    robot = mp.load_robot(str(description))
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


def commands(rng: np.random.Generator, seconds: float, rate: float) -> np.ndarray:
    """(rows, JOINTS) sums of sines up to 4 Hz and steps every second [rad], a row per command."""
    time = np.arange(round(seconds * rate)) / rate
    second = time.astype(int)
    frequency = np.exp(rng.uniform(np.log(0.2), np.log(4.0), (4, JOINTS)))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (2, 4, JOINTS))
    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    waves = sines * (0.3 + size / (2.0 * np.pi)) * 0.15
    steps = rng.uniform(-0.4, 0.4, (int(seconds) + 1, JOINTS))[second]
    return waves.sum(axis=1) + steps * (second % 3 == 0)[:, None]


def simulated(
    model_file: Path, constants: Constants, target: np.ndarray, rate: float
) -> np.ndarray:
    """(rows, JOINTS) joint angles [rad] at the times of the commands."""
    model = mujoco.MjModel.from_xml_path(str(model_file))
    model.opt.timestep = PHYSICS_DT
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    data.qpos[:] = target[0]

    kp = constants["kp"]
    kd = constants["kp"] * constants["kd_over_kp"]
    joints = np.arange(JOINTS)
    angles = np.empty_like(target)
    step = 0
    for row in range(len(target)):
        angles[row] = data.qpos
        while step * PHYSICS_DT < (row + 1) / rate - 1e-9:
            time = step * PHYSICS_DT
            sent_row = np.floor((time - constants["delay"]) * rate + 1e-9).astype(int)
            delayed = target[np.maximum(sent_row, 0), joints]
            data.qfrc_applied[:] = kp * (delayed - data.qpos) - kd * data.qvel
            mujoco.mj_step(model, data)
            step += 1
    return angles


def write_arm(folder: Path, constants: Constants) -> Path:
    """Write the model of the arm and its description; returns the file of the model.

    The model has the armature and friction of the motors if ``constants`` has them.
    """
    links = ""
    for joint in range(JOINTS):
        attributes = []
        for name, attribute in MJCF.items():
            if name in constants:
                attributes.append(f'{attribute}="{constants[name][joint]:.12g}"')
        links += LINK.format(
            joint=joint,
            axis="0 0 1" if joint == 0 else "0 1 0",
            pos="0 0 0" if joint == 0 else "0.2 0 0",
            friction=FRICTION,
            motor=" ".join(attributes),
        )
    links += "</body>" * JOINTS

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(MODEL.format(links=links), "utf-8")
    (folder / "arm.toml").write_text(ROBOT, "utf-8")
    return folder / "arm.xml"


if __name__ == "__main__":
    run_benchmark(Settings, figures, __doc__)
