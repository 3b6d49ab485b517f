"""Arms with servo motors of known constants, simulated and logged as a robot logs.

A motor is a PD with delayed commands and a torque limit, a rotor with Coulomb and viscous friction,
and a gear. A rigid gear is the armature, friction and damping of a MuJoCo joint. An elastic gear is
a rotor of its own, which a spring with damping and backlash couples to the joint.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import motorprior as mp
from motorprior.logs.loads import with_loads
from motorprior.logs.operations import smooth_on_grid

ENCODER = 4096  # counts per turn
TORQUE_NOISE = 0.01  # standard deviation of logged torques, relative to their RMS [-]
PHYSICS_DT = 0.00025  # [s]
PERIOD = 0.002  # of the fit [s]
RATES = (50.0, 100.0, 200.0, 333.0, 500.0)  # of the commands and the log [Hz]
JOINTS = (1, 2, 3, 6, 12)
# gear, and side of the gear that the encoder is on; a rigid gear has one side
GEARS = (("rigid", "joint"), ("elastic", "joint"), ("rigid", "joint"), ("elastic", "rotor"))
# motion, and whether it reaches the torque limit: a slow sine does not
MOTIONS = (("rich", "reached"), ("poor", "far"), ("rich", "far"))
# lower and upper bounds of the constants, whose logarithms are uniformly distributed
RANGES = {
    "kd_over_kp": (0.02, 0.08),
    "delay": (0.003, 0.02),
    "armature": (0.005, 0.03),
    "coulomb": (0.05, 0.3),
    "viscous_damping": (0.05, 0.3),
}
KP_RANGES = {"soft": (8.0, 40.0), "stiff": (100.0, 300.0)}
BACKLASH = (0.002, 0.02)  # [rad]
# of an elastic gear: its stiffness over kp [-], and its damping over its stiffness [s]
STIFFNESS_RATIO = (4.0, 20.0)
DAMPING_TIME = (0.0005, 0.002)
# values of constants that a rigid gear or every simulated motor lacks
ABSENT = {"velocity_filter": 0.0, "stribeck_torque": 0.0, "load_friction": 0.0, "encoder_zero": 0.0}
RIGID = {"gear_stiffness": np.inf, "backlash": 0.0}
# torque limit over the 99 % quantile of the requested torque: reached, or never
LIMIT_RATIOS = {"reached": 0.8, "far": 20.0}
# constant -> attribute of a MuJoCo joint
MJCF = {"armature": "armature", "coulomb": "frictionloss", "viscous_damping": "damping"}
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
<geom type="capsule" size="0.02" fromto="0 0 0 {length} 0 0" mass="{mass}" contype="0"
 conaffinity="0"/>
"""
MODEL = """<mujoco><compiler angle="radian"/><worldbody>
{links}
</worldbody></mujoco>"""
Constants = dict[str, np.ndarray]  # (joints,) by name


@dataclass(frozen=True)
class ArmDesign:
    """What an arm is, and what its log holds."""

    joints: int
    rate: float  # of commands and log [Hz]
    gains: str  # "stated" or "unknown"
    encoder: str  # "joint" or "rotor"
    torque: str  # "logged" or "missing"
    servo: str  # "soft" or "stiff"
    gear: str  # "rigid" or "elastic"
    motion: str  # "rich" or "poor"
    limit: str  # "reached" or "far"

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of figures that the arm belongs to."""
        return (
            f"joints_{self.joints}",
            f"rate_{self.rate:g}",
            f"gains_{self.gains}",
            f"encoder_{self.encoder}",
            f"torque_{self.torque}",
            f"servo_{self.servo}",
            f"gear_{self.gear}",
            f"motion_{self.motion}",
            f"limit_{self.limit}",
        )


def designs(count: int, seed: int) -> list[ArmDesign]:
    """Designs of ``count`` arms: each property takes its values in turns, in a random order."""
    rng = np.random.default_rng([seed, 1])

    def in_turns(values: tuple) -> list:
        turns = [values[index % len(values)] for index in range(count)]
        return [turns[index] for index in rng.permutation(count)]

    columns = {
        "joints": in_turns(JOINTS),
        "rate": in_turns(RATES),
        "gains": in_turns(("stated", "unknown")),
        "torque": in_turns(("logged", "missing", "missing")),
        "servo": in_turns(("soft", "stiff")),
        "gear, encoder": in_turns(GEARS),
        "motion, limit": in_turns(MOTIONS),
    }
    arms = []
    for values in zip(*columns.values(), strict=True):
        properties = {}
        for name, value in zip(columns, values, strict=True):
            names = name.split(", ")
            properties |= dict(zip(names, value, strict=True) if len(names) > 1 else {name: value})
        arms.append(ArmDesign(**properties))
    return arms


def drawn_constants(rng: np.random.Generator, design: ArmDesign) -> Constants:
    """True constants of the motors of an arm, without the torque limit."""

    def drawn(bounds: tuple[float, float]) -> np.ndarray:
        low, high = np.log(bounds)
        return np.exp(rng.uniform(low, high, design.joints))

    constants = {"kp": drawn(KP_RANGES[design.servo])}
    constants |= {name: drawn(bounds) for name, bounds in RANGES.items()}
    constants |= {name: np.full(design.joints, value) for name, value in ABSENT.items()}
    if design.gear == "elastic":
        stiffness = constants["kp"] * drawn(STIFFNESS_RATIO)
        damping = stiffness * drawn(DAMPING_TIME)
        elastic = {"gear_stiffness": stiffness, "gear_damping": damping}
        return constants | elastic | {"backlash": drawn(BACKLASH)}
    return constants | {name: np.full(design.joints, value) for name, value in RIGID.items()}


def recorded(
    folder: Path, design: ArmDesign, constants: Constants, seconds: float, seed: int
) -> tuple[mp.MotorLog, Constants]:
    """The log of an arm, on the grid of the fit and with loads; and its constants with limits."""
    rng = np.random.default_rng([seed, 2])
    target = commands(rng, design, seconds)
    model_file = write_arm(folder / "true", design, constants)
    unlimited = constants | {"torque_limit": np.full(design.joints, np.inf)}
    _, _, requests = simulated(model_file, design, unlimited, target)
    ratio = LIMIT_RATIOS[design.limit]
    limit = ratio * np.quantile(np.abs(requests), 0.99, axis=0)
    constants = constants | {"torque_limit": limit}
    angles, torques, _ = simulated(model_file, design, constants, target)

    # the robot description without the constants, which the fit must find
    robot = mp.load_robot(str(write_arm(folder / "known", design, {}).with_suffix(".toml")))
    quantum = 2.0 * np.pi / ENCODER
    ones = np.ones_like(target)
    kd = constants["kp"] * constants["kd_over_kp"]
    noise = TORQUE_NOISE * np.sqrt(np.mean(torques**2, axis=0)) * rng.standard_normal(target.shape)
    log = mp.MotorLog(
        time=np.arange(len(target)) / design.rate,
        position_target=target,
        joint_pos=quantum * np.round(angles / quantum),
        joint_torque=torques + noise if design.torque == "logged" else None,
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=f"arm {seed}",
        encoder=design.encoder,
        logged_kp=constants["kp"] * ones if design.gains == "stated" else None,
        logged_kd=kd * ones if design.gains == "stated" else None,
    )
    return with_loads(smooth_on_grid(log, PERIOD), robot), constants


def commands(rng: np.random.Generator, design: ArmDesign, seconds: float) -> np.ndarray:
    """(rows, joints) commanded angles [rad], a row per command.

    Rich motion is a sum of sines up to 4 Hz and steps every second, poor motion one slow sine.
    """
    time = np.arange(round(seconds * design.rate)) / design.rate
    second = time.astype(int)
    joints = design.joints
    frequency = np.exp(rng.uniform(np.log(0.2), np.log(4.0), (4, joints)))
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (2, 4, joints))
    if design.motion == "poor":
        slow = 0.2 + 0.1 * frequency[0]
        return 0.25 * np.sin(2.0 * np.pi * slow * time[:, None] + phase[0])

    sines = np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)
    waves = sines * (0.3 + size / (2.0 * np.pi)) * 0.15
    steps = rng.uniform(-0.4, 0.4, (int(seconds) + 1, joints))[second]
    return waves.sum(axis=1) + steps * (second % 3 == 0)[:, None]


def simulated(
    model_file: Path, design: ArmDesign, constants: Constants, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Encoder angles [rad], torques on the joints and torques of the PD [N·m], (rows, joints).

    They are at the times of the commands.
    """
    model = mujoco.MjModel.from_xml_path(str(model_file))
    model.opt.timestep = PHYSICS_DT
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    data.qpos[:] = target[0]
    rotor_pos = target[0].copy()
    rotor_vel = np.zeros_like(rotor_pos)

    kp = constants["kp"]
    kd = constants["kp"] * constants["kd_over_kp"]
    joints = np.arange(design.joints)
    is_elastic = design.gear == "elastic"
    logs_rotor = is_elastic and design.encoder == "rotor"
    angles = np.empty_like(target)
    torques = np.zeros_like(target)
    requests = np.zeros_like(target)
    step = 0
    for row in range(len(target)):
        angles[row] = rotor_pos if logs_rotor else data.qpos
        is_first = True
        while step * PHYSICS_DT < (row + 1) / design.rate - 1e-9:
            time = step * PHYSICS_DT
            sent_row = np.floor((time - constants["delay"]) * design.rate + 1e-9).astype(int)
            delayed = target[np.maximum(sent_row, 0), joints]
            # the PD follows the rotor, on whichever side of the gear the log's encoder is
            motor_pos = rotor_pos if is_elastic else data.qpos
            motor_vel = rotor_vel if is_elastic else data.qvel
            request = kp * (delayed - motor_pos) - kd * motor_vel
            torque = np.clip(request, -constants["torque_limit"], constants["torque_limit"])
            if is_elastic:
                gear_torque = _gear_torque(constants, rotor_pos - data.qpos, rotor_vel - data.qvel)
                rotor_vel = _rotor_velocity(constants, rotor_vel, torque - gear_torque)
                rotor_pos = rotor_pos + PHYSICS_DT * rotor_vel
                torque = gear_torque
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
            if not is_elastic:
                # what friction and the rotor leave for the link
                friction = data.qfrc_passive + data.qfrc_constraint
                torque = torque + friction - constants["armature"] * data.qacc
            if is_first:
                torques[row] = torque
            is_first = False
            requests[row] = request
            step += 1
    return angles, torques, requests


def _gear_torque(constants: Constants, twist: np.ndarray, twist_vel: np.ndarray) -> np.ndarray:
    """(joints,) torque [N·m] of the gears on the joints."""
    half_backlash = 0.5 * constants["backlash"]
    deflection = twist - np.clip(twist, -half_backlash, half_backlash)
    spring = constants["gear_stiffness"] * deflection
    return spring + constants["gear_damping"] * twist_vel * (deflection != 0.0)


def _rotor_velocity(constants: Constants, velocity: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """(joints,) rotor velocities [rad/s] after a step with ``torque`` [N·m] and friction."""
    per_torque = PHYSICS_DT / constants["armature"]
    viscous = constants["viscous_damping"] * velocity
    without_coulomb = velocity + per_torque * (torque - viscous)
    stopped = np.maximum(np.abs(without_coulomb) - per_torque * constants["coulomb"], 0.0)
    return np.sign(without_coulomb) * stopped


def write_arm(folder: Path, design: ArmDesign, constants: Constants) -> Path:
    """Write the model of the arm and its description; returns the file of the model.

    The model has the armature and friction of rigid gears if ``constants`` has them.
    """
    # links of long arms are shorter, so that the first joint carries no unusual load
    length = 0.2 if design.joints <= 3 else 0.1
    mass = 0.3 if design.joints <= 3 else 0.1
    has_rotors = design.gear == "rigid"
    links = ""
    for joint in range(design.joints):
        attributes = []
        for name, attribute in MJCF.items():
            if has_rotors and name in constants:
                attributes.append(f'{attribute}="{constants[name][joint]:.12g}"')
        links += LINK.format(
            joint=joint,
            axis="0 0 1" if joint % 3 == 0 and design.joints > 1 else "0 1 0",
            pos="0 0 0" if joint == 0 else f"{length} 0 0",
            length=length,
            mass=mass,
            friction=FRICTION,
            motor=" ".join(attributes),
        )
    links += "</body>" * design.joints

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(MODEL.format(links=links), "utf-8")
    (folder / "arm.toml").write_text(ROBOT, "utf-8")
    return folder / "arm.xml"
