"""Motors of a prior or posterior as a drive of Newton 1.6 (extra ``newton``), the physics of Isaac Lab 3.

    motors = mp.from_pretrained(NAME).sample(12, seed=0)
    actuator = newton.actuators.Actuator(indices, drive=MotorPriorDrive(motors, dt=0.002))

A drive cannot pass a damping to the solver, so the joint gets torque - damping·velocity as an effort, which is stable
for 2·k·h²/I + D·h/I < 4 with gear stiffness k, gear damping D, link inertia I and step h. Give the joints no armature,
damping and friction of their own. Rotor and delay line are arrays of the drive; Newton's states hold the motors that a
reset restarts, at the angles of their next step.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportInvalidTypeForm=false
# Newton and Warp are optional dependencies; no `annotations` from the future, as Warp reads these.
# ruff: noqa: D102 (most methods are those of DriveBase)
from dataclasses import dataclass
from typing import Any

import numpy as np

try:
    import warp as wp
    from newton.actuators import DriveBase
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f"{error}: pip install 'motorprior[newton]'", name=error.name) from error

from motorprior.actuator.grey_box import DAMPING, GreyBoxActuator
from motorprior.exports.warp_motors import Row, Rows, WarpMotors

Indices = wp.array(dtype=wp.uint32)


@wp.kernel
def _gather(
    angles: Row, velocities: Row, targets: Row, at_angle: Indices, at_velocity: Indices, at_target: Indices, pos: Row,
    vel: Row, target: Row,
):  # fmt: skip
    i = wp.tid()
    pos[i] = angles[at_angle[i]]
    vel[i] = velocities[at_velocity[i]]
    target[i] = targets[at_target[i]]


@wp.kernel
def _effort(torque: Row, damping: Row, vel: Row, memory: Rows, forces: Row):
    i = wp.tid()
    forces[i] = torque[i] - damping[i] * vel[i]
    memory[wp.static(DAMPING), i] = 0.0  # the engine does not damp, so the rotor gets no momentum from it


@wp.kernel
def _mark(mask: wp.array(dtype=wp.bool), waiting: wp.array(dtype=wp.bool)):
    i = wp.tid()
    if mask[i]:
        waiting[i] = True


class MotorPriorDrive(DriveBase):
    """Motors in the order of the actuator's degrees of freedom.

    Args:
        motors: n motors.
        dt: physics step [s].
        device: of Warp.

    Raises:
        ConfigError: the motors cannot be simulated at this step.
    """

    @dataclass
    class State(DriveBase.State):
        """Motors that restart at their next step."""

        waiting: wp.array | None = None  # (n,) bool

        def reset(self, mask: wp.array | None = None) -> None:
            """Restart the motors of the mask (n,), or all."""
            assert self.waiting is not None
            if mask is None:
                self.waiting.fill_(True)
            else:
                wp.launch(_mark, dim=len(mask), inputs=[mask, self.waiting], device=mask.device)

    def __init__(self, motors: GreyBoxActuator, dt: float, device: str = "cpu"):
        n = motors.num_motors
        self._motors, self._device = WarpMotors(motors, n, dt, device), device
        self._chosen = wp.array(np.arange(n, dtype=np.int32), dtype=int, device=device)
        self._pos, self._vel, self._target = (wp.zeros(n, dtype=float, device=device) for _ in range(3))

    @classmethod
    def resolve_arguments(cls, args: dict[str, Any]) -> dict[str, Any]:
        return args

    def is_stateful(self) -> bool:
        return True

    def is_graphable(self) -> bool:
        return True  # nothing is read back to the host

    def state(self, num_actuators: int, device: Any) -> "MotorPriorDrive.State":
        return MotorPriorDrive.State(wp.full(num_actuators, True, dtype=wp.bool, device=device))

    def update_state(self, current_state: Any, next_state: Any) -> None:
        current_state.waiting.fill_(False)
        next_state.waiting.fill_(False)

    def compute(
        self, positions, velocities, target_pos, target_vel, feedforward, pos_indices, vel_indices,
        target_pos_indices, target_vel_indices, forces, state, dt, device=None, **newer,
    ) -> None:  # fmt: skip
        """Write the effort [N·m] of the coming step; velocity targets and feed-forward have no effect.

        ``newer`` are arguments of later versions, such as ``custom_inputs``.
        """
        n, own = self._motors.count, [self._pos, self._vel, self._target]
        given = [positions, velocities, target_pos, pos_indices, vel_indices, target_pos_indices]
        wp.launch(_gather, dim=n, inputs=[*given, *own], device=self._device)
        self._motors.reset(state.waiting, self._chosen, self._pos, self._pos)
        self._motors.step(self._target, self._pos, self._vel)
        arrays = [self._motors.torque, self._motors.damping, self._vel, self._motors.memory, forces]
        wp.launch(_effort, dim=n, inputs=arrays, device=self._device)
