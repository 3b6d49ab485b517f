"""Contract of all actuator models: independence of motors, reset, torque limit, passivity."""

from dataclasses import fields, replace

import imposed_motion
import numpy as np
import pytest
from grey_boxes import make_grey_box
from networks import network

from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.actuator.latent import NetworkActuator
from motorprior.actuator.out_of_family import OutOfFamilyMotors
from motorprior.actuator.physical import PhysicalActuator, PhysicalMotors
from motorprior.bench.dynamometer import Trial, run
from motorprior.exceptions import ConfigError

DT = 0.001
LIMIT = 1.3


def ideal_pd(n):
    rng = np.random.default_rng(1)
    # kp, kd, torque limit, armature, delay
    low = [4, 0.2, LIMIT, 0.0, 0.0]
    high = [9, 0.8, LIMIT, 0.003, 0.012]
    constants = [rng.uniform(a, b, n) for a, b in zip(low, high, strict=True)]

    return IdealPd.without_friction(*constants)


def friction_pd(n):
    rng = np.random.default_rng(6)
    armature = rng.uniform(0.002, 0.004, n)
    coulomb = rng.uniform(0.05, 0.15, n)

    return replace(ideal_pd(n), armature=armature, coulomb=coulomb)


def physical(n):
    motors = require_geared(load_fleet("pupper_v2").sample(n, np.random.default_rng(2)))
    return PhysicalActuator(replace(motors, torque_limit=np.full(n, LIMIT)))


def out_of_family(n):
    """Motors without the terms that depend on the absolute position."""
    motors = load_fleet("foreign_direct").sample(n, np.random.default_rng(2))

    assert isinstance(motors, OutOfFamilyMotors)

    zeros = np.zeros(n)
    absolute = ("encoder_quantum", "encoder_zero", "cogging", "ripple", "position_friction")
    limit = np.full(n, LIMIT)
    without = dict.fromkeys(absolute, zeros)

    return replace(motors, torque_limit=limit, heat_loss=zeros, **without).actuator()


def latent(n):
    model = network(taps=(0, 1, 4), error_scale=0.1, torque_scale=0.6, torque_limit=LIMIT)
    return NetworkActuator(model, np.random.default_rng(3).standard_normal((n, 3)))


def grey_box(n):
    box = make_grey_box(torque_limit=LIMIT)
    equal = [PARAMETERS.index("torque_limit"), PARAMETERS.index("encoder_zero")]
    box.slope[:, equal] = 0.0

    return GreyBoxActuator(box, np.random.default_rng(5).standard_normal((n, 3)))


MAKERS = (ideal_pd, friction_pd, physical, latent, grey_box, out_of_family)


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__)
def make(request):
    return request.param


def only(actuator, motor):
    """One motor of several."""
    if isinstance(actuator, GreyBoxActuator | NetworkActuator):
        return replace(actuator, z=actuator.z[[motor]])

    if isinstance(actuator, PhysicalActuator):
        return actuator.motors.take(np.array([motor])).actuator()

    constants = [getattr(actuator, field.name)[[motor]] for field in fields(actuator)]

    return IdealPd(*constants)


def motion(n, steps=60):
    """(3, steps, n) position_target, joint_pos, joint_vel of a random walk."""
    rng = np.random.default_rng(4)
    velocity = np.cumsum(rng.standard_normal((steps, n)), axis=0)
    joint_pos = rng.uniform(-1, 1, n) + DT * np.cumsum(velocity, axis=0)
    position_target = joint_pos + rng.normal(0.0, 0.2, (steps, n))

    return np.stack([position_target, joint_pos, velocity])


def torques(actuator, inputs, arrays=None):
    return imposed_motion.torques(actuator, inputs, DT, arrays)


@pytest.mark.parametrize("n", [12, 16, 17, 32])
def test_motors_together_equal_motors_one_by_one_bit_for_bit(make, n):
    actuator = make(n)
    inputs = motion(n)
    together = torques(actuator, inputs)
    for motor in range(n):
        alone = torques(only(actuator, motor), inputs[:, :, [motor]].copy())
        np.testing.assert_array_equal(together[:, [motor]], alone)

    assert len(np.unique(together, axis=1).T) == n  # the motors do differ


def test_equal_inputs_give_equal_bytes_and_are_not_changed(make):
    inputs = motion(12)
    original = inputs.copy()

    assert torques(make(12), inputs).tobytes() == torques(make(12), inputs).tobytes()

    arrays = make(12).arrays(DT)
    step = inputs[:, 0].copy()
    reset_actuator(arrays, step[0], step[1])
    step_actuator(arrays, DT, step[0], step[1], step[2], np.zeros(12))
    measure_joint_pos(arrays, step[1], np.zeros(12))

    np.testing.assert_array_equal(step, original[:, 0])


def test_a_reset_actuator_equals_a_new_one(make):
    actuator = make(12)
    inputs = motion(12)
    arrays = actuator.arrays(DT)

    torques(actuator, 3.0 * inputs[:, :37], arrays)  # an odd number of steps: between two renewals
    after_reset = torques(actuator, inputs, arrays)

    np.testing.assert_array_equal(after_reset, torques(actuator, inputs))


def test_torques_depend_on_the_difference_of_target_and_angle_only(make):
    inputs = motion(12)
    shifted = inputs + np.array([0.7, 0.7, 0.0])[:, None, None]

    # float32 history in the latent actuator: 1e-7 relative, amplified by the network
    np.testing.assert_allclose(torques(make(12), shifted), torques(make(12), inputs), atol=2e-5)


def static_band(actuator):
    """Lowest and highest torque [N·m] of a stalled motor at its limit: LIMIT ∓ F.

    The dry friction is F = breakaway + load_friction·torque.
    """
    motors = getattr(actuator, "motors", None)
    if isinstance(motors, PhysicalMotors):
        dry = motors.coulomb + motors.stribeck_torque
        load_friction = motors.load_friction
    elif isinstance(motors, OutOfFamilyMotors):
        dry = (1 + abs(motors.asymmetry)) * (motors.coulomb + motors.static_torque)
        load_friction = motors.load_friction
    elif isinstance(actuator, GreyBoxActuator):
        values = actuator.constants()
        dry = values["coulomb"] + values["stribeck_torque"]
        load_friction = values["load_friction"]
    else:
        return LIMIT, LIMIT

    return (LIMIT - dry) / (1 + load_friction), (LIMIT + dry) / (1 - load_friction)


@pytest.mark.parametrize("size", [1e2, -1e6])
def test_the_torque_of_a_stalled_motor_is_its_limit(make, size):
    # the joint is locked at 0; physical motors first hit the gear, then settle within 0.3 s
    inputs = np.zeros((3, 300, 12))
    inputs[0] = size
    torque = torques(make(12), inputs)[-1] * np.sign(size)
    low, high = static_band(make(12))

    assert np.all(torque <= high * (1 + 1e-9))
    if make is not latent:
        assert np.all(torque >= low * (1 - 1e-9))


@pytest.mark.parametrize(
    ("model", "dt", "remedy"),
    [
        (physical, 0.002, "0.001 s"),
        (latent, 0.0015, "0.002 s"),
        (latent, 0.004, "0.002 s"),
        (grey_box, 0.004, "0.002 s"),
    ],
)
def test_a_time_step_that_is_too_long_is_refused_with_one_that_is_not(model, dt, remedy):
    with pytest.raises(ConfigError, match=f"{dt:g} s") as error:
        model(2).arrays(dt)
    assert error.value.remedy is not None
    assert remedy in error.value.remedy

    model(2).arrays(float(remedy.split()[0]))


@pytest.mark.parametrize("name", ["pupper_v2", "mixed", "foreign_direct", "foreign_servo"])
def test_motors_that_are_switched_off_are_passive(name):
    """The work of the external torque is never less than the kinetic energy of the joint."""
    motors = load_fleet(name).sample(16, 0)
    driven = {"kp", "kd", "ki", "cogging"} & {field.name for field in fields(motors)}
    motors = replace(motors, **dict.fromkeys(driven, np.zeros(16)))

    dt = 1e-4  # [s]
    load = np.geomspace(1e-3, 2e-2, 16)  # [kg·m²]
    rng = np.random.default_rng(1)
    external = np.repeat(rng.uniform(-0.6, 0.6, (20, 16)), 400, axis=0)  # [N·m], new every 40 ms

    answer = run(motors.actuator(), Trial(np.zeros_like(external), external, load, dt))
    work = np.cumsum(external[:-1] * np.diff(answer.joint_pos, axis=0), axis=0)
    kinetic = 0.5 * load * answer.joint_vel[1:] ** 2

    assert np.all(work - kinetic >= -1e-4 * kinetic.max())
    assert kinetic.max() > 0.01
