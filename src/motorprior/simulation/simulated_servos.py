"""Motors and loads of a virtual servo bus: a robot in MuJoCo, or a motor that swings a pendulum.

The firmware on the bus changes gains, limits and profiles of the motors while they move.
"""

import math
from typing import NamedTuple

import numpy as np

from motorprior.actuator import out_of_family as rows
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.fleet import Fleet
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.actuator.physical import PhysicalActuator
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.robots.servos import ServoCommand, ServoState
from motorprior.simulation.physics import WorldArrays, physics_step
from motorprior.simulation.world import World

STEP = 0.00025  # physics step [s]
# separates the motors of virtual servos from those of benches, training and transfer studies
_STREAM = 0x5E70
# an obstacle: friction [N·m], and its stiffness over that of friction before sliding [-]
_BLOCKING_FRICTION = 1e3
_BLOCKING_STIFFNESS = 100.0
_SINKING = 3.0  # [s]


class Pendulum(NamedTuple):
    """A bar of uniform mass on the motor's shaft with a mass at its end; angle 0 hangs down."""

    length: float  # from the shaft to the mass [m]
    mass: float  # [kg]
    bar_mass: float = 0.0  # [kg]

    @property
    def inertia(self) -> float:
        """About the shaft [kg·m²]."""
        return (self.mass + self.bar_mass / 3.0) * self.length**2

    @property
    def gravity_torque(self) -> float:
        """Torque of gravity when horizontal [N·m]."""
        return (self.mass + 0.5 * self.bar_mass) * GRAVITY * self.length


def draw_servos(fleet: Fleet, count: int, seed: int) -> OutOfFamilyMotors:
    """The motors of virtual servos number ``seed``.

    ConfigError if the motors of the fleet have no firmware.
    """
    motors = fleet.sample(count, np.random.default_rng([_STREAM, seed]), of_one_robot=True)
    if isinstance(motors, OutOfFamilyMotors):
        return motors
    raise ConfigError(
        f"motors of fleet {fleet.name!r} have no firmware",
        remedy='give a fleet with family = "out_of_family"',
        argument="fleet",
    )


def resting_pose(robot: Robot, motors: OutOfFamilyMotors) -> np.ndarray:
    """(n,) angles at which the robot stays without torque [rad]: it sinks from its resting pose."""
    start = robot.nominal_pose
    if robot.servos is not None and robot.servos.rest:
        start = np.array(robot.servos.rest)
    servos = SimulatedServos(motors, start, robot)
    servos.advance(round(_SINKING / STEP))
    return servos.state().pos


class SimulatedServos:
    """`ServoMechanics` of a virtual bus, at rest and without torque at first.

    Args:
        motors: motors whose gains and limits are those of a `ServoCommand` of ones.
        robot: the robot that they move; None for a pendulum on the only motor.
        pendulum: the load of a motor without robot.
        start: (n,) joint angles at the start [rad].
    """

    step = STEP

    def __init__(
        self,
        motors: OutOfFamilyMotors,
        start: np.ndarray,
        robot: Robot | None = None,
        pendulum: Pendulum | None = None,
    ):
        self._constants = motors
        self._pendulum = pendulum
        self._world: World | None = None
        self._world_arrays: WorldArrays | None = None
        if robot is not None:
            self._world = World(robot, STEP)
            simulation = self._world.reset(PhysicalActuator(motors), start)
            self._world_arrays = simulation.arrays
            self._arrays = simulation.motors
            self._pos = simulation.arrays.qpos
            self._vel = simulation.arrays.qvel
        else:
            self._pos = np.array(start, dtype=np.float64)
            self._vel = np.zeros(len(start))
            self._arrays = PhysicalActuator(motors).arrays(STEP)
            reset_actuator(self._arrays, self._pos, self._pos)

        self._table = self._arrays.parameters.copy()
        self._enabled = np.zeros(len(start), bool)
        self._target = self._pos.copy()
        ones = np.ones(len(start))
        off = ServoCommand(
            target=self._pos.copy(),
            enabled=self._enabled,
            gain=ones,
            torque_share=ones,
            speed=0.0 * ones,
            acceleration=0.0 * ones,
            supply=ones,
            blocked=self._enabled,
        )
        self.set_command(off)
        self.advance(0)  # compiles before a clock runs

    def set_command(self, command: ServoCommand) -> None:
        """Change what the firmware sets."""
        table = self._table.copy()
        torque = command.enabled * command.supply
        table[rows.KP] *= torque * command.gain
        table[rows.KD] *= torque
        table[rows.TORQUE_LIMIT] *= torque * command.torque_share
        table[rows.STALL_TORQUE] *= command.supply
        table[rows.NO_LOAD_SPEED] *= command.supply
        table[rows.PROFILE_SPEED] = command.speed
        table[rows.PROFILE_ACCELERATION] = command.acceleration
        table[rows.COULOMB] += _BLOCKING_FRICTION * command.blocked
        table[rows.BRISTLE_STIFFNESS] *= np.where(command.blocked, _BLOCKING_STIFFNESS, 1.0)
        self._arrays.parameters[:] = table

        memory = self._arrays.memory
        switched_on = command.enabled & ~self._enabled
        memory[rows.REFERENCE, switched_on] = self._pos[switched_on]
        memory[rows.REFERENCE_VEL, switched_on] = 0.0
        memory[rows.INTEGRAL, switched_on] = 0.0
        self._enabled = command.enabled.copy()
        self._target = np.where(command.enabled, command.target, self._pos)

    def advance(self, steps: int) -> None:
        """Simulate physics steps under the present command."""
        if self._world_arrays is not None:
            _advance_robot(self._world_arrays, self._arrays, self._target, steps)
            return
        pendulum = self._pendulum or Pendulum(0.0, 0.0)
        inertia = max(pendulum.inertia, 1e-6)
        gravity_torque = pendulum.gravity_torque
        _advance_pendulum(
            self._arrays, self._target, self._pos, self._vel, inertia, gravity_torque, steps
        )

    def state(self) -> ServoState:
        """The present state of the joints."""
        # the control law's torque over the full torque limit
        duty = self._arrays.memory[rows.COMMAND] / self._table[rows.TORQUE_LIMIT]
        return ServoState(self._pos.copy(), self._vel.copy(), duty)


@njit(cache=True, nogil=True)
def _advance_robot(
    world: WorldArrays, motors: ActuatorArrays, target: np.ndarray, steps: int
) -> None:
    for _ in range(steps):
        physics_step(world, motors, target)


@njit(cache=True, nogil=True)
def _advance_pendulum(
    motors: ActuatorArrays,
    target: np.ndarray,
    pos: np.ndarray,
    vel: np.ndarray,
    inertia: float,
    gravity_torque: float,
    steps: int,
) -> None:
    """Semi-implicit Euler steps with implicit damping."""
    torque = np.zeros(pos.shape[0])
    for _ in range(steps):
        step_actuator(motors, STEP, target, pos, vel, torque)
        for motor in range(pos.shape[0]):
            force = torque[motor] - gravity_torque * math.sin(pos[motor])
            change = STEP / (inertia + STEP * motors.damping[motor])
            vel[motor] += change * (force - motors.damping[motor] * vel[motor])
            pos[motor] += STEP * vel[motor]
