"""One robot in PyBullet, the paper's engine.

It has the links, motors and clocks of `world`, and another solver.

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

from motorprior.actuator.actuator import Actuator, require_motors, with_factors
from motorprior.actuator.kernels import (
    make_explicit,
    measure_joint_pos,
    reset_actuator,
    step_actuator,
)
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.control_step import RobotState
from motorprior.robots.robot import Robot
from motorprior.robots.urdf_rotor import ROTOR_GEAR_RATIO
from motorprior.simulation.physics import control_steps_late, has_diverged
from motorprior.simulation.randomization import Domain, nominal_domain
from motorprior.simulation.world import substeps_of

PHYSICS_DT = 0.001  # [s] as in puppersim
# 200 move a joint by less than 1 mrad in 2 s of trot (benchmarks/engines.py)
SOLVER_ITERATIONS = 20
# Maximum gear_stiffness·physics_dt² of a grey box over the smallest load inertia of the robot [-].
# Gear damping is explicit here, so stiffer gears are unstable: on a shank of 3.4 times the smallest
# load inertia of 1e-4 kg·m², 300 N·m/rad are stable and 400 chatter.
EXPLICIT_STIFFNESS = 3.0

_BASE = -1  # Bullet's index of the base link


class BulletWorld:
    """A robot in PyBullet; `close` ends its client.

    Attributes:
        robot: the robot.
        suspended: whether a free base is fixed in the air.
        substeps: physics steps per control step.

    Raises:
        ConfigError: PyBullet is not installed, or the robot has no legs.
    """

    def __init__(self, robot: Robot, suspended: bool = False):
        self.robot = robot
        self.suspended = suspended
        self.substeps = substeps_of(robot.control_dt, PHYSICS_DT)
        self._bullet = import_bullet()
        self._client: BulletClient | None = None
        if robot.model.urdf is None:
            problem = f"robot {robot.name!r} has no legs"
            raise ConfigError(problem, remedy="use engine mujoco")
        self._urdf = robot.model.urdf
        self._nominal_domain = nominal_domain(robot)

    def reset(
        self,
        actuator: Actuator,
        joint_pos: np.ndarray | None = None,
        domain: Domain | None = None,
    ) -> "BulletSimulation":
        """Begin a simulation; see `World.reset`."""
        joint_pos = self.robot.nominal_pose if joint_pos is None else joint_pos
        domain = self._nominal_domain if domain is None else domain
        require_motors(actuator, self.robot.num_joints)
        actuator = with_factors(actuator, domain.factors)

        # Only a fresh client gives the same bytes: resetSimulation and restoreState keep some
        # caches.
        self.close()
        self._client = BulletClient(self._bullet)
        passive_damping = _passive_damping(actuator, domain)
        rotors = actuator.armature + domain.armature + PHYSICS_DT * passive_damping
        urdf = self._urdf(rotors, tuple(domain.com.tolist()))
        links = _build(self._client, self.robot, self.suspended, urdf, domain)
        _prepare_joints(self._client, links, self.robot, np.asarray(joint_pos, dtype=np.float64))
        _set_friction_and_masses(self._client, links, self.robot, domain)
        return BulletSimulation(self._client, links, self.robot, actuator, domain, joint_pos)

    def close(self) -> None:
        """End the client."""
        if self._client is not None:
            self._client.close()
            self._client = None


class BulletClient:
    """A physics client of PyBullet.

    Attributes:
        constants: the module ``pybullet``, for its constants.
    """

    def __init__(self, bullet: Any):
        self.constants = bullet
        self._number = bullet.connect(bullet.DIRECT)

    def call(self, name: str, *args: Any, **options: Any) -> Any:
        """Call a function of PyBullet on this client."""
        return getattr(self.constants, name)(*args, **options, physicsClientId=self._number)

    def close(self) -> None:
        """Disconnect the client."""
        self.constants.disconnect(self._number)


class _Links:
    """Bullet's indices of a robot and its links.

    Attributes:
        robot_id: the robot.
        by_name: link index by the name of its joint.
        joints: (joints,) indices, in the order of the robot.
        base_frame: position [m] and quaternion (x, y, z, w) of the base's origin in the frame of
            its centre of mass and principal axes, which is Bullet's own.
    """

    def __init__(self, client: BulletClient, robot_id: int, robot: Robot):
        self.robot_id = robot_id
        self.by_name: dict[str, int] = {}
        for index in range(client.call("getNumJoints", robot_id)):
            name = client.call("getJointInfo", robot_id, index)[1].decode()
            self.by_name[name] = index
        self.joints = [self.by_name[name] for name in robot.joint_names]
        principal_frame = client.call("getDynamicsInfo", robot_id, _BASE)[3:5]
        self.base_frame = client.constants.invertTransform(*principal_frame)


class BulletSimulation:
    """A robot on motors, from a reset of its world to the next one.

    Attributes:
        client: PyBullet's client.
        robot_id: Bullet's number of the robot.
        torque: (joints,) torque of the motors in the last physics step [N·m].
    """

    def __init__(
        self,
        client: BulletClient,
        links: _Links,
        robot: Robot,
        actuator: Actuator,
        domain: Domain,
        joint_pos: np.ndarray,
    ):
        self.client = client
        self.robot_id = links.robot_id
        self.torque = np.zeros(robot.num_joints)
        self._links = links
        self._domain = domain
        self._substeps = substeps_of(robot.control_dt, PHYSICS_DT)
        self._unknown_feet = np.full((len(robot.legs), 3), np.nan)

        self._damping = domain.strength * np.asarray(actuator.damping, np.float64)
        self._passive_damping = _passive_damping(actuator, domain)

        self._clock = 0  # control steps since the reset
        self._delays = domain.delay_steps(PHYSICS_DT)
        max_age = -(-int(self._delays.max()) // self._substeps)
        self._commands = deque([joint_pos] * (max_age + 1), max_age + 1)

        self._joints = self.joints()
        self._motors = actuator.arrays(PHYSICS_DT)
        max_stiffness = EXPLICIT_STIFFNESS * robot.load_inertia[0] / PHYSICS_DT**2
        actuator.kind.limit_stiffness(self._motors, max_stiffness)
        static_pos = np.ascontiguousarray(joint_pos)
        reset_actuator(self._motors, static_pos, static_pos)

    def step(self, target: np.ndarray) -> RobotState:
        """Hold targets for one control step; see `MujocoSimulation.step`."""
        self._commands.append(target - self._domain.encoder_offset)
        pushes = self._domain.push
        push = pushes[self._clock % len(pushes)] if len(pushes) else None

        total = 0.0
        # a state that diverged is reported as a fault
        with np.errstate(over="ignore", invalid="ignore"):
            for substep in range(self._substeps):
                late = control_steps_late(self._delays, self._clock, substep, self._substeps)
                total += self.physics_step(self._commands[-1 - late], push)

        self._clock += 1
        return self.state(total / self._substeps)

    def physics_step(self, target: np.ndarray, push: np.ndarray | None = None) -> float:
        """One physics step towards (joints,) targets; returns Σ torque² over the joints [(N·m)²].

        ``push`` is a (2,) horizontal force on the origin of the chassis [N].
        """
        bullet = self.client.constants
        joint_pos, joint_vel = self._joints
        strength = self._domain.strength
        forces = _drive(
            self._motors,
            target,
            joint_pos,
            joint_vel,
            strength,
            self._passive_damping,
            self.torque,
        )
        self.client.call(
            "setJointMotorControlArray",
            self.robot_id,
            self._links.joints,
            bullet.TORQUE_CONTROL,
            forces=forces.tolist(),
        )
        if push is not None:
            force = [*push, 0.0]
            origin = self.base()[0].tolist()
            self.client.call(
                "applyExternalForce", self.robot_id, _BASE, force, origin, bullet.WORLD_FRAME
            )

        self.client.call("stepSimulation")

        self._joints = self.joints()
        self.torque -= self._damping * self._joints[1]
        return float(self.torque @ self.torque)

    def state(self, torque_squared_sum: float = 0.0) -> RobotState:
        """State of a robot with a free base; the positions of its feet are unknown."""
        pos, quat, lin_vel, ang_vel = self.base()
        joint_pos, joint_vel = self.joints()
        measured = np.zeros_like(joint_pos)
        measure_joint_pos(self._motors, joint_pos, measured)
        qpos = np.concatenate([pos, quat, joint_pos])
        qvel = np.concatenate([lin_vel, ang_vel, joint_vel])
        return RobotState(
            base_pos=pos,
            base_quat=quat,
            base_lin_vel=lin_vel,
            base_ang_vel=ang_vel,
            measured_joint_pos=measured + self._domain.encoder_offset,
            foot_pos=self._unknown_feet.copy(),
            torque_squared_sum=torque_squared_sum,
            fault=int(has_diverged(qpos, qvel)),
        )

    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """True joint angles (joints,) [rad] and velocities (joints,) [rad/s]."""
        states = self.client.call("getJointStates", self.robot_id, self._links.joints)
        pos, vel, *_ = zip(*states, strict=True)
        return np.array(pos), np.array(vel)

    def base(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """State of the chassis frame.

        Position [m], quaternion (w, x, y, z), velocity in the world [m/s] and rates about the body
        axes [rad/s].
        """
        bullet = self.client.constants
        principal_frame = self.client.call("getBasePositionAndOrientation", self.robot_id)
        pos, xyzw = bullet.multiplyTransforms(*principal_frame, *self._links.base_frame)
        centre_vel, world_rates = self.client.call("getBaseVelocity", self.robot_id)
        rates = np.array(world_rates)
        rotation = np.array(bullet.getMatrixFromQuaternion(xyzw)).reshape(3, 3)

        pos = np.array(pos)
        arm = pos - np.array(principal_frame[0])  # from the centre of mass to the origin
        quat = np.array([xyzw[3], *xyzw[:3]])
        # the product of two rotations of the engine is a unit quaternion to 1e-8 only
        quat /= np.linalg.norm(quat)
        velocity = np.array(centre_vel) + _cross(rates.tolist(), arm.tolist())
        return pos, quat, velocity, rotation.T @ rates


def _passive_damping(actuator: Actuator, domain: Domain) -> np.ndarray:
    """(joints,) damping of the joints, by motors and domain [N·m·s/rad]."""
    return domain.strength * np.asarray(actuator.damping, np.float64) + domain.damping


def _build(
    client: BulletClient, robot: Robot, suspended: bool, urdf: str, domain: Domain
) -> _Links:
    """Load floor and robot into an empty client."""
    client.call("setTimeStep", PHYSICS_DT)
    client.call("setPhysicsEngineParameter", numSolverIterations=SOLVER_ITERATIONS)
    client.call("setGravity", *domain.gravity.tolist())

    if not suspended:
        plane = client.call("createCollisionShape", client.constants.GEOM_PLANE)
        floor = client.call("createMultiBody", 0.0, plane)
        client.call("changeDynamics", floor, _BASE, lateralFriction=1.0, restitution=0.0)

    height = robot.suspended_height if suspended else robot.standing_height
    inertia_of_file = client.constants.URDF_USE_INERTIA_FROM_FILE
    order_of_file = client.constants.URDF_MAINTAIN_LINK_ORDER
    with TemporaryDirectory(prefix="motorprior-") as folder:  # PyBullet only reads files
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf, encoding="utf-8")
        robot_id = client.call(
            "loadURDF",
            str(path),
            [0, 0, height],
            flags=inertia_of_file | order_of_file,
            useFixedBase=suspended,
        )
    return _Links(client, robot_id, robot)


def _prepare_joints(
    client: BulletClient, links: _Links, robot: Robot, joint_pos: np.ndarray
) -> None:
    """Remove Bullet's own motors and damping, and couple the rotors to their joints."""
    robot_id = links.robot_id
    bullet = client.constants
    client.call("changeDynamics", robot_id, _BASE, linearDamping=0.0, angularDamping=0.0)
    undamped = {
        "linearDamping": 0.0,
        "angularDamping": 0.0,
        "jointDamping": 0.0,
        "maxJointVelocity": 1e9,
    }
    for link in links.by_name.values():
        client.call("changeDynamics", robot_id, link, **undamped)
        client.call("setJointMotorControl2", robot_id, link, bullet.VELOCITY_CONTROL, force=0.0)

    for joint, name, angle in zip(links.joints, robot.joint_names, joint_pos, strict=True):
        client.call("resetJointState", robot_id, joint, angle)
        rotor = links.by_name.get(f"{name}_rotor")
        if rotor is not None:
            client.call("resetJointState", robot_id, rotor, ROTOR_GEAR_RATIO * angle)
            _couple(client, robot_id, joint, rotor)


def _couple(client: BulletClient, robot_id: int, joint: int, rotor: int) -> None:
    """Couple a rotor to its joint by a gear constraint."""
    axis = client.call("getJointInfo", robot_id, joint)[13]
    origin = [0, 0, 0]
    gear = client.call(
        "createConstraint",
        robot_id,
        joint,
        robot_id,
        rotor,
        client.constants.JOINT_GEAR,
        axis,
        origin,
        origin,
    )
    client.call("changeConstraint", gear, gearRatio=-1.0 / ROTOR_GEAR_RATIO, maxForce=1e6)


def _set_friction_and_masses(
    client: BulletClient, links: _Links, robot: Robot, domain: Domain
) -> None:
    robot_id = links.robot_id
    friction = robot.foot_friction * domain.friction
    for number, link in enumerate([_BASE, *links.joints]):
        client.call("changeDynamics", robot_id, link, lateralFriction=friction, restitution=0.0)
        factor = float(domain.mass[number])
        if factor != 1.0:
            info = client.call("getDynamicsInfo", robot_id, link)
            mass = factor * info[0]
            inertia = [factor * value for value in info[2]]
            client.call("changeDynamics", robot_id, link, mass=mass, localInertiaDiagonal=inertia)


@njit(cache=True, nogil=True)
def _drive(motors, target, joint_pos, joint_vel, strength, passive_damping, torque):
    """Write the motors' torque (joints,) [N·m]; returns it less the joints' damping, for Bullet."""
    step_actuator(motors, PHYSICS_DT, target, joint_pos, joint_vel, torque)
    make_explicit(motors, joint_vel, torque)
    torque *= strength
    return torque - passive_damping * joint_vel


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
        remedy = "pip install pybullet on Python 3.11, the last that it has wheels for"
        raise ConfigError("PyBullet is not installed", remedy=remedy) from error
    return pybullet
