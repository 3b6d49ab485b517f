"""Servos of better-actuator-models (BAM): law, friction m1, m2 and m5, and integration of its simulator.

After BAM 1.0.2 (Rhoban/bam, Apache-2.0), with M the torque of the motor and E that of the load on it [N·m]:

    voltage   V = vin·clip(error_gain·kp·(target - q), ±max_pwm);  M = kt·V/R - kt²/R·dq
    torque    M = clip(ratio·kp·(target - q) - damping·dq, ±max_torque)
    friction  F = friction_base + G + s·(friction_stribeck + G_s) + quadratic,  s = exp(-|dq/dtheta_stribeck|^alpha)
              G = |load_friction_external·E - load_friction_motor·M| (m5)
    encoder   reads q - q_offset, where q is the angle of the joint
    joint     stopped by at most F + friction_viscous·|dq|, inertia J + armature

A servo of a JSON becomes a motor here by `read_motor`: exact for m1 up to a stiff gear; load friction, which BAM takes
from E and M, acts on the torque in the gear, and the Stribeck velocity is our own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.artifacts import read_json
from motorprior.bench.dynamometer import Trial
from motorprior.bounds import is_number
from motorprior.exceptions import ArtifactError, ConfigError, quoted
from motorprior.exports.exporter import motors_of

# name in BAM -> supply [V], duty cycle per error [rad] and unit of kp, maximum duty cycle, usual kp
VOLTAGE = {
    "mx64": (15.0, 0.158, 0.9625, 32.0), "mx106": (15.0, 0.158, 0.9625, 32.0), "xl320": (7.5, 0.05048199, 1.0, 32.0),
    "xl330": (7.5, 4096 / (2 * math.pi) / (256 * 885), 1.0, 400.0), "sts3215": (7.4, 0.166, 0.97, 32.0),
}  # fmt: skip
TORQUE = "unitree_go1"
_MODELS = ("m1", "m2", "m3", "m4", "m5", "m6")
_REMEDY = "give the JSON that bam.fit writes"
RIGID_FREQUENCY, RIGID_DAMPING_RATIO = 500.0, 0.3  # of `rigid_gear`, resolved at steps of 2 ms [rad/s], [-]


@dataclass(frozen=True)
class BamMotor:
    """One servo."""

    values: Mapping[str, float]  # parameters by BAM's names; those of other models are 0
    actuator: str
    kp: float  # in firmware units, or N·m/rad for the law with torque
    vin: float  # supply voltage [V]

    @classmethod
    def of(
        cls, table: Mapping[str, Any], kp: float | None = None, vin: float | None = None, where: Path | None = None
    ) -> BamMotor:
        """The servo of a table of parameters; kp and vin of the table, or BAM's own, if not given.

        Raises:
            ArtifactError: an unknown model or actuator, or a value that is not a number; names the file ``where``.
        """
        model, actuator = table.get("model"), table.get("actuator")
        if model not in _MODELS or (actuator not in VOLTAGE and actuator != TORQUE):
            known = f"models {', '.join(_MODELS)}, actuators {', '.join((*VOLTAGE, TORQUE))}"
            problem = f"model {quoted(model)}, actuator {quoted(actuator)}"
            raise ArtifactError(problem, where=where, remedy=f"known are {known}")
        numbers = {name: value for name, value in table.items() if name not in ("model", "actuator", "motorprior")}
        for name, value in numbers.items():
            if not is_number(value):
                raise ArtifactError(f"{name} {quoted(value)} is not a number", where=where, remedy=_REMEDY)
        supply, _, _, usual = VOLTAGE.get(str(actuator), (0.0, 0.0, 0.0, 0.0))
        gain = kp if kp is not None else float(numbers.get("kp", usual))
        return cls(numbers, str(actuator), gain, float(numbers.get("vin", supply)) if vin is None else vin)

    def __getitem__(self, name: str) -> float:
        return float(self.values.get(name, 0.0))

    def law(self) -> tuple[float, float, float, float]:
        """Gains kp [N·m/rad], kd [N·m·s/rad], stall torque [N·m], and 1 if kd acts within the limit, else 0."""
        if self.actuator == TORQUE:
            return self["ratio"] * self.kp, self["damping"], self["max_torque"], 1.0
        _, gain, max_pwm, _ = VOLTAGE[self.actuator]
        gain *= self.values.get("error_gain_ratio", 1.0)
        per_volt = self["kt"] / self["R"]
        return gain * self.kp * self.vin * per_volt, self["kt"] * per_volt, self.vin * max_pwm * per_volt, 0.0

    def friction(self, motor: float, load: float, dq: float) -> float:
        """Dry friction [N·m] at these torques [N·m] and this velocity [rad/s]."""
        v = self
        slow = math.exp(-(abs(dq / v["dtheta_stribeck"]) ** v["alpha"])) if v["dtheta_stribeck"] else 0.0
        own = abs(load * v["load_friction_external"] - motor * v["load_friction_motor"])
        slow_own = abs(load * v["load_friction_external_stribeck"] - motor * v["load_friction_motor_stribeck"])
        return v["friction_base"] + slow * v["friction_stribeck"] + own + slow * slow_own

    def simulate(self, given: Trial, motor: int, load: Callable[[float], float] | None = None) -> np.ndarray:
        """(steps,) joint angles [rad] in BAM's own integration, for one joint of a trial.

        ``load`` (angle [rad]) replaces the external torque of the trial [N·m].
        """
        assert given.load_stiffness is not None
        kp, kd, limit, within = self.law()
        inertia, h, viscous = given.load_inertia[motor] + self["armature"], given.dt, self["friction_viscous"]
        late, offset = self["command_delay"] / h, self["q_offset"]
        steps = np.arange(len(given.position_target)) - late
        targets = np.interp(steps, np.arange(len(steps)), given.position_target[:, motor])
        out = np.zeros(len(steps))
        q, dq = given.position_target[0, motor] if given.joint_pos is None else given.joint_pos[motor], 0.0
        for step in range(len(steps)):
            out[step] = q
            push = kp * (targets[step] - q + offset) - within * kd * dq
            torque = min(limit, max(-limit, push)) - (1.0 - within) * kd * dq
            weight = given.external_torque[step, motor] + given.load_stiffness[step, motor] * q
            weight = weight if load is None else load(q)
            net = torque + weight
            stop = inertia / h * dq + net
            net -= math.copysign(min(abs(stop), self.friction(torque, weight, dq) + viscous * abs(dq)), stop)
            acceleration = net / inertia
            dq += h * acceleration
            q += h * dq + 0.5 * acceleration * h * h
        return out


def rigid_gear(armature: float) -> dict[str, float]:
    """Constants by name of a gear that is as good as rigid, without backlash."""
    return {
        "gear_stiffness": armature * RIGID_FREQUENCY**2, "backlash": 0.0,
        "gear_damping": 2.0 * RIGID_DAMPING_RATIO * armature * RIGID_FREQUENCY,
    }  # fmt: skip


def read_motor(path: str | Path, kp: float | None = None, vin: float | None = None, count: int = 1) -> GreyBoxActuator:
    """Motors of a JSON of better-actuator-models (m1 to m6).

    Args:
        path: the file.
        kp: proportional gain in firmware units, or N·m/rad for unitree_go1; the file's or BAM's own if not given.
        vin: supply voltage [V]; the file's or BAM's own if not given.
        count: number of equal motors.

    Returns:
        Motors with a stiff gear, for physics steps up to 2 ms.

    Raises:
        ArtifactError: not such a file, or an actuator whose law is unknown here.
        ConfigError: kp, vin or another constant makes no motor.
    """
    path = Path(path)
    table = read_json(path)
    if not isinstance(table, dict):
        raise ArtifactError("not a table", where=path, remedy=_REMEDY)
    servo = BamMotor.of(table, kp, vin, path)
    stiff, damping, limit, within = servo.law()
    armature = servo["armature"]
    if not (stiff > 0.0 and limit > 0.0 and armature > 0.0):
        problem = f"kp {stiff:.3g} N·m/rad, torque limit {limit:.3g} N·m, armature {armature:.3g} kg·m²"
        raise ConfigError(problem, where=path, remedy="give kp and vin above 0, and a file with kt, R and armature")
    load = servo["load_friction_motor"] + servo["load_friction_external"] + 2.0 * servo["load_friction_base"]
    values = {
        "kp": stiff, "kd": max(damping, 1e-9), "velocity_filter": 1e-5, "delay": servo["command_delay"],
        "torque_limit": limit if within else 1e3, "armature": armature, "coulomb": servo["friction_base"],
        "stribeck_torque": servo["friction_stribeck"], "viscous_damping": servo["friction_viscous"],
        "load_friction": load, "encoder_zero": -servo["q_offset"], **rigid_gear(armature),
    }  # fmt: skip
    if not within:  # the voltage limits, and the back-EMF brakes beyond it
        values |= {"stall_torque": limit, "no_load_speed": limit / damping}
    terms = () if within else ("torque_speed",)
    return motors_of({name: np.full(count, value) for name, value in values.items()}, terms)
