"""Motors of a prior or posterior as an actuator of mjlab 1.6 (extra ``mjlab``).

    cfg.scene.entities["robot"].articulation.actuators = (
        MotorPriorActuatorCfg(target_names_expr=(".*_joint",), source=mp.from_pretrained(NAME)),
    )
    cfg.events["motors"] = per_world_damping()

Every reset of an environment gives each of its joints another sample. Torques go to the engine as
controls, the damping of the gears to ``dof_damping`` of each world, which the engine integrates
implicitly. mjlab resets actuators before it moves the joints, so the motors restart at the first
step after a reset, at the angles of that time.

The motors obey mjlab's position, velocity and effort targets of every step; the last are
feed-forward torques. Gains of a step are ``kp_factor`` and ``kd_factor`` of the actuator.
"""

# pyright: reportMissingImports=false
# mjlab, torch and Warp are optional dependencies.
from dataclasses import dataclass
from typing import Any

import mujoco

try:
    import torch
    import warp as wp
    from mjlab.actuator import Actuator, ActuatorCfg, ActuatorCmd
    from mjlab.managers.event_manager import EventTermCfg, requires_model_fields
    from mjlab.utils.spec import create_motor_actuator
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f"{error}: pip install 'mjlab==1.6.*'", name=error.name) from error

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ConfigError
from motorprior.exports.exporter import sampled
from motorprior.exports.warp_motors import WarpMotors

_NO_LIMIT = 1e6  # torque limit of the engine's actuators [N·m]; the motors have theirs
_SWITCHED_OFF = {"armature": 0.0, "frictionloss": 0.0, "viscous_damping": 0.0}


@dataclass(kw_only=True)
class MotorPriorActuatorCfg(ActuatorCfg):
    """Motors with rotor, play, friction, delay and servo of their own.

    The engine's armature, friction, damping and torque limit are switched off.
    """

    source: MotorPrior | MotorPosterior
    """Distribution of the motors; a posterior of all joints has their order, a posterior of one
    motor is for every joint."""
    samples: int = 1024
    """Motors per joint that resets choose from."""
    seed: int = 0
    """Seed of these motors."""
    gains: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    """kp and kd per joint, for priors of logged gains; see `MotorPrior.sample`."""

    def build(
        self, entity: Any, target_ids: list[int], target_names: list[str]
    ) -> "MotorPriorActuator":
        """The actuator of one entity; mjlab calls it."""
        return MotorPriorActuator(self, entity, target_ids, target_names)


class MotorPriorActuator(Actuator):
    """E worlds of J motors, motor e·J + j in Warp.

    ``kp_factor`` and ``kd_factor`` (E, J) are the gains in force over the motors' gains [-], 1 at
    first and sent with the targets of every step. Write to these tensors to change gains; both are
    0 for torque control. Resets leave them as they are.
    """

    def edit_spec(self, spec: mujoco.MjSpec, target_names: list[str]) -> None:
        """Add a torque actuator per joint, without limit."""
        for name in target_names:
            actuator = create_motor_actuator(spec, name, effort_limit=_NO_LIMIT, **_SWITCHED_OFF)
            self._mjs_actuators.append(actuator)

    def initialize(self, mj_model: mujoco.MjModel, model: Any, data: Any, device: str) -> None:
        """Sample the motors.

        Raises ConfigError if their gears cannot be resolved at the model's physics step.
        """
        super().initialize(mj_model, model, data, device)
        cfg = self.cfg
        joint_names = tuple(self.target_names)
        num_joints = len(joint_names)
        shape = (data.nworld, num_joints)
        samples = sampled(cfg.source, cfg.samples, cfg.seed, joint_names, cfg.gains)
        timestep = float(mj_model.opt.timestep)
        self._motors = WarpMotors(samples, data.nworld * num_joints, timestep, device)
        self._model = model
        self._dofs = self.entity.indexing.joint_v_adr[self.target_ids].long()

        # tensors that share the memory of the motors
        self._torque = wp.to_torch(self._motors.torque).view(shape)
        self._damping = wp.to_torch(self._motors.damping).view(shape)
        self._sample_index = wp.to_torch(self._motors.sample_index).view(shape)
        self._waiting = wp.to_torch(self._motors.waiting).view(shape)

        self.kp_factor = torch.ones(shape, device=device)
        self.kd_factor = torch.ones(shape, device=device)

        joints = torch.arange(num_joints, device=device, dtype=torch.int32)
        self._joints = joints.repeat(data.nworld, 1)
        self.reset()

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Choose other motors for some worlds, which start at their next step."""
        super().reset(env_ids)
        worlds = slice(None) if env_ids is None else env_ids
        # sample k of joint j is column k·J + j
        robots = torch.randint_like(self._joints, self.cfg.samples)
        columns = robots * self._joints.shape[1] + self._joints
        self._sample_index[worlds] = columns[worlds]
        self._waiting[worlds] = True

    def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
        """(E, J) torque [N·m] of the coming physics step; writes the damping of every world."""
        self._motors.step(
            _row(cmd.position_target),
            _row(cmd.pos),
            _row(cmd.vel),
            velocity_target=_row(cmd.velocity_target),
            torque_feedforward=_row(cmd.effort_target),
            kp_factor=_row(self.kp_factor),
            kd_factor=_row(self.kd_factor),
        )

        damping = self._model.dof_damping
        if damping.wp_array.shape[0] != len(self._torque):  # the tensor is expanded to all worlds
            remedy = 'add cfg.events["motors"] = per_world_damping()'
            raise ConfigError("all worlds share one dof_damping", remedy=remedy)
        damping[:, self._dofs] = self._damping  # mjlab shows the model's arrays as tensors
        return self._torque


def _row(tensor: torch.Tensor) -> wp.array:
    """A tensor (E, J) as a Warp array (E·J,)."""
    return wp.from_torch(tensor.float().contiguous().view(-1))


@requires_model_fields("dof_damping")
def _expand(env: Any, env_ids: torch.Tensor | None) -> None:
    """Do nothing: the decorator gives every world a damping of its own."""


def per_world_damping() -> EventTermCfg:
    """The start-up event that gives every world a ``dof_damping`` of its own."""
    return EventTermCfg(func=_expand, mode="startup")
