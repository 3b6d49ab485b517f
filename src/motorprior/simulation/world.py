"""One robot in MuJoCo.

A `World` is the robot in the engine. `World.reset` puts motors on it and returns a
`MujocoSimulation`, the robot's motion until the next reset.
"""

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator, require_motors, with_factors
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import reset_actuator
from motorprior.exceptions import ConfigError
from motorprior.locomotion.control_step import RobotState
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.simulation.mujoco_library import prepare_mujoco
from motorprior.simulation.physics import WorldArrays, hold_target, read_state
from motorprior.simulation.randomization import MAX_DELAY, Domain, nominal_domain

# fields of the model that a domain changes
_RANDOMIZED = ("body_mass", "body_inertia", "body_ipos", "pair_friction")


def substeps_of(control_dt: float, physics_dt: float) -> int:
    """Physics steps per control step; ConfigError if physics_dt does not divide control_dt [s]."""
    count = round(control_dt / physics_dt)
    if count < 1 or abs(count * physics_dt - control_dt) > 1e-9:
        raise ConfigError(f"physics_dt {physics_dt} s does not divide control_dt {control_dt} s")
    return count


class World:
    """A robot in MuJoCo. Use one per thread.

    Attributes:
        robot: the robot.
        is_fixed: whether the base is fixed.
        physics_dt: physics step [s].
        control_dt: time for which a position target is held [s].
        substeps: physics steps per control step.
        model: MuJoCo's model.
        data: MuJoCo's state, the same memory in all simulations of this world.

    Args:
        robot: a robot with a model.
        physics_dt: physics step, which must divide ``control_dt`` [s]; the robot's own by default.
        suspended: fix a free base in the air.
        control_dt: time for which a position target is held [s]; the robot's own by default.

    Raises:
        ConfigError: physics_dt does not divide control_dt.
    """

    def __init__(
        self,
        robot: Robot,
        physics_dt: float | None = None,
        suspended: bool = False,
        control_dt: float | None = None,
    ):
        self.robot = robot
        self.is_fixed = suspended or robot.base == "fixed"
        self.physics_dt = physics_dt or robot.physics_dt
        self.control_dt = control_dt or robot.control_dt
        self.substeps = substeps_of(self.control_dt, self.physics_dt)

        self._mj_step_address = prepare_mujoco()
        self.model = build_model(robot, self.physics_dt, suspended)
        # a diverged state must stay visible until `find_fault` has read it
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)

        # In qpos and qvel, a free base comes before the joints: position and quaternion in qpos,
        # linear and angular velocity in qvel.
        self._first_joint = 0 if self.is_fixed else 7
        self._first_dof = 0 if self.is_fixed else 6
        self._feet = np.array([self.model.geom(leg.foot).id for leg in robot.legs], np.int64)

        self._nominal_domain = nominal_domain(robot)
        self._nominal = {name: getattr(self.model, name).copy() for name in _RANDOMIZED}
        self._domain_in_model = self._nominal_domain

    def reset(
        self,
        actuator: Actuator,
        joint_pos: np.ndarray | None = None,
        domain: Domain | None = None,
    ) -> "MujocoSimulation":
        """Begin a simulation on these motors, at rest at ``joint_pos`` (joints,) [rad].

        Pose and domain are the robot's nominal ones if not given. An earlier simulation of this
        world must not be used any more: it shares the engine's memory.
        """
        joint_pos = self.robot.nominal_pose if joint_pos is None else joint_pos
        domain = self._nominal_domain if domain is None else domain
        require_motors(actuator, self.robot.num_joints)
        actuator = with_factors(actuator, domain.factors)

        self._write_to_model(domain)
        mujoco.mj_resetData(self.model, self.data)
        self.model.dof_armature[self._first_dof :] = actuator.armature + domain.armature
        damping = self.model.dof_damping[self._first_dof :]  # a view of the model
        damping[:] = domain.strength * actuator.damping + domain.damping
        arrays = self._arrays(domain, damping, joint_pos)
        self.data.qpos[self._first_joint :] = joint_pos

        motors = actuator.arrays(self.physics_dt)
        static_pos = np.ascontiguousarray(joint_pos)
        reset_actuator(motors, static_pos, static_pos)
        return MujocoSimulation(self, arrays, motors)

    def _arrays(self, domain: Domain, damping: np.ndarray, joint_pos: np.ndarray) -> WorldArrays:
        """Views of the engine's memory; ``damping`` is the view of the joints' damping."""
        max_age = 2.0 * MAX_DELAY  # delay and jitter
        rows = int(np.ceil(max_age / self.control_dt)) + 1

        return WorldArrays(
            step=self._mj_step_address,
            model=self.model._address,
            data=self.data._address,
            qpos=self.data.qpos,
            qvel=self.data.qvel,
            applied=self.data.qfrc_applied,
            damping=damping,
            passive_damping=domain.damping,
            strength=domain.strength,
            torque=np.zeros(self.robot.num_joints),
            encoder_offset=domain.encoder_offset,
            commands=np.tile(joint_pos, (rows, 1)),
            clock=np.zeros(1, np.int64),
            delays=domain.delay_steps(self.physics_dt),
            geoms=self.data.geom_xpos,
            feet=self._feet,
            warnings=self.data.warning.number,
            push=domain.push,
            physics_dt=self.physics_dt,
            substeps=self.substeps,
        )

    def _write_to_model(self, domain: Domain) -> None:
        """Write masses, friction and gravity of the domain into the compiled model."""
        names = ("mass", "com", "gravity", "friction")
        present = self._domain_in_model
        if all(np.array_equal(getattr(domain, name), getattr(present, name)) for name in names):
            return
        self._domain_in_model = domain

        model = self.model
        for name, value in self._nominal.items():
            getattr(model, name)[:] = value
        links = slice(1, None)  # body 0 is the world
        model.body_mass[links] *= domain.mass
        model.body_inertia[links] *= domain.mass[:, None]
        model.body_ipos[1] += domain.com
        model.pair_friction[:, :2] *= domain.friction
        model.opt.gravity[:] = domain.gravity

        # Update the constants that MuJoCo derives from masses. The armature is zero, as when the
        # model was compiled: the constants must not depend on earlier motors.
        model.dof_armature[:] = 0.0
        mujoco.mj_setConst(model, self.data)

    def close(self) -> None:
        """Nothing to close."""


class MujocoSimulation:
    """A robot on motors, from a reset of its world to the next one.

    Attributes:
        world: the robot in MuJoCo.
        arrays: views of the engine's memory, for compiled code.
        motors: arrays of the motors, for compiled code.
    """

    def __init__(self, world: World, arrays: WorldArrays, motors: ActuatorArrays):
        self.world = world  # the views in ``arrays`` are valid as long as this object exists
        self.arrays = arrays
        self.motors = motors

    def step(self, target: np.ndarray) -> RobotState:
        """Hold (joints,) finite float64 targets [rad] for one control step; returns the `state`."""
        torque_squared_sum = hold_target(self.arrays, self.motors, target)
        return self.state(torque_squared_sum)

    def state(self, torque_squared_sum: float = 0.0) -> RobotState:
        """Copy of the state of a robot with a free base; see `physics.read_state`."""
        robot = self.world.robot
        measured = np.zeros(robot.num_joints)
        feet = np.zeros((len(robot.legs), 3))
        views = read_state(self.arrays, self.motors, torque_squared_sum, measured, feet)
        return views._replace(
            base_pos=views.base_pos.copy(),
            base_quat=views.base_quat.copy(),
            base_lin_vel=views.base_lin_vel.copy(),
            base_ang_vel=views.base_ang_vel.copy(),
        )
