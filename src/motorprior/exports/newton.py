"""Motors of a prior or posterior as a drive of Newton 1.6 (extra ``newton``).

Newton is the physics of Isaac Lab 3.

    motors = mp.from_pretrained(NAME).sample(12, seed=0)
    actuator = newton.actuators.Actuator(indices, drive=MotorPriorDrive(motors, dt=0.002))

A drive cannot pass a damping to the solver, so the joint gets torque - damping·velocity as an
effort, which is stable for 2·k·h²/I + D·h/I < 4 with gear stiffness k, gear damping D, link inertia
I and step h. Give the joints no armature, damping and friction of their own. Rotor and delay line
are arrays of the drive; Newton's states share its mask of the motors that restart, at the angles of
their next step.
"""

# pyright: reportMissingImports=false, reportInvalidTypeForm=false
# Newton and Warp are optional dependencies.
# ruff: noqa: D102 (most methods implement DriveBase)
from dataclasses import dataclass
from typing import Any

try:
    import warp as wp
    from newton.actuators import DriveBase
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"{error}: pip install 'newton>=1.6.1,<1.9'", name=error.name
    ) from error

from motorprior.actuator.grey_box import DAMPING, GreyBoxActuator
from motorprior.exports.warp_motors import Row, Rows, WarpMotors


@wp.kernel
def _effort(torque: Row, damping: Row, vel: Row, memory: Rows, forces: Row):
    i = wp.tid()
    forces[i] = torque[i] - damping[i] * vel[i]
    # the engine does not damp, so the rotor gets no momentum from it
    memory[wp.static(DAMPING), i] = 0.0


@wp.kernel
def _mark(mask: wp.array(dtype=wp.bool), waiting: wp.array(dtype=wp.bool)):
    i = wp.tid()
    if mask[i]:
        waiting[i] = True


class MotorPriorDrive(DriveBase):
    """Motors in the order of the actuator's degrees of freedom.

    They obey the position and velocity targets and the feed-forward torques of Newton's control.
    ``kp_factor`` and ``kd_factor`` are Warp arrays (n,) of the gains in force over the motors'
    gains [-], 1 at first and sent with the targets of every step. Write to them to change gains;
    both are 0 for torque control.

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
        count = motors.num_motors
        self._motors = WarpMotors(motors, count, dt, device)
        self._device = device
        self._pos = wp.zeros(count, dtype=float, device=device)
        self._vel = wp.zeros(count, dtype=float, device=device)
        self._target = wp.zeros(count, dtype=float, device=device)
        self._velocity_target = wp.zeros(count, dtype=float, device=device)
        self._feedforward = wp.zeros(count, dtype=float, device=device)
        self.kp_factor = wp.ones(count, dtype=float, device=device)
        self.kd_factor = wp.ones(count, dtype=float, device=device)

    @classmethod
    def resolve_arguments(cls, args: dict[str, Any]) -> dict[str, Any]:
        return args

    def is_stateful(self) -> bool:
        return True

    def is_graphable(self) -> bool:
        return True  # nothing is read back to the host

    def state(self, num_actuators: int, device: Any) -> "MotorPriorDrive.State":
        self._motors.waiting.fill_(True)
        return MotorPriorDrive.State(self._motors.waiting)

    def compute(
        self,
        positions,
        velocities,
        target_pos,
        target_vel,
        feedforward,
        pos_indices,
        vel_indices,
        target_pos_indices,
        target_vel_indices,
        forces,
        state,
        dt,
        device=None,
        **arguments_of_later_versions,  # such as custom_inputs
    ) -> None:
        """Write the effort [N·m] of the coming step.

        The arrays ``target_vel`` and ``feedforward`` may be None.
        """
        wp.copy(self._pos, positions[pos_indices.view(wp.int32)])
        wp.copy(self._vel, velocities[vel_indices.view(wp.int32)])
        wp.copy(self._target, target_pos[target_pos_indices.view(wp.int32)])
        velocity_indices = target_vel_indices.view(wp.int32)
        if target_vel is not None:
            wp.copy(self._velocity_target, target_vel[velocity_indices])
        if feedforward is not None:
            wp.copy(self._feedforward, feedforward[velocity_indices])
        self._motors.step(
            self._target,
            self._pos,
            self._vel,
            velocity_target=self._velocity_target,
            torque_feedforward=self._feedforward,
            kp_factor=self.kp_factor,
            kd_factor=self.kd_factor,
        )

        motors = self._motors
        inputs = [motors.torque, motors.damping, self._vel, motors.memory, forces]
        wp.launch(_effort, dim=motors.count, inputs=inputs, device=self._device)
