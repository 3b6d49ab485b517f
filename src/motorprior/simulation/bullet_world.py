"""One robot in PyBullet, the paper's engine: the same links, motors and clocks as in `world`, another solver.

Bullet has no reflected inertia and integrates joint damping explicitly, which is unstable on a
light leg. So each rotor is a link of its own that a gear constraint couples to the joint (the
robot's URDF). With the rotor inertia armature + physics_dt·damping and the torque of step k reduced
by damping·joint_vel(k), the step gives

    (M + armature + physics_dt·damping)·Δjoint_vel = physics_dt·(torque - damping·joint_vel(k) + …),

which is MuJoCo's Euler step with implicit damping.
"""

# pyright: reportMissingModuleSource=false, reportMissingImports=false
# PyBullet is an extra.
from collections import deque
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, require_motors, with_factors
from motorprior.actuator.kernels import (
    make_explicit,
    measure_joint_pos,
    reset_actuator,
    step_actuator,
)
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.control_step import RobotState
from motorprior.robots.model_source import ROTOR_GEAR_RATIO
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import EpisodeConditions, nominal_conditions
from motorprior.simulation.world import control_steps_late, has_diverged, substeps_of

PHYSICS_DT = 0.001  # [s] as in puppersim
# 200 move a joint by less than 1 mrad in 2 s of trot (benchmarks/engines.py)
SOLVER_ITERATIONS = 20
# Maximum gear_stiffness·physics_dt² of a grey box [kg·m²]: 300 N·m/rad at 1 ms. Gear damping is
# explicit here, so stiffer gears are unstable: 400 N·m/rad chatters on a bare shank (3.4e-4 kg·m²).
EXPLICIT_STIFFNESS = 3e-4


class BulletWorld:
    """A simulated robot in its own PyBullet client, which `close` ends; ``suspended`` fixes the base in the air.

    ConfigError if PyBullet is not installed, or the robot has no URDF.
    """

    def __init__(self, robot: Robot, suspended: bool = False):
        self.robot = robot
        self.suspended = suspended
        self.substeps = substeps_of(robot.control_dt, PHYSICS_DT)
        self._bullet = import_bullet()
        self._client = -1
        if robot.model.urdf is None:
            raise ConfigError(
                f"robot {robot.name!r} has no URDF with rotors", remedy="use engine mujoco"
            )
        self._urdf = robot.model.urdf
        self._nominal = self._conditions = nominal_conditions(robot)
        self.torque = np.zeros(robot.num_joints)  # (joints,) of the latest physics step [N·m]

    def reset(
        self,
        actuator: Actuator,
        joint_pos: np.ndarray | None = None,
        conditions: EpisodeConditions | None = None,
    ) -> ActuatorArrays:
        """See `World.reset`."""
        joint_pos = self.robot.nominal_pose if joint_pos is None else joint_pos
        conditions = self._nominal if conditions is None else conditions
        require_motors(actuator, self.robot.num_joints)
        actuator = with_factors(actuator, conditions.factors)
        # only a fresh client gives the same bytes: resetSimulation and restoreState keep some
        # caches
        self.close()
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._conditions = conditions
        self._damping = conditions.strength * np.asarray(actuator.damping, np.float64)
        self._passive = self._damping + conditions.damping
        self._build(
            actuator.armature + conditions.armature + PHYSICS_DT * self._passive, conditions
        )
        self._delays = conditions.delay_steps(PHYSICS_DT)
        self._clock = 0
        oldest = -(-int(self._delays.max()) // self.substeps)
        self._commands = deque([joint_pos] * (oldest + 1), oldest + 1)
        self._prepare_joints(np.asarray(joint_pos, dtype=np.float64))
        self._joints = self.joints()
        self._set_friction_and_masses(conditions)
        self._motors = actuator.arrays(PHYSICS_DT)
        actuator.kind.limit_stiffness(self._motors, EXPLICIT_STIFFNESS / PHYSICS_DT**2)
        reset_actuator(
            self._motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos)
        )
        return self._motors

    def close(self) -> None:
        """Close the client."""
        if self._client >= 0:
            self._bullet.disconnect(self._client)
            self._client = -1

    def step(self, target: np.ndarray) -> RobotState:
        """See `World.step`."""
        self._commands.append(target - self._conditions.encoder_offset)
        pushes = self._conditions.push
        total = 0.0
        push = pushes[self._clock % len(pushes)] if len(pushes) else None
        # a state that broke down is reported as a fault
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(self.substeps):
                late = control_steps_late(self._delays, self._clock, k, self.substeps)
                total += self.physics_step(self._motors, self._commands[-1 - late], push)
        self._clock += 1
        return self.state(total / self.substeps)

    def physics_step(
        self, motors: ActuatorArrays, target: np.ndarray, push: np.ndarray | None = None
    ) -> float:
        """See `world.physics_step`; ``push`` is a (2,) horizontal force on the origin of the chassis [N]."""
        forces = _drive(
            motors, target, *self._joints, self._conditions.strength, self._passive, self.torque
        ).tolist()
        self.call(
            "setJointMotorControlArray",
            self.body,
            self._indices,
            self._bullet.TORQUE_CONTROL,
            forces=forces,
        )
        if push is not None:
            where = self.base()[0].tolist()
            self.call(
                "applyExternalForce", self.body, -1, [*push, 0.0], where, self._bullet.WORLD_FRAME
            )
        self.call("stepSimulation")
        self._joints = self.joints()
        self.torque -= self._damping * self._joints[1]
        return float(self.torque @ self.torque)

    def state(self, torque_squared_sum: float = 0.0) -> RobotState:
        """State of a free robot; the positions of its feet are unknown."""
        pos, quat, lin_vel, ang_vel = self.base()
        joint_pos, joint_vel = self.joints()
        measured = np.zeros_like(joint_pos)
        measure_joint_pos(self._motors, joint_pos, measured)
        qpos = np.concatenate([pos, quat, joint_pos])
        qvel = np.concatenate([lin_vel, ang_vel, joint_vel])
        return RobotState(
            pos,
            quat,
            lin_vel,
            ang_vel,
            measured + self._conditions.encoder_offset,
            np.full((len(self.robot.legs), 3), np.nan),
            torque_squared_sum,
            int(has_diverged(qpos, qvel)),
        )

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """True joint angles (joints,) [rad] and velocities (joints,) [rad/s]."""
        pos, vel, *_ = zip(*self.call("getJointStates", self.body, self._indices), strict=True)
        return np.array(pos), np.array(vel)

    def base(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Chassis frame: position [m], quaternion (w, x, y, z), velocity in world [m/s], rates in body axes [rad/s]."""
        centre, xyzw = self.call("getBasePositionAndOrientation", self.body)
        lin_vel, ang_vel = (np.array(value) for value in self.call("getBaseVelocity", self.body))
        rotation = np.array(self._bullet.getMatrixFromQuaternion(xyzw)).reshape(3, 3)
        arm = -rotation @ self._com  # from the centre of mass, the origin of Bullet's own frame
        velocity = lin_vel + _cross(ang_vel.tolist(), arm.tolist())
        return (
            np.array(centre) + arm,
            np.array([xyzw[3], *xyzw[:3]]),
            velocity,
            rotation.T @ ang_vel,
        )

    def call(self, name: str, *args: Any, **options: Any) -> Any:
        """Call a function of PyBullet on this world's client."""
        return getattr(self._bullet, name)(*args, **options, physicsClientId=self._client)

    def _build(self, rotors: np.ndarray, conditions: EpisodeConditions) -> None:
        self.call("setTimeStep", PHYSICS_DT)
        self.call("setPhysicsEngineParameter", numSolverIterations=SOLVER_ITERATIONS)
        self.call("setGravity", *conditions.gravity.tolist())
        if not self.suspended:
            floor = self.call(
                "createMultiBody", 0.0, self.call("createCollisionShape", self._bullet.GEOM_PLANE)
            )
            self.call("changeDynamics", floor, -1, lateralFriction=1.0, restitution=0.0)
        self.body = self._load_robot(self._urdf(rotors, tuple(conditions.com.tolist())))
        links = range(self.call("getNumJoints", self.body))
        self._names = {
            self.call("getJointInfo", self.body, index)[1].decode(): index for index in links
        }
        self._indices = [self._names[name] for name in self.robot.joint_names]
        self._com = np.array(self.call("getDynamicsInfo", self.body, -1)[3])

    def _load_robot(self, text: str) -> int:
        height = self.robot.suspended_height if self.suspended else self.robot.standing_height
        flags = self._bullet.URDF_USE_INERTIA_FROM_FILE | self._bullet.URDF_MAINTAIN_LINK_ORDER
        with TemporaryDirectory(prefix="motorprior-") as folder:  # PyBullet only reads files
            path = Path(folder) / "robot.urdf"
            path.write_text(text, encoding="utf-8")
            return self.call(
                "loadURDF", str(path), [0, 0, height], flags=flags, useFixedBase=self.suspended
            )

    def _prepare_joints(self, joint_pos: np.ndarray) -> None:
        """Remove Bullet's own motors and damping, couple rotors to their joints."""
        self.call("changeDynamics", self.body, -1, linearDamping=0.0, angularDamping=0.0)
        free = {
            "linearDamping": 0.0,
            "angularDamping": 0.0,
            "jointDamping": 0.0,
            "maxJointVelocity": 1e9,
        }
        for index in self._names.values():
            self.call("changeDynamics", self.body, index, **free)
            self.call(
                "setJointMotorControl2", self.body, index, self._bullet.VELOCITY_CONTROL, force=0.0
            )
        for joint, name, angle in zip(
            self._indices, self.robot.joint_names, joint_pos, strict=True
        ):
            rotor = self._names.get(f"{name}_rotor")
            self.call("resetJointState", self.body, joint, angle)
            if rotor is not None:
                self.call("resetJointState", self.body, rotor, ROTOR_GEAR_RATIO * angle)
                axis = self.call("getJointInfo", self.body, joint)[13]
                ends = [[0, 0, 0], [0, 0, 0]]
                kind = self._bullet.JOINT_GEAR
                gear = self.call(
                    "createConstraint", self.body, joint, self.body, rotor, kind, axis, *ends
                )
                self.call("changeConstraint", gear, gearRatio=-1.0 / ROTOR_GEAR_RATIO, maxForce=1e6)

    def _set_friction_and_masses(self, conditions: EpisodeConditions) -> None:
        friction = self.robot.foot_friction * conditions.friction
        for number, index in enumerate([-1, *self._indices]):
            self.call("changeDynamics", self.body, index, lateralFriction=friction, restitution=0.0)
            factor = float(conditions.mass[number])
            if factor != 1.0:
                info = self.call("getDynamicsInfo", self.body, index)
                inertia = [factor * value for value in info[2]]
                self.call(
                    "changeDynamics",
                    self.body,
                    index,
                    mass=factor * info[0],
                    localInertiaDiagonal=inertia,
                )


@njit(cache=True, nogil=True)
def _drive(motors, target, joint_pos, joint_vel, strength, passive, torque):
    """Write the motors' torque (joints,) [N·m]; returns it less the joints' damping, for Bullet."""
    step_actuator(motors, PHYSICS_DT, target, joint_pos, joint_vel, torque)
    make_explicit(motors, joint_vel, torque)
    torque *= strength
    return torque - passive * joint_vel


def _cross(a: list[float], b: list[float]) -> np.ndarray:
    """A × b; numpy's function takes half the time of a Bullet step."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def import_bullet() -> Any:
    """Import PyBullet; raises ConfigError if it is not installed."""
    try:
        import pybullet
    except ImportError as error:
        remedy = (
            "pip install 'motorprior[pybullet]' on Python 3.11, the last that it has wheels for"
        )
        raise ConfigError("PyBullet is not installed", remedy=remedy) from error
    return pybullet
