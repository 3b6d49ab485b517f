"""What exports of motors lose, and how far the GPU kernel is from the compiled motors.

    python benchmarks/exports.py --out runs/exports

figures.json: FORMAT/leg, FORMAT/shank and FORMAT/leg_steps, the RMSE of exported against our own
joint angles over 12 motors [rad] (`exports.replay`), for bam, mjcf, mjcf_detailed and table;
kernel/parity, mjlab/parity and newton/parity, the largest difference of joint angles [rad] between
the Warp kernel in float32 and the compiled motors, each in its own closed loop, over 64 motors and
2000 steps of 2 ms; kernel/parity_mit, mjlab/parity_mit and newton/parity_mit, the same with
velocity targets, feed-forward torques and gains of every step (`mit_frames`). kernel/warp_us and
kernel/numba_us are times per step of these 64 motors on this CPU [µs].

Without the extras mjlab and newton these are left out. The motors have the true constants of the
fleet pupper_v2.
"""

# pyright: reportMissingImports=false
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from figures import run_benchmark
from motorprior.actuator import kernels
from motorprior.actuator.command_frame import POSITION, Frames, framed_arrays, send_frame
from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import load_fleet
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.motors import Motors
from motorprior.actuator.physical import PhysicalMotors
from motorprior.exports.bam import motors_of
from motorprior.exports.exporter import sampled
from motorprior.exports.registry import EXPORTERS, is_supported
from motorprior.exports.replay import MAX_STEP, losses

DT = 0.002  # physics step [s]
STEPS = 2000
COUNT = 64  # motors
INERTIA = 0.002  # of the load [kg·m²]
SPREAD = 0.15  # of the logarithms of the constants [-]
MIN_CONSTANT = 1e-6
TIMED_RUNS = 5
TIMED_STEPS = 200  # steps of a run

# (target, joint_pos, joint_vel, quantities of `Frames` by name) -> torque and damping
Step = Callable[..., tuple[np.ndarray, np.ndarray]]
CommandFrames = Callable[[int, int], Frames]  # (step, motors) -> the frame of that step


@dataclass(frozen=True)
class Settings:
    """Measure the losses of formats and the parity of GPU kernels."""

    out: Path = Path("runs/exports")  # run folder
    motors: int = 12  # motors of the formats
    parity_motors: int = COUNT  # motors of the kernels
    parity_steps: int = STEPS  # physics steps of the kernels


def compute(settings: Settings) -> dict[str, float]:
    """The figures of all formats and kernels."""
    rng = np.random.default_rng(0)
    fleet = load_fleet("pupper_v2")
    few_motors = true_grey_box(require_geared(fleet.sample(settings.motors, rng)))
    motors = true_grey_box(require_geared(fleet.sample(settings.parity_motors, rng)))
    count = settings.parity_motors
    steps = settings.parity_steps
    figures = losses_of_formats(few_motors)

    for figure, frames in {"parity": position_frames, "parity_mit": mit_frames}.items():
        if find_spec("warp"):
            ours = free_run(compiled(motors), count, steps, frames)
            theirs = free_run(kernel(motors), count, steps, frames)
            figures[f"kernel/{figure}"] = largest_difference(theirs, ours)

        if find_spec("newton"):
            ours = free_run(explicit(motors), count, steps, frames)
            theirs = free_run(newton(motors), count, steps, frames)
            figures[f"newton/{figure}"] = largest_difference(theirs, ours)

        if find_spec("mjlab"):
            parity = mjlab_parity(fleet_prior(motors), count, steps, frames)
            figures[f"mjlab/{figure}"] = parity

    if find_spec("warp"):
        figures["kernel/warp_us"] = microseconds(kernel(motors), count)
        figures["kernel/numba_us"] = microseconds(compiled(motors), count)

    for extra in ("newton", "mjlab"):
        if f"{extra}/parity" not in figures:
            print(f"{extra}/parity left out: install the extra {extra}")
    return figures


def losses_of_formats(motors: GreyBoxActuator) -> dict[str, float]:
    """RMSE of exported against our own joint angles [rad], by format and load."""
    figures: dict[str, float] = {}
    for name, exporter in EXPORTERS.items():
        if not is_supported(exporter):
            print(f"{name} left out: it needs MuJoCo {exporter.min_mujoco}")
            continue
        if exporter.replay is None:
            continue
        for load, error in losses(exporter.replay, motors, MAX_STEP).items():
            figures[f"{name.replace('-', '_')}/{load}"] = error
    return figures


def true_grey_box(motors: PhysicalMotors) -> GreyBoxActuator:
    """Grey boxes with these constants, one latent per constant."""
    positive = [name for name in PARAMETERS if name not in ("kd_over_kp", "encoder_zero")]
    values = {"encoder_zero": motors.encoder_zero}
    for name in (*positive, "kd"):
        values[name] = np.maximum(getattr(motors, name), MIN_CONSTANT)
    return motors_of(values)


def fleet_prior(motors: GreyBoxActuator) -> MotorPrior:
    """A prior around the median of these motors, with a standard deviation of SPREAD."""
    center = motors.model.center + np.median(motors.z, axis=0)
    slope = SPREAD * np.eye(motors.z.shape[1])
    model = replace(motors.model, center=center, slope=slope)
    zeros = np.zeros_like(motors.z)
    return MotorPrior(model, zeros, zeros, "rollout", "pupper_v2", "", {})


# Closed loops.


def targets(step: int, count: int) -> np.ndarray:
    """(count,) sines of several frequencies, with jumps that reach the torque limit [rad]."""
    motor = np.arange(count)
    frequency = 0.5 + 0.05 * (motor % 20)  # [Hz]
    jump = 0.4 * (step // 250 % 2)
    return 0.4 * np.sin(2 * np.pi * frequency * step * DT + motor) + jump


def position_frames(step: int, count: int) -> Frames:
    """No velocity targets and feed-forward torques, and constant gains."""
    return POSITION


def mit_frames(step: int, count: int) -> Frames:
    """Velocity targets, feed-forward torques, and gains that ramp and jump; motors differ."""
    motor = np.arange(count)
    phase = 2 * np.pi * step * DT + motor
    ramp = min(1.0, 0.1 + step * DT)
    is_off = (step // 150 + motor) % 4 == 0  # a jump to 0 and back
    return Frames(
        velocity_target=1.5 * np.cos(1.3 * phase),
        torque_feedforward=0.1 * np.sin(0.7 * phase),
        kp_factor=ramp * (1.0 + 0.2 * np.sin(phase)),
        kd_factor=np.where(is_off, 0.0, 1.2 - 0.5 * ramp),
    )


def free_run(
    step_motors: Step, count: int, steps: int, frames: CommandFrames = position_frames
) -> np.ndarray:
    """(steps, count) joint angles [rad] on a load of INERTIA.

    ``step_motors`` gives torques and dampings.
    """
    q = np.zeros(count)
    dq = np.zeros(count)
    angles = np.zeros((steps, count))
    for step in range(steps):
        frame = frames(step, count)._asdict()
        torque, damping = step_motors(targets(step, count), q, dq, **frame)
        dq = (dq + DT * torque / INERTIA) / (1.0 + DT * damping / INERTIA)
        q = q + DT * dq
        angles[step] = q
    return angles


def largest_difference(one: np.ndarray, two: np.ndarray) -> float:
    """Largest absolute difference."""
    return float(np.abs(one - two).max())


def microseconds(step: Step, count: int) -> float:
    """Time of a step [µs], the fastest of TIMED_RUNS runs."""
    rest = np.zeros(count)
    target = targets(0, count)
    seconds = []
    for _ in range(TIMED_RUNS):
        start = time.perf_counter()
        for _ in range(TIMED_STEPS):
            step(target, rest, rest)
        seconds.append(time.perf_counter() - start)
    return 1e6 * min(seconds) / TIMED_STEPS


# Steps of the motors: ours, the Warp kernel, Newton and mjlab.


def compiled(motors: GreyBoxActuator) -> Step:
    """Our own motors."""
    return Motors(motors, DT, np.zeros(motors.num_motors)).step


def explicit(motors: GreyBoxActuator) -> Step:
    """Our own motors for an engine that does not damp, as `kernels.make_explicit`."""
    arrays = framed_arrays(motors, DT)
    zero = np.zeros(motors.num_motors)
    kernels.reset_actuator(arrays, zero, zero)

    def step(
        target: np.ndarray, q: np.ndarray, dq: np.ndarray, **frame: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        send_frame(arrays.frames, Frames(**frame), motors.num_motors)
        torque = np.zeros(motors.num_motors)
        kernels.step_actuator(arrays, DT, target, q, dq, torque)
        kernels.make_explicit(arrays, dq, torque)
        return torque, arrays.damping.copy()

    return step


def warp_array(values: Any, dtype: Any = float) -> Any:
    """A Warp array on the CPU."""
    import warp as wp

    return wp.array(np.asarray(values), dtype=dtype, device="cpu")


def kernel(motors: GreyBoxActuator) -> Step:
    """The Warp kernel alone."""
    from motorprior.exports.warp_motors import WarpMotors

    count = motors.num_motors
    warp_motors = WarpMotors(motors, count, DT, "cpu")

    def step(
        target: np.ndarray, q: np.ndarray, dq: np.ndarray, **frame: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        arrays = {}
        for name, value in frame.items():
            arrays[name] = warp_array(np.broadcast_to(value, count))
        warp_motors.step(warp_array(target), warp_array(q), warp_array(dq), **arrays)
        torque = warp_motors.torque.numpy().astype(float)
        damping = warp_motors.damping.numpy().astype(float)
        return torque, damping

    return step


class NewtonWorld:
    """Arrays of Newton's state and control."""

    def __init__(self, count: int):
        self.joint_q = warp_array(np.zeros(count))
        self.joint_qd = warp_array(np.zeros(count))
        self.joint_f = warp_array(np.zeros(count))
        self.joint_target_q = warp_array(np.zeros(count))
        self.joint_target_qd = warp_array(np.zeros(count))
        self.joint_act = warp_array(np.zeros(count))  # feed-forward torques


def newton(motors: GreyBoxActuator) -> Step:
    """The drive of Newton, whose effort is torque - damping·velocity; the damping is 0."""
    import warp as wp
    from newton.actuators import Actuator

    from motorprior.exports.newton import MotorPriorDrive

    count = motors.num_motors
    indices = warp_array(np.arange(count), wp.uint32)
    drive = MotorPriorDrive(motors, DT)
    actuator = Actuator(indices, drive=drive)
    states = [actuator.state(), actuator.state()]
    world = NewtonWorld(count)

    def step(
        target: np.ndarray, q: np.ndarray, dq: np.ndarray, **frame: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        sent = Frames(**frame)
        world.joint_target_qd.assign(np.broadcast_to(sent.velocity_target, count))
        world.joint_act.assign(np.broadcast_to(sent.torque_feedforward, count))
        drive.kp_factor.assign(np.broadcast_to(sent.kp_factor, count))
        drive.kd_factor.assign(np.broadcast_to(sent.kd_factor, count))
        world.joint_target_q.assign(target.astype(np.float32))
        world.joint_q.assign(q.astype(np.float32))
        world.joint_qd.assign(dq.astype(np.float32))
        world.joint_f.zero_()
        actuator.step(world, world, *states, dt=DT)
        states.reverse()
        return world.joint_f.numpy().astype(float), np.zeros(count)

    return step


RIG = f"""<mujoco>
  <option timestep="{DT}"/>
  <worldbody>
    <body name="link">
      <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
      <joint name="joint" axis="0 1 0" armature="9"/>
    </body>
  </worldbody>
</mujoco>"""


def mjlab_run(
    prior: MotorPrior, count: int, steps: int, frames: CommandFrames = position_frames
) -> tuple[np.ndarray, np.ndarray, Any]:
    """Motors in mjlab's worlds of one joint each.

    Returns (steps, count) joint angles, (count,) indices of the motors, and the entity.
    """
    import torch

    scene, sim = _mjlab_scene(prior, count)
    robot = scene["rig"]
    actuator = robot.actuators[0]

    def tensor(values: Any) -> Any:
        return torch.tensor(np.broadcast_to(values, count)[:, None], dtype=torch.float)

    angles = np.zeros((steps, count))
    for step in range(steps):
        frame = frames(step, count)
        robot.set_joint_position_target(tensor(targets(step, count)))
        robot.set_joint_velocity_target(tensor(frame.velocity_target))
        robot.set_joint_effort_target(tensor(frame.torque_feedforward))
        actuator.kp_factor[:] = tensor(frame.kp_factor)
        actuator.kd_factor[:] = tensor(frame.kd_factor)
        scene.write_data_to_sim()
        sim.step()
        scene.update(DT)
        angles[step] = robot.data.joint_pos.numpy()[:, 0]
    return angles, actuator._sample_index.flatten().numpy(), robot


def _mjlab_scene(prior: MotorPrior, count: int) -> tuple[Any, Any]:
    """Scene and simulation of ``count`` worlds of RIG, without gravity."""
    import mujoco
    from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
    from mjlab.scene import Scene, SceneCfg
    from mjlab.sim import Simulation, SimulationCfg

    from motorprior.exports.mjlab import MotorPriorActuatorCfg

    actuator = MotorPriorActuatorCfg(target_names_expr=("joint",), source=prior, samples=count)
    articulation = EntityArticulationInfoCfg(actuators=(actuator,))
    entity = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(RIG), articulation=articulation)
    scene = Scene(SceneCfg(num_envs=count, env_spacing=1.0, entities={"rig": entity}), "cpu")

    config = SimulationCfg()
    config.mujoco.timestep = DT
    config.mujoco.gravity = (0.0, 0.0, 0.0)
    sim = Simulation(num_envs=count, cfg=config, model=scene.compile(), device="cpu")
    scene.initialize(sim.mj_model, sim.model, sim.data)
    # in an environment the event `per_world_damping` does this
    sim.expand_model_fields(("dof_damping",))
    scene.reset()
    return scene, sim


def mjlab_parity(
    prior: MotorPrior, count: int, steps: int, frames: CommandFrames = position_frames
) -> float:
    """Largest difference between mjlab's worlds and the same motors here [rad]."""
    theirs, columns, _ = mjlab_run(prior, count, steps, frames)
    samples = sampled(prior, count, 0, ("joint",), None)
    motors = replace(samples, z=samples.z[columns])
    return largest_difference(theirs, free_run(compiled(motors), count, steps, frames))


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
