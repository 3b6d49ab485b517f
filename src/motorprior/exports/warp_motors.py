"""Geared motors as one Warp kernel in float32.

Warp takes the body of a function as C++, which `step_code` traces from the formula of the compiled
step.

n motors are columns of a table and of a memory, as on the CPU. Every motor has its own position in
the delay lines, so that it can be reset alone.
"""

# pyright: reportMissingImports=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportInvalidTypeForm=false
# Warp is an optional dependency.

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from motorprior.actuator.geared_motor_step import MAX_STIFFNESS
from motorprior.actuator.grey_box import LINE, REFERENCE_ROW, GreyBoxActuator, memory_rows
from motorprior.exceptions import ConfigError
from motorprior.exports.step_code import KP_LINE, LINES, step_code

# minimum stiffness of a softened gear over kp: twist is at most 5 % of the position error
MIN_STIFFNESS = 20.0

# arrays on a device
Rows = wp.array2d(dtype=float)
Row = wp.array(dtype=float)
Indices = wp.array(dtype=int)
Mask = wp.array(dtype=wp.bool)


@cache
def step_kernel(terms: tuple[str, ...]) -> wp.Kernel:
    """The kernel of a step of motors with these terms."""

    # Warp replaces the body by the C++
    @wp.func_native(step_code(terms))
    def motor_step(
        i: int,
        table: Rows,
        memory: Rows,
        clock: Indices,
        position_target: float,
        sent_velocity_target: float,
        sent_torque_feedforward: float,
        sent_kp_factor: float,
        sent_kd_factor: float,
        joint_pos: float,
        joint_vel: float,
        h: float,
        torque: Row,
        damping: Row,
    ): ...

    @wp.kernel(module="unique")
    def motors_step(
        samples: Rows,
        sample_index: Indices,
        waiting: Mask,
        table: Rows,
        memory: Rows,
        clock: Indices,
        position_target: Row,
        velocity_target: Row,
        torque_feedforward: Row,
        kp_factor: Row,
        kd_factor: Row,
        joint_pos: Row,
        joint_vel: Row,
        h: float,
        torque: Row,
        damping: Row,
    ):
        i = wp.tid()

        # restart at rest, at the joint's angle; the commands before were of position control
        if waiting[i]:
            waiting[i] = False
            clock[i] = 0
            for row in range(table.shape[0]):
                table[row, i] = samples[row, sample_index[i]]
            length = (memory.shape[0] - wp.static(LINE)) // wp.static(LINES)
            for row in range(memory.shape[0]):
                is_target = row >= wp.static(LINE) and row < wp.static(LINE) + length
                is_gain = row >= wp.static(LINE) + wp.static(KP_LINE) * length
                gain_or_zero = wp.where(is_gain, 1.0, 0.0)
                memory[row, i] = wp.where(is_target, joint_pos[i], gain_or_zero)
            memory[0, i] = joint_pos[i]
            memory[wp.static(REFERENCE_ROW), i] = joint_pos[i]

        motor_step(
            i,
            table,
            memory,
            clock,
            position_target[i],
            velocity_target[i],
            torque_feedforward[i],
            kp_factor[i],
            kd_factor[i],
            joint_pos[i],
            joint_vel[i],
            h,
            torque,
            damping,
        )

    return motors_step


class WarpMotors:
    """n motors on a device of Warp.

    To restart motors, set their elements of ``waiting`` (n,): they begin their next step at rest at
    its joint angle, as the columns ``sample_index`` (n,) of the samples. All motors wait at first.

    Args:
        samples: motors to choose from.
        count: n.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the physics step is longer than one of `max_steps`.
    """

    def __init__(self, samples: GreyBoxActuator, count: int, dt: float, device: str):
        _require_resolved(samples, dt)
        terms = samples.model.terms
        self.count = count
        self._step = step_kernel(terms)
        self._dt = dt
        self._device = device

        table = samples.table(dt).astype(np.float32)
        self._samples = wp.array(table, dtype=float, device=device)
        self.table = wp.zeros((len(table), count), dtype=float, device=device)
        rows = LINE + LINES * (memory_rows(dt) - LINE)
        self.memory = wp.zeros((rows, count), dtype=float, device=device)
        self._zeros = wp.zeros(count, dtype=float, device=device)
        self._ones = wp.ones(count, dtype=float, device=device)
        self.clock = wp.zeros(count, dtype=int, device=device)
        self.torque = wp.zeros(count, dtype=float, device=device)
        self.damping = wp.zeros(count, dtype=float, device=device)

        self.waiting = wp.full(count, True, dtype=wp.bool, device=device)
        first_samples = np.arange(count) % samples.num_motors
        self.sample_index = wp.array(first_samples, dtype=int, device=device)

    def step(
        self,
        position_target: Any,
        joint_pos: Any,
        joint_vel: Any,
        *,
        velocity_target: Any = None,
        torque_feedforward: Any = None,
        kp_factor: Any = None,
        kd_factor: Any = None,
    ) -> None:
        """Write ``torque`` [N·m] and ``damping`` [N·m·s/rad] for the coming physics step.

        Arguments are Warp arrays (n,) of the command of `Motors.step`: velocity target and
        feed-forward torque are 0 if not given, the factors on kp and kd 1. The engine gets
        torque - damping·joint_vel, of which it integrates the damping implicitly, as for `Motors`.
        """
        inputs = [
            self._samples,
            self.sample_index,
            self.waiting,
            self.table,
            self.memory,
            self.clock,
            position_target,
            self._zeros if velocity_target is None else velocity_target,
            self._zeros if torque_feedforward is None else torque_feedforward,
            self._ones if kp_factor is None else kp_factor,
            self._ones if kd_factor is None else kd_factor,
            joint_pos,
            joint_vel,
            self._dt,
            self.torque,
            self.damping,
        ]
        wp.launch(self._step, dim=self.count, inputs=inputs, device=self._device)


def max_steps(motors: GreyBoxActuator) -> np.ndarray:
    """(n,) longest physics steps [s] that leave half of a gear's stiffness, or MIN_STIFFNESS·kp."""
    values = motors.constants()
    needed = np.minimum(0.5 * values["gear_stiffness"], MIN_STIFFNESS * values["kp"])
    return np.sqrt(MAX_STIFFNESS * values["armature"] / needed)


def _require_resolved(motors: GreyBoxActuator, dt: float) -> None:
    """Raise ConfigError if a physics step [s] is too long for one of the gears."""
    limits = max_steps(motors)
    worst = int(limits.argmin())
    limit = float(limits[worst])
    if dt <= limit:
        return
    values = motors.constants()
    raise ConfigError(
        f"physics step {dt:g} s: the gear of {values['gear_stiffness'][worst]:.3g} N·m/rad on an "
        f"armature of {values['armature'][worst]:.2g} kg·m² needs at most {limit:.2g} s",
        remedy=f"use a step of {limit:.2g} s or less, with a larger decimation",
        argument="dt",
    )
