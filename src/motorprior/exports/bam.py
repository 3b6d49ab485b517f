"""JSON of better-actuator-models (BAM): read as motors, written as one file per sample and joint.

Control law, friction m1, m2 and m5, and integrator of its simulator, after BAM 1.0.2 (Rhoban/bam,
Apache-2.0), with M the torque of the motor and E that of the load on it [N·m]:

    voltage   V = vin·clip(error_gain·kp·(target - q), ±max_pwm);  M = kt·V/R - kt²/R·dq
    torque    M = clip(ratio·kp·(target - q) - damping·dq, ±max_torque)
    friction  F = friction_base + G + s·(friction_stribeck + G_s) + quadratic,  s =
    exp(-|dq/dtheta_stribeck|^alpha)
              G = |load_friction_external·E - load_friction_motor·M| (m5)
    encoder   reads q - q_offset, where q is the joint angle
    joint     inertia J + armature; friction stops it with at most F + friction_viscous·|dq|

`read_motor` converts a servo to a motor with a stiff gear, otherwise exact for m1. For other
models, load friction acts on the gear torque, and the Stribeck velocity is STRIBECK_VELOCITY.

The export writes friction m5 with the actuator unitree_go1: a torque control law without velocity
filter. A rigid gear with load inertia J and armature a transmits (J·M - a·E)/(J + a). The load
friction of M is therefore load_friction·J/(J + a), that of E load_friction·a/(J + a); J = a is
assumed. kp, damping and command_delay are not parameters of BAM's models: set them where the file
is used.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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

# name in BAM -> supply [V], duty cycle per error [rad] and unit of kp, maximum duty cycle, usual kp
VOLTAGE = {
    "mx64": (15.0, 0.158, 0.9625, 32.0), "mx106": (15.0, 0.158, 0.9625, 32.0), "xl320": (7.5, 0.05048199, 1.0, 32.0),
    "xl330": (7.5, 4096 / (2 * math.pi) / (256 * 885), 1.0, 400.0), "sts3215": (7.4, 0.166, 0.97, 32.0),
}  # fmt: skip
TORQUE = "unitree_go1"
_REMEDY = "give the JSON that bam.fit writes"
# exp(-|v/(1.22·STRIBECK_VELOCITY)|^1.05) is close to our 1/(1 + (v/STRIBECK_VELOCITY)²)
STRIBECK_SHAPE = {"dtheta_stribeck": 1.22 * STRIBECK_VELOCITY, "alpha": 1.05}
# gear mode of `rigid_gear`, resolved at steps of 2 ms [rad/s], [-]
RIGID_FREQUENCY = 500.0
RIGID_DAMPING_RATIO = 0.3


@dataclass(frozen=True)
class BamMotor:
    """One servo; its control law in units of the joint."""

    values: Mapping[str, float]  # constants by BAM's names; those of other models are 0
    kp: float  # [N·m/rad]
    kd: float  # [N·m·s/rad]
    max_torque: float  # torque limit at standstill [N·m]
    limits_damping: bool  # whether max_torque also limits kd·dq, as in the control law with torque

    @classmethod
    def of(
        cls,
        table: Mapping[str, Any],
        kp: float | None = None,
        vin: float | None = None,
        where: Path | None = None,
    ) -> "BamMotor":
        """The servo of a table of parameters from the file ``where``; kp and vin as in `read_motor`.

        Raises ArtifactError for no table, an unknown model or actuator, or a value that is not a
        number.
        """
        require("content", table, TABLE, where, _REMEDY)
        v = defaultdict(float, table)
        actuator = v.pop("actuator", None)
        require(
            "model",
            v.pop("model", None),
            one_of("m1", "m2", "m3", "m4", "m5", "m6"),
            where,
            _REMEDY,
        )
        require("actuator", actuator, one_of(*VOLTAGE, TORQUE), where, _REMEDY)
        v.pop("motorprior", None)
        for name, value in v.items():
            require(name, value, number(), where, _REMEDY)
        if actuator == TORQUE:
            kp = v["kp"] if kp is None else kp
            return cls(v, v["ratio"] * kp, v["damping"], v["max_torque"], True)
        supply, gain, max_pwm, usual = VOLTAGE[str(actuator)]
        kp = v.get("kp", usual) if kp is None else kp
        vin = v.get("vin", supply) if vin is None else vin
        gain = gain * v.get("error_gain_ratio", 1.0)
        per_volt = v["kt"] / v["R"] if v["R"] else 0.0
        return cls(
            v, gain * kp * vin * per_volt, v["kt"] * per_volt, vin * max_pwm * per_volt, False
        )

    def friction(self, motor: float, load: float, dq: float) -> float:
        """Dry friction [N·m] at these torques [N·m] and this velocity [rad/s]."""
        v = self.values
        slow = (
            math.exp(-(abs(dq / v["dtheta_stribeck"]) ** v["alpha"]))
            if v["dtheta_stribeck"]
            else 0.0
        )
        own = abs(load * v["load_friction_external"] - motor * v["load_friction_motor"])
        slow_own = abs(
            load * v["load_friction_external_stribeck"] - motor * v["load_friction_motor_stribeck"]
        )
        return v["friction_base"] + slow * v["friction_stribeck"] + own + slow * slow_own

    def simulate(self, given: Trial, motor: int) -> np.ndarray:
        """(steps,) joint angles [rad] in BAM's own integration, for one joint of a trial."""
        assert given.load_stiffness is not None
        v = self.values
        limit = self.max_torque
        h = given.dt
        inertia = given.load_inertia[motor] + v["armature"]
        viscous = v["friction_viscous"]
        late = v["command_delay"] / h
        offset = v["q_offset"]
        steps = np.arange(len(given.position_target)) - late
        targets = np.interp(steps, np.arange(len(steps)), given.position_target[:, motor])
        out = np.zeros(len(steps))
        q = given.position_target[0, motor] if given.joint_pos is None else given.joint_pos[motor]
        dq = 0.0
        for step in range(len(steps)):
            out[step] = q
            inside, outside = (self.kd * dq, 0.0) if self.limits_damping else (0.0, self.kd * dq)
            push = self.kp * (targets[step] - q + offset) - inside
            torque = min(limit, max(-limit, push)) - outside
            weight = given.external_torque[step, motor] + given.load_stiffness[step, motor] * q
            net = torque + weight
            stop = inertia / h * dq + net
            net -= math.copysign(
                min(abs(stop), self.friction(torque, weight, dq) + viscous * abs(dq)), stop
            )
            acceleration = net / inertia
            dq += h * acceleration
            q += h * dq + 0.5 * acceleration * h * h
        return out


def motors_of(values: ConstantArrays, terms: tuple[str, ...] = ()) -> GreyBoxActuator:
    """Motors with the constants (n,) by name, kd instead of kd_over_kp, for physics steps up to 2 ms."""
    raw = encoded({**values, "kd_over_kp": values["kd"] / values["kp"]}, terms).T
    center = raw.mean(axis=0)
    return GreyBoxActuator(GreyBox(center, np.eye(len(center)), 0.002, terms), raw - center, COLD)


def rigid_gear(armature: float) -> dict[str, float]:
    """Constants by name of a gear that is as good as rigid, without backlash."""
    return {
        "gear_stiffness": armature * RIGID_FREQUENCY**2,
        "backlash": 0.0,
        "gear_damping": 2.0 * RIGID_DAMPING_RATIO * armature * RIGID_FREQUENCY,
    }


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
        ConfigError: kp, vin or another constant makes no motor.
    """
    path = Path(path)
    servo = BamMotor.of(read_json(path), kp, vin, path)
    v = servo.values
    limit = servo.max_torque
    armature = servo.values["armature"]
    if not (servo.kp > 0.0 and limit > 0.0 and armature > 0.0):
        problem = f"kp {servo.kp:.3g} N·m/rad, torque limit {limit:.3g} N·m, armature {armature:.3g} kg·m²"
        raise ConfigError(
            problem,
            where=path,
            remedy="give kp and vin above 0, and a file with kt, R and armature",
        )
    load = v["load_friction_motor"] + v["load_friction_external"] + 2.0 * v["load_friction_base"]
    values = {
        "kp": servo.kp,
        "kd": max(servo.kd, 1e-9),
        "velocity_filter": 1e-5,
        "delay": v["command_delay"],
        "torque_limit": limit if servo.limits_damping else 1e3,
        "armature": armature,
        "coulomb": v["friction_base"],
        "stribeck_torque": v["friction_stribeck"],
        "viscous_damping": v["friction_viscous"],
        "load_friction": load,
        "encoder_zero": -v["q_offset"],
        **rigid_gear(armature),
    }
    terms = () if servo.limits_damping else ("torque_speed",)
    if terms:  # the voltage limits, and the back-EMF brakes beyond it
        values |= {"stall_torque": limit, "no_load_speed": limit / servo.kd}
    return motors_of({name: np.full(count, value) for name, value in values.items()}, terms)


def parameters(v: Mapping[str, float]) -> dict[str, float | str]:
    """BAM's parameters of one motor, of its constants by name."""
    return {
        "model": "m5",
        "actuator": "unitree_go1",
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
    """One JSON per sample and joint; the key motorprior, which BAM ignores, has origin and loss."""
    files = []
    about = request.provenance()
    for index, joint, values in request.motors():
        files.append(request.out / f"{joint}_{index:03d}.json")
        write_json(files[-1], parameters(values) | {"motorprior": about})
    return files


def _replay(values: ConstantArrays, given: Trial) -> np.ndarray:
    """(steps, n) joint angles [rad] of BAM's control law and its own integration."""
    servos = [
        BamMotor.of(parameters(one_motor(values, motor))) for motor in range(len(values["kp"]))
    ]
    return np.stack([servo.simulate(given, motor) for motor, servo in enumerate(servos)], axis=1)


BAM = Exporter(
    "bam", ("velocity_filter", "gear_stiffness", "backlash", "gear_damping"), _write, _replay
)
