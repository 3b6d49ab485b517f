"""The Warp kernel, and the actuators of mjlab and Newton, against the compiled motors; skipped without these."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from grey_boxes import make_grey_box

wp = pytest.importorskip("warp", reason="needs the extra newton or mjlab")

import exports as bench  # noqa: E402
from motorprior.actuator import kernels  # noqa: E402
from motorprior.actuator.grey_box import GreyBoxActuator  # noqa: E402
from motorprior.actuator.motor_prior import MotorPrior  # noqa: E402
from motorprior.actuator.optional_terms import TERMS  # noqa: E402
from motorprior.exceptions import ConfigError  # noqa: E402
from motorprior.exports.exporter import sampled  # noqa: E402
from motorprior.exports.warp_motors import WarpMotors  # noqa: E402


def prior_of(terms: tuple[str, ...] = (), **constants: Any) -> MotorPrior:
    model, zeros = make_grey_box(spread=0.09, terms=terms, **constants), np.zeros((2, 3))
    return MotorPrior(model, zeros, zeros, "rollout", "rig", "a motor", {}, {})


def motors_of_prior(count: int, terms: tuple[str, ...] = (), **constants: Any) -> GreyBoxActuator:
    motors = prior_of(terms, **constants).sample(count, seed=1)
    assert isinstance(motors, GreyBoxActuator)
    return motors


def newton(motors: GreyBoxActuator) -> bench.Step:
    """The drive of Newton: its effort is torque - damping·velocity, so the damping returned is 0."""
    from newton.actuators import Actuator

    from motorprior.exports.newton import MotorPriorDrive

    count = motors.num_motors
    actuator = Actuator(bench.warp_array(np.arange(count), wp.uint32), drive=MotorPriorDrive(motors, bench.DT))
    names = ("joint_q", "joint_qd", "joint_f", "joint_target_q", "joint_target_qd")
    world = type("World", (), {name: bench.warp_array(np.zeros(count)) for name in names} | {"joint_act": None})()
    states = [actuator.state(), actuator.state()]

    def step(target: np.ndarray, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for name, values in zip(("joint_target_q", "joint_q", "joint_qd"), (target, q, dq), strict=True):
            getattr(world, name).assign(values.astype(np.float32))
        world.joint_f.zero_()
        actuator.step(world, world, *states, dt=bench.DT)
        states.reverse()
        return world.joint_f.numpy().astype(float), np.zeros(count)

    return step


def explicit(motors: GreyBoxActuator) -> bench.Step:
    """Our own motors for an engine that does not damp, as `kernels.make_explicit`."""
    arrays, zero = motors.arrays(bench.DT), np.zeros(motors.num_motors)
    kernels.reset_actuator(arrays, zero, zero)

    def step(target: np.ndarray, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        torque = np.zeros(motors.num_motors)
        kernels.step_actuator(arrays, bench.DT, target, q, dq, torque)
        kernels.make_explicit(arrays, dq, torque)
        return torque, arrays.damping.copy()

    return step


RIG = f"""<mujoco><option timestep="{bench.DT}"/><worldbody><body name="link">
  <inertial pos="0 0 0" mass="1" diaginertia="{bench.INERTIA} {bench.INERTIA} {bench.INERTIA}"/>
  <joint name="joint" axis="0 1 0" armature="9"/></body></worldbody></mujoco>"""


def mjlab_run(prior: MotorPrior, count: int, steps: int) -> tuple[np.ndarray, Any]:
    """(steps, count) angles in mjlab's worlds of one joint each, and the entity."""
    import torch
    from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
    from mjlab.scene import Scene, SceneCfg
    from mjlab.sim import Simulation, SimulationCfg

    from motorprior.exports.mjlab import MotorPriorActuatorCfg

    actuator = MotorPriorActuatorCfg(target_names_expr=("joint",), source=prior, samples=count)
    articulation = EntityArticulationInfoCfg(actuators=(actuator,))
    entity = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(RIG), articulation=articulation)
    scene = Scene(SceneCfg(num_envs=count, env_spacing=1.0, entities={"rig": entity}), "cpu")
    settings = SimulationCfg()
    settings.mujoco.timestep, settings.mujoco.gravity = bench.DT, (0.0, 0.0, 0.0)
    sim = Simulation(num_envs=count, cfg=settings, model=scene.compile(), device="cpu")
    scene.initialize(sim.mj_model, sim.model, sim.data)
    sim.expand_model_fields(("dof_damping",))  # in an environment the event `per_world_damping` does this
    scene.reset()
    robot, out = scene["rig"], np.zeros((steps, count))
    for step in range(steps):
        robot.set_joint_position_target(torch.tensor(bench.targets(step, count)[:, None], dtype=torch.float))
        scene.write_data_to_sim()
        sim.step()
        scene.update(bench.DT)
        out[step] = robot.data.joint_pos.numpy()[:, 0]
    return out, robot


@pytest.mark.parametrize(
    ("terms", "tolerance"), [((), 2e-3), *(((name,), 2e-2) for name in TERMS), (tuple(TERMS), 3e-2)]
)
def test_the_kernel_follows_the_compiled_motors(terms: tuple[str, ...], tolerance: float):
    motors = motors_of_prior(bench.COUNT, terms)
    # an encoder behind the backlash makes these motors oscillate, and any difference grows exponentially
    steps = 200 if "output_encoder" in terms else bench.STEPS
    ours, theirs = (bench.free_run(make(motors), bench.COUNT, steps) for make in (bench.compiled, bench.kernel))
    assert np.abs(ours).max() > 0.3, "they move"
    difference = np.abs(ours - theirs).max(axis=0)  # [rad]
    assert np.median(difference) < 1e-4
    assert difference.max() < tolerance  # float32: dry friction of some motors breaks away a step earlier or later


def test_a_partial_reset_restarts_the_masked_motors_only():
    motors = WarpMotors(motors_of_prior(4), 2, bench.DT, "cpu")
    zero, every = bench.warp_array(np.zeros(2)), bench.warp_array([True, True], wp.bool)
    motors.reset(every, bench.warp_array([0, 1], int), zero, zero)
    for _ in range(20):
        motors.step(bench.warp_array([0.3, 0.3]), zero, zero)
    before = motors.memory.numpy()
    chosen, start = bench.warp_array([2, 3], int), bench.warp_array([0.0, 0.5])
    motors.reset(bench.warp_array([False, True], wp.bool), chosen, zero, start)
    after = motors.memory.numpy()
    np.testing.assert_array_equal(after[:, 0], before[:, 0])
    assert after[0, 1] == 0.5 and after[1, 1] == 0.0 and motors.clock.numpy()[1] == 0
    other = WarpMotors(motors_of_prior(4), 2, bench.DT, "cpu")
    other.reset(every, bench.warp_array([0, 3], int), zero, zero)
    np.testing.assert_array_equal(motors.table.numpy(), other.table.numpy())


def test_a_step_that_cannot_resolve_the_gear_is_refused():
    with pytest.raises(ConfigError, match="gear") as refused:
        WarpMotors(motors_of_prior(1, gear_stiffness=5000.0, kp=100.0), 1, bench.DT, "cpu")
    assert "use a step of" in str(refused.value.remedy)


def test_a_gear_that_is_softened_for_the_step_moves_as_ours():
    stiff = motors_of_prior(2, gear_stiffness=5000.0)
    ours, theirs = (bench.free_run(make(stiff), 2, 500) for make in (bench.compiled, bench.kernel))
    assert np.abs(ours).max() > 0.3 and np.abs(ours - theirs).max() < 2e-3


def test_newton_moves_the_joints_as_our_motors_do():
    pytest.importorskip("newton", reason="needs the extra newton")
    motors = motors_of_prior(3)
    ours, theirs = (bench.free_run(make(motors), 3, 500) for make in (explicit, newton))
    assert np.abs(ours).max() > 0.3 and np.abs(ours - theirs).max() < 1e-4


def test_newton_restarts_masked_motors():
    pytest.importorskip("newton", reason="needs the extra newton")
    from motorprior.exports.newton import MotorPriorDrive

    state = MotorPriorDrive(motors_of_prior(2), bench.DT).state(2, "cpu")
    state.waiting.fill_(False)
    state.reset(bench.warp_array([False, True], wp.bool))
    assert state.waiting.numpy().tolist() == [False, True]
    state.reset()
    assert state.waiting.numpy().all()


def test_mjlab_has_other_motors_in_every_world_and_damps_each():
    pytest.importorskip("mjlab", reason="needs the extra mjlab")
    import torch

    from motorprior.exports.mjlab import per_world_damping

    assert per_world_damping().func.model_fields == ("dof_damping",)
    torch.manual_seed(0)
    angles, robot = mjlab_run(prior_of(), 8, 400)
    actuator = robot.actuators[0]
    before = actuator._chosen.clone()
    chosen, bank = before.flatten().numpy(), sampled(prior_of(), 8, 0, ("joint",), None)
    ours = bench.free_run(bench.compiled(replace(bank, z=bank.z[chosen])), 8, 400)
    assert np.abs(angles - ours).max() < 1e-3
    assert np.ptp(angles[-1]) > 1e-3
    assert len(set(chosen.tolist())) > 1
    robot.reset(torch.tensor([1, 5]))
    assert actuator._waiting.flatten().tolist() == [world in (1, 5) for world in range(8)]
    kept = [world for world in range(8) if world not in (1, 5)]
    assert torch.equal(actuator._chosen[kept], before[kept])
