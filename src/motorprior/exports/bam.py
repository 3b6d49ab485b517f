"""Format bam, JSON of better-actuator-models (BAM): read as motors, written per sample and joint.

Control laws, friction models m1, m2 and m5, and integrator of its simulator, after BAM 1.0.2
(Rhoban/bam, Apache-2.0). M is the torque of the motor, and E the torque of the load on it [N·m]:

    voltage   V = vin·clip(error_gain·kp·(target - q), ±max_pwm);  M = kt·V/R - kt²/R·dq
    torque    M = clip(ratio·kp·(target - q) - damping·dq, ±max_torque)
    friction  F = friction_base + G + s·(friction_stribeck + G_s)
              s = exp(-|dq/dtheta_stribeck|^alpha)
              G = |load_friction_external·E - load_friction_motor·M|
              G_s = |load_friction_external_stribeck·E - load_friction_motor_stribeck·M|
    encoder   reads q - q_offset, where q is the joint angle
    joint     inertia J + armature; friction stops it with at most F + friction_viscous·|dq|

`read_motor` converts a servo to a motor with a stiff gear. The conversion is otherwise exact for
m1. For other models, load friction acts on the gear torque, and the Stribeck velocity is
STRIBECK_VELOCITY.

The export writes friction m5 with the actuator unitree_go1: a torque control law without velocity
filter. A rigid gear with load inertia J and armature a transmits (J·M - a·E)/(J + a). The
coefficient load_friction_motor is therefore load_friction·J/(J + a), and load_friction_external is
load_friction·a/(J + a). The load inertia is unknown; J = a is assumed. kp, damping and
command_delay are not parameters of BAM's models: set them where the file is used.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motorprior.actuator.geared_motor_step import STRIBECK_VELOCITY
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.optional_terms import COLD
from motorprior.artifacts import read_json, write_json
from motorprior.bench.dynamometer import Trial
from motorprior.bounds import TABLE, number, one_of, require
from motorprior.exceptions import ConfigError
from motorprior.exports.exporter import ConstantArrays, Exporter, Request, one_motor
from motorprior.identification.physics.motor_problem import encoded


class _VoltageServo(NamedTuple):
    """Firmware of a servo that sets a voltage."""

    vin: float  # supply [V]
    error_gain: float  # duty cycle per error and unit of kp [1/rad]
    max_pwm: float  # largest duty cycle [-]
    kp: float  # usual proportional gain, in the firmware's unit


# xl330: 4096 encoder steps per turn, gain divided by 256, duty cycle in units of 1/885
_XL330_STEPS_PER_RADIAN = 4096 / (2 * math.pi)
_XL330_ERROR_GAIN = _XL330_STEPS_PER_RADIAN / (256 * 885)
VOLTAGE = {
    "mx64": _VoltageServo(15.0, 0.158, 0.9625, 32.0),
    "mx106": _VoltageServo(15.0, 0.158, 0.9625, 32.0),
    "xl320": _VoltageServo(7.5, 0.05048199, 1.0, 32.0),
    "xl330": _VoltageServo(7.5, _XL330_ERROR_GAIN, 1.0, 400.0),
    "sts3215": _VoltageServo(7.4, 0.166, 0.97, 32.0),
}
TORQUE_ACTUATOR = "unitree_go1"  # the actuator with a torque control law
_MODELS = ("m1", "m2", "m3", "m4", "m5", "m6")
_REMEDY = "give the JSON that bam.fit writes"

# exp(-|v/(1.22·STRIBECK_VELOCITY)|^1.05) is close to our 1/(1 + (v/STRIBECK_VELOCITY)²)
STRIBECK_SHAPE = {"dtheta_stribeck": 1.22 * STRIBECK_VELOCITY, "alpha": 1.05}
# natural frequency [rad/s] and damping ratio [-] of the rotor on the gear of `rigid_gear`; steps of
# 2 ms resolve this oscillation
RIGID_FREQUENCY = 500.0
RIGID_DAMPING_RATIO = 0.3
_MAX_STEP = 0.002  # largest physics step of the motors [s]


@dataclass(frozen=True)
class BamMotor:
    """One servo; its control law in units of the joint."""

    values: Mapping[str, float]  # constants by BAM's names; constants of other models are 0
    kp: float  # [N·m/rad]
    kd: float  # [N·m·s/rad]
    max_torque: float  # torque limit at standstill [N·m]
    # whether max_torque also limits kd·dq, as in a torque control law
    limits_damping: bool

    @classmethod
    def of(
        cls,
        table: Mapping[str, Any],
        kp: float | None = None,
        vin: float | None = None,
        where: Path | None = None,
    ) -> "BamMotor":
        """The servo of a table of parameters from the file ``where``.

        For kp and vin see `read_motor`. Raises ArtifactError for no table, an unknown model
        or actuator, or a value that is not a number.
        """
        require("content", table, TABLE, where, _REMEDY)
        values = defaultdict(float, table)  # parameters of other models are 0
        actuator = values.pop("actuator", None)
        model = values.pop("model", None)
        values.pop("motorprior", None)
        require("model", model, one_of(*_MODELS), where, _REMEDY)
        require("actuator", actuator, one_of(*VOLTAGE, TORQUE_ACTUATOR), where, _REMEDY)
        for name, value in values.items():
            require(name, value, number(), where, _REMEDY)

        if actuator == TORQUE_ACTUATOR:
            kp = values["kp"] if kp is None else kp
            return cls(values, values["ratio"] * kp, values["damping"], values["max_torque"], True)

        servo = VOLTAGE[str(actuator)]
        kp = values.get("kp", servo.kp) if kp is None else kp
        vin = values.get("vin", servo.vin) if vin is None else vin
        duty_per_error = servo.error_gain * values.get("error_gain_ratio", 1.0)
        torque_per_volt = values["kt"] / values["R"] if values["R"] else 0.0
        return cls(
            values,
            kp=duty_per_error * kp * vin * torque_per_volt,
            kd=values["kt"] * torque_per_volt,
            max_torque=vin * servo.max_pwm * torque_per_volt,
            limits_damping=False,
        )

    def friction(self, motor: float, load: float, dq: float) -> float:
        """Dry friction [N·m] at these torques [N·m] and this velocity [rad/s]."""
        values = self.values
        stribeck_factor = 0.0  # s; 1 at standstill
        if values["dtheta_stribeck"]:
            relative_speed = abs(dq / values["dtheta_stribeck"])
            stribeck_factor = math.exp(-(relative_speed ** values["alpha"]))

        of_load = load * values["load_friction_external"]
        of_motor = motor * values["load_friction_motor"]
        load_friction = abs(of_load - of_motor)

        slow_of_load = load * values["load_friction_external_stribeck"]
        slow_of_motor = motor * values["load_friction_motor_stribeck"]
        slow_load_friction = abs(slow_of_load - slow_of_motor)

        dry_friction = values["friction_base"] + stribeck_factor * values["friction_stribeck"]
        return dry_friction + load_friction + stribeck_factor * slow_load_friction

    def simulate(self, trial: Trial, motor: int) -> np.ndarray:
        """(steps,) joint angles [rad] in BAM's own integration, for one joint of a trial."""
        assert trial.load_stiffness is not None
        h = trial.dt
        limit = self.max_torque
        viscous = self.values["friction_viscous"]
        offset = self.values["q_offset"]
        inertia = trial.load_inertia[motor] + self.values["armature"]

        num_steps = len(trial.position_target)
        times = np.arange(num_steps) - self.values["command_delay"] / h
        targets = np.interp(times, np.arange(num_steps), trial.position_target[:, motor])

        start = trial.position_target[0] if trial.joint_pos is None else trial.joint_pos
        q = start[motor]
        dq = 0.0
        angles = np.zeros(num_steps)
        for step in range(num_steps):
            angles[step] = q

            # torque of the motor
            push = self.kp * (targets[step] - q + offset)
            if self.limits_damping:
                torque = min(limit, max(-limit, push - self.kd * dq))
            else:
                torque = min(limit, max(-limit, push)) - self.kd * dq

            # friction stops the joint, or opposes its motion
            load = trial.external_torque[step, motor] + trial.load_stiffness[step, motor] * q
            net = torque + load
            stopping_torque = inertia / h * dq + net
            friction = self.friction(torque, load, dq) + viscous * abs(dq)
            friction = min(abs(stopping_torque), friction)
            net -= math.copysign(friction, stopping_torque)

            acceleration = net / inertia
            dq += h * acceleration
            q += h * dq + 0.5 * acceleration * h * h
        return angles


def read_motor(
    path: str | Path, kp: float | None = None, vin: float | None = None, count: int = 1
) -> GreyBoxActuator:
    """Motors of a JSON of better-actuator-models (m1 to m6).

    Args:
        path: the file.
        kp: proportional gain in firmware units, or N·m/rad for unitree_go1; the file's or BAM's own
            if not given.
        vin: supply voltage [V]; the file's or BAM's own if not given.
        count: number of equal motors, with a stiff gear, for physics steps up to 2 ms.

    Raises:
        ArtifactError: not such a file, or an actuator whose control law is unknown here.
        ConfigError: kp, torque limit or armature are not positive.
    """
    path = Path(path)
    servo = BamMotor.of(read_json(path), kp, vin, path)
    parameters_of_file = servo.values
    limit = servo.max_torque
    armature = parameters_of_file["armature"]
    if not (servo.kp > 0.0 and limit > 0.0 and armature > 0.0):
        raise ConfigError(
            f"kp {servo.kp:.3g} N·m/rad, torque limit {limit:.3g} N·m, "
            f"armature {armature:.3g} kg·m²",
            where=path,
            remedy="give kp and vin above 0, and a file with kt, R and armature",
        )

    load_friction = (
        parameters_of_file["load_friction_motor"]
        + parameters_of_file["load_friction_external"]
        + 2.0 * parameters_of_file["load_friction_base"]
    )
    values = {
        "kp": servo.kp,
        "kd": max(servo.kd, 1e-9),
        "velocity_filter": 1e-5,
        "delay": parameters_of_file["command_delay"],
        "torque_limit": limit if servo.limits_damping else 1e3,
        "armature": armature,
        "coulomb": parameters_of_file["friction_base"],
        "stribeck_torque": parameters_of_file["friction_stribeck"],
        "viscous_damping": parameters_of_file["friction_viscous"],
        "load_friction": load_friction,
        "encoder_zero": -parameters_of_file["q_offset"],
        **rigid_gear(armature),
    }
    terms: tuple[str, ...] = ()
    # the voltage is limited, but the torque of the back-EMF is not
    if not servo.limits_damping:
        terms = ("torque_speed",)
        values["stall_torque"] = limit
        values["no_load_speed"] = limit / servo.kd
    return motors_of({name: np.full(count, value) for name, value in values.items()}, terms)


def motors_of(values: ConstantArrays, terms: tuple[str, ...] = ()) -> GreyBoxActuator:
    """Motors with the constants (n,) by name, kd instead of kd_over_kp.

    They are for physics steps up to 2 ms.
    """
    constants = {**values, "kd_over_kp": values["kd"] / values["kp"]}
    latents = encoded(constants, terms).T
    center = latents.mean(axis=0)
    one_latent_per_constant = np.eye(len(center))
    model = GreyBox(center, one_latent_per_constant, _MAX_STEP, terms)
    return GreyBoxActuator(model, latents - center, COLD)


def rigid_gear(armature: float) -> dict[str, float]:
    """Constants by name of a gear that is as good as rigid, without backlash."""
    return {
        "gear_stiffness": armature * RIGID_FREQUENCY**2,
        "backlash": 0.0,
        "gear_damping": 2.0 * RIGID_DAMPING_RATIO * armature * RIGID_FREQUENCY,
    }


def parameters(v: Mapping[str, float]) -> dict[str, float | str]:
    """BAM's parameters of one motor with the constants ``v`` by name."""
    return {
        "model": "m5",
        "actuator": TORQUE_ACTUATOR,
        "ratio": 1.0,
        "max_torque": v["torque_limit"],
        "armature": v["armature"],
        "q_offset": -v["encoder_zero"],
        "friction_base": v["coulomb"],
        "friction_stribeck": v["stribeck_torque"],
        "friction_viscous": v["viscous_damping"],
        "load_friction_motor": 0.5 * v["load_friction"],
        "load_friction_external": 0.5 * v["load_friction"],
        "load_friction_motor_stribeck": 0.0,
        "load_friction_external_stribeck": 0.0,
        **STRIBECK_SHAPE,
        "kp": v["kp"],
        "damping": v["kd"],
        "command_delay": v["delay"],
    }


def _write(request: Request) -> list[Path]:
    """Write one JSON per sample and joint.

    The key motorprior, which BAM ignores, has origin and loss.
    """
    paths = []
    provenance = request.provenance()
    for robot, joint, values in request.motors():
        path = request.out / f"{joint}_{robot:03d}.json"
        write_json(path, parameters(values) | {"motorprior": provenance})
        paths.append(path)
    return paths


def _replay(values: ConstantArrays, trial: Trial) -> np.ndarray:
    """(steps, n) joint angles [rad] of BAM's control law and its own integration."""
    angles = []
    for motor in range(len(values["kp"])):
        servo = BamMotor.of(parameters(one_motor(values, motor)))
        angles.append(servo.simulate(trial, motor))
    return np.stack(angles, axis=1)


BAM = Exporter(
    name="bam",
    not_expressed=("velocity_filter", "gear_stiffness", "backlash", "gear_damping"),
    write=_write,
    replay=_replay,
    has_other_commands=False,
)
