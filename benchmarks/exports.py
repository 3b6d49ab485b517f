"""What exports of motors lose, and how far the GPU kernel is from the compiled motors.

    python benchmarks/exports.py --out runs/exports

figures.json: FORMAT/leg, FORMAT/shank and FORMAT/leg_steps, the RMSE of exported against our own
joint angles over MOTORS motors [rad] (`exports.registry`), for bam, mjcf, mjcf_detailed and table;
mjlab/parity and newton/parity, the largest difference of joint angles [rad] between the Warp kernel
in float32 and the compiled motors, each in its own closed loop, over 64 motors and 2000 steps of 2
ms. kernel/warp_us and kernel/numba_us are times per step of these 64 motors on this CPU [µs].
Without the extras mjlab and newton the last are left out. The motors have the true constants of the
fleet pupper_v2.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from figures import report
from motorprior.actuator import kernels
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.motors import Motors
from motorprior.actuator.physical import PhysicalMotors
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import load_fleet
from motorprior.exports.bam import motors_of
from motorprior.exports.exporter import sampled
from motorprior.exports.registry import EXPORTERS, MAX_STEP, is_supported, losses

DT = 0.002
STEPS = 2000
COUNT = 64
INERTIA = 0.002
MOTORS = 12
SPREAD = 0.15  # of the logarithms of the constants [-]
MIN_CONSTANT = 1e-6


def true_grey_box(motors: PhysicalMotors) -> GreyBoxActuator:
    """Grey boxes with these constants, one latent per constant."""
    positive = (*(name for name in PARAMETERS if name not in ("kd_over_kp", "encoder_zero")), "kd")
    values = {name: np.maximum(getattr(motors, name), MIN_CONSTANT) for name in positive}
    return motors_of(values | {"encoder_zero": motors.encoder_zero})


def targets(step: int, count: int) -> np.ndarray:
    """(count,) sines of several frequencies with jumps, at which the torque limit is reached [rad]."""
    phase = np.arange(count)
    return 0.4 * np.sin(2 * np.pi * (0.5 + 0.05 * (phase % 20)) * step * DT + phase) + 0.4 * (
        step // 250 % 2
    )


Step = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def free_run(step_motors: Step, count: int, steps: int) -> np.ndarray:
    """(steps, count) joint angles [rad] on a load of INERTIA, with torques and dampings of ``step_motors``."""
    q = np.zeros(count)
    dq = np.zeros(count)
    out = np.zeros((steps, count))
    for step in range(steps):
        torque, damping = step_motors(targets(step, count), q, dq)
        dq = (dq + DT * torque / INERTIA) / (1.0 + DT * damping / INERTIA)
        q = q + DT * dq
        out[step] = q
    return out


def compiled(motors: GreyBoxActuator) -> Step:
    """Our own motors."""
    return Motors(motors, DT, np.zeros(motors.num_motors)).step


def warp_array(values: Any, kind: Any = float) -> Any:
    """A Warp array on the CPU."""
    import warp as wp

    return wp.array(np.asarray(values), dtype=kind, device="cpu")


def kernel(motors: GreyBoxActuator) -> Step:
    """The Warp kernel alone."""
    from motorprior.exports.warp_motors import WarpMotors

    found = WarpMotors(motors, motors.num_motors, DT, "cpu")

    def step(*given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found.step(*(warp_array(each) for each in given))
        return found.torque.numpy().astype(float), found.damping.numpy().astype(float)

    return step


def newton(motors: GreyBoxActuator) -> Step:
    """The drive of Newton: its effort is torque - damping·velocity, so the damping returned is 0."""
    import warp as wp
    from newton.actuators import Actuator

    from motorprior.exports.newton import MotorPriorDrive

    count = motors.num_motors
    actuator = Actuator(warp_array(np.arange(count), wp.uint32), drive=MotorPriorDrive(motors, DT))
    names = ("joint_q", "joint_qd", "joint_f", "joint_target_q", "joint_target_qd")
    world = type(
        "World", (), {name: warp_array(np.zeros(count)) for name in names} | {"joint_act": None}
    )()
    states = [actuator.state(), actuator.state()]

    def step(target: np.ndarray, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for name, values in zip(
            ("joint_target_q", "joint_q", "joint_qd"), (target, q, dq), strict=True
        ):
            getattr(world, name).assign(values.astype(np.float32))
        world.joint_f.zero_()
        actuator.step(world, world, *states, dt=DT)
        states.reverse()
        return world.joint_f.numpy().astype(float), np.zeros(count)

    return step


def explicit(motors: GreyBoxActuator) -> Step:
    """Our own motors for an engine that does not damp, as `kernels.make_explicit`."""
    arrays = motors.arrays(DT)
    zero = np.zeros(motors.num_motors)
    kernels.reset_actuator(arrays, zero, zero)

    def step(target: np.ndarray, q: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        torque = np.zeros(motors.num_motors)
        kernels.step_actuator(arrays, DT, target, q, dq, torque)
        kernels.make_explicit(arrays, dq, torque)
        return torque, arrays.damping.copy()

    return step


RIG = f"""<mujoco><option timestep="{DT}"/><worldbody><body name="link"><inertial pos="0 0 0" mass="1"
  diaginertia="{INERTIA} {INERTIA} {INERTIA}"/><joint name="joint" axis="0 1 0" armature="9"/></body></worldbody>
</mujoco>"""


def mjlab_run(prior: MotorPrior, count: int, steps: int) -> tuple[np.ndarray, np.ndarray, Any]:
    """(steps, count) angles in mjlab's worlds of one joint each, (count,) indices of their motors, and the entity."""
    import mujoco
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
    settings.mujoco.timestep = DT
    settings.mujoco.gravity = (0.0, 0.0, 0.0)
    sim = Simulation(num_envs=count, cfg=settings, model=scene.compile(), device="cpu")
    scene.initialize(sim.mj_model, sim.model, sim.data)
    # in an environment the event `per_world_damping` does this
    sim.expand_model_fields(("dof_damping",))
    scene.reset()
    robot = scene["rig"]
    out = np.zeros((steps, count))
    for step in range(steps):
        robot.set_joint_position_target(
            torch.tensor(targets(step, count)[:, None], dtype=torch.float)
        )
        scene.write_data_to_sim()
        sim.step()
        scene.update(DT)
        out[step] = robot.data.joint_pos.numpy()[:, 0]
    return out, robot.actuators[0]._chosen.flatten().numpy(), robot


def mjlab_parity(prior: MotorPrior, count: int, steps: int) -> float:
    """Largest difference between mjlab's worlds and the same motors here [rad]."""
    found, chosen, _ = mjlab_run(prior, count, steps)
    bank = sampled(prior, count, 0, ("joint",), None)
    return largest(found, free_run(compiled(replace(bank, z=bank.z[chosen])), count, steps))


def largest(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference."""
    return float(np.abs(one - other).max())


def microseconds(step: Step, count: int, steps: int = 200) -> float:
    """Time of a step [µs], the fastest of five runs."""
    state = (targets(0, count), np.zeros(count), np.zeros(count))
    runs = []
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(steps):
            step(*state)
        runs.append(time.perf_counter() - start)
    return 1e6 * min(runs) / steps


def fleet_prior(motors: GreyBoxActuator) -> MotorPrior:
    """A prior around the median of these motors, with a standard deviation of SPREAD."""
    decoder = motors.model
    center = decoder.center + np.median(motors.z, axis=0)
    slope = SPREAD * np.eye(motors.z.shape[1])
    model = replace(decoder, center=center, slope=slope)
    return MotorPrior(
        model, np.zeros_like(motors.z), np.zeros_like(motors.z), "rollout", "pupper_v2", "", {}, {}
    )


def measure(out: Path = Path("runs/exports")) -> None:
    """Measure, print and write; see the module docstring."""
    rng = np.random.default_rng(0)
    fleet = load_fleet("pupper_v2")
    few, every = (true_grey_box(require_geared(fleet.sample(n, rng))) for n in (MOTORS, COUNT))
    figures: dict[str, float] = {}
    for name, exporter in EXPORTERS.items():
        if not is_supported(exporter):
            print(f"{name} left out: it needs MuJoCo {exporter.mujoco}")
            continue
        if exporter.replay is not None:
            found = losses(exporter.replay, few, MAX_STEP)
            figures |= {f"{name.replace('-', '_')}/{load}": value for load, value in found.items()}
    if find_spec("warp"):
        ours = free_run(compiled(every), COUNT, STEPS)
        figures["kernel/parity"] = largest(free_run(kernel(every), COUNT, STEPS), ours)
        figures["kernel/warp_us"] = microseconds(kernel(every), COUNT)
        figures["kernel/numba_us"] = microseconds(compiled(every), COUNT)
    if find_spec("newton"):
        own = free_run(explicit(every), COUNT, STEPS)
        figures["newton/parity"] = largest(free_run(newton(every), COUNT, STEPS), own)
    if find_spec("mjlab"):
        figures["mjlab/parity"] = mjlab_parity(fleet_prior(every), COUNT, STEPS)
    for extra in ("newton", "mjlab"):
        if f"{extra}/parity" not in figures:
            print(f"{extra}/parity left out: install the extra {extra}")
    report(figures, out / "figures.json")


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
