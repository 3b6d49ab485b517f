"""Step compiled motor models from Python, one physics step at a time, in any simulator."""

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import NO_FRAMES
from motorprior.actuator.command_frame import POSITION, Frames, send_frame, with_frames
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.bounds import require_array
from motorprior.exceptions import ConfigError


class Motors:
    """n motors with their state.

    A step returns a torque and a damping that the simulator must integrate implicitly. With inertia
    J, step h and all other torques τ_other on the joint, the new velocity dq' solves

        (J + armature)·(dq' - dq)/h = torque - damping·dq' + τ_other,

    that is dq' = (dq + h·(torque + τ_other)/(J + armature)) / (1 + h·damping/(J + armature)). The
    total motor torque is torque - damping·dq'. Explicit damping would make a stiff gear or a large
    kd chatter on a light link. In MuJoCo, set ``dof_armature`` and ``dof_damping``.

    Args:
        actuator: n motors, for example from `MotorPrior.sample`.
        dt: physics step [s].
        joint_pos: (n,) initial angles at zero velocity [rad].
        position_target: (n,) targets before the first step [rad]; ``joint_pos`` if not given.

    Raises:
        ConfigError: no motors, motors that cannot be simulated at this step, or an array of the
            wrong shape.
    """

    def __init__(
        self,
        actuator: Actuator,
        dt: float,
        joint_pos: np.ndarray,
        position_target: np.ndarray | None = None,
    ):
        if not hasattr(actuator, "arrays"):
            problem = f"a {type(actuator).__name__} is a distribution, not motors"
            raise ConfigError(problem, remedy="give samples of it: .sample(…)", argument="actuator")
        self._shape = (actuator.num_motors,)
        self._dt = dt
        self._kind = actuator.kind
        self._arrays = actuator.arrays(dt)
        self._armature = np.array(actuator.armature)
        self.reset(joint_pos, position_target)

    def __repr__(self) -> str:
        return f"Motors of {self._shape[0]} joints at steps of {self._dt:g} s"

    def reset(self, joint_pos: np.ndarray, position_target: np.ndarray | None = None) -> None:
        """Restart with static rotors at ``joint_pos`` (n,) [rad]; arguments as in the class."""
        start = require_array("joint_pos", joint_pos, self._shape)
        target = start
        if position_target is not None:
            target = require_array("position_target", position_target, self._shape)
        self._arrays = self._arrays._replace(frames=NO_FRAMES)
        reset_actuator(self._arrays, target, start)

    @property
    def armature(self) -> np.ndarray:
        """(n,) inertia that the simulator must add to that of the joints [kg·m²]."""
        return self._armature.copy()

    def step(
        self,
        position_target: np.ndarray,
        joint_pos: np.ndarray,
        joint_vel: np.ndarray,
        *,
        velocity_target: np.ndarray | float = 0.0,
        torque_feedforward: np.ndarray | float = 0.0,
        kp_factor: np.ndarray | float = 1.0,
        kd_factor: np.ndarray | float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque [N·m] and damping [N·m·s/rad], (n,) each, for the coming physics step.

        Args:
            position_target: (n,) [rad].
            joint_pos: (n,) [rad].
            joint_vel: (n,) [rad/s].
            velocity_target: number or (n,) [rad/s].
            torque_feedforward: number or (n,) [N·m].
            kp_factor: kp in force over the motors' kp [-], number or (n,); 0 for velocity control.
            kd_factor: kd in force over the motors' kd [-]; both factors are 0 for torque control.

        Raises:
            ConfigError: another shape or non-finite values, or a model that takes position commands
                only.
        """
        target = require_array("position_target", position_target, self._shape)
        pos = require_array("joint_pos", joint_pos, self._shape)
        vel = require_array("joint_vel", joint_vel, self._shape)
        self._send(Frames(velocity_target, torque_feedforward, kp_factor, kd_factor))
        torque = np.zeros(self._shape)
        step_actuator(self._arrays, self._dt, target, pos, vel, torque)
        return torque, self._arrays.damping.copy()

    def _send(self, frame: Frames) -> None:
        """Send the rest of a command; the first one that is not of position control adds frames."""
        is_position = all(
            np.all(value == neutral) for value, neutral in zip(frame, POSITION, strict=True)
        )
        if not self._arrays.frames.size:
            if is_position:
                return
            self._arrays = with_frames(self._kind, self._arrays)
        send_frame(self._arrays.frames, frame, *self._shape)

    def encoder_pos(self, joint_pos: np.ndarray) -> np.ndarray:
        """(n,) encoder angles [rad], measured on the rotor if the encoder is there."""
        pos = require_array("joint_pos", joint_pos, self._shape)
        reading = np.zeros(self._shape)
        measure_joint_pos(self._arrays, pos, reading)
        return reading
