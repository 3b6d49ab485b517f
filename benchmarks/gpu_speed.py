"""Control steps per second of a quadruped in MuJoCo Warp, with sampled motors and with a PD.

    python benchmarks/gpu_speed.py --out runs/gpu_speed

Worlds of pupper_v2 trot open loop on a GPU, a CUDA graph per control step (a CPU has none). Paths:
``pd``, native position actuators; ``learned``, sampled motors, others in every world, by the
launches of our mjlab actuator. figures.json, per number of worlds: control_steps_per_s/PATH, of all
worlds, median of the rounds; learned_over_pd, ratio of times; upright/PATH, share of worlds after a
round.
"""

# pyright: reportMissingImports=false
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

try:
    import mujoco_warp as mjw
    import warp as wp
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: pip install 'mjlab==1.6.*'") from error

import motorprior as mp
from figures import run_benchmark
from motorprior.exports.exporter import sampled
from motorprior.exports.warp_motors import WarpMotors

ROBOT = mp.load_robot("pupper_v2")
SAMPLES = 1024  # motors per joint that worlds choose from
STEPS = 100  # control steps of a round
SUBSTEPS = round(ROBOT.control_dt / ROBOT.physics_dt)
PATHS = ("pd", "learned")
Work = Callable[[], object]


@dataclass(frozen=True)
class Settings:
    """Measure control steps per second."""

    out: Path = Path("runs/gpu_speed")  # run folder
    worlds: tuple[int, ...] = (1024, 4096, 16384)
    rounds: int = 7


def compute(settings: Settings) -> dict[str, float]:
    """The figures of all numbers of worlds."""
    figures: dict[str, float] = {}
    for count in settings.worlds:
        targets = trot(count)
        runs = [rounds_of(path, targets, figures) for path in PATHS]
        rounds = []
        for _ in range(settings.rounds):
            rounds.append([run() for run in runs])
        times = dict(zip(PATHS, np.transpose(rounds), strict=True))  # [s]
        for path, seconds_per_step in times.items():
            steps_per_second = float(np.median(count / seconds_per_step))
            figures[f"control_steps_per_s/{path}/{count}"] = steps_per_second
        figures[f"learned_over_pd/{count}"] = float(np.median(times["learned"] / times["pd"]))
    return figures


def model_of(path: str) -> mujoco.MjModel:
    """The robot on a floor with the actuators of a path, and mjlab's integrator."""
    spec = mujoco.MjSpec.from_file(str(ROBOT.model.path))
    spec.option.timestep = ROBOT.physics_dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.first_body().pos = [0.0, 0.0, ROBOT.standing_height]
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], contype=0, conaffinity=0
    )
    for leg in ROBOT.legs:
        spec.add_pair(
            geomname1="floor",
            geomname2=leg.foot,
            condim=3,
            friction=[ROBOT.foot_friction] * 2 + [0.0] * 3,
        )
    for joint in ROBOT.joints:
        actuator = spec.add_actuator(target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if path != "learned":
            actuator.set_to_position(kp=joint.kp, kv=joint.kd)
            actuator.forcelimited = 1
            actuator.forcerange = [-joint.torque_limit, joint.torque_limit]
    return spec.compile()


def trot(worlds: int) -> wp.array:
    """(STEPS, worlds, joints) position targets of trots of several sizes and phases [rad]."""
    drawn_size, drawn_phase = np.random.default_rng(0).uniform(size=(2, worlds, 1))
    size = (0.3 + 0.7 * drawn_size) * np.tile([0.0, 0.2, 0.3], 4)  # abduction, hip, knee
    phase_of_leg = np.repeat([leg.phase for leg in ROBOT.legs], 3)
    phase = drawn_phase + phase_of_leg + np.tile([0.0, 0.0, 0.25], 4)

    frequency = ROBOT.require_gait().frequency
    cycles = frequency * ROBOT.control_dt * np.arange(STEPS)[:, None, None]
    return wp.array(ROBOT.nominal_pose + size * np.sin(2 * np.pi * (cycles + phase)), dtype=float)


def motors_of(model: mjw.Model, data: mjw.Data, target: wp.array) -> tuple[Work, Work]:
    """Restart of the motors, and all their launches for a physics step."""
    worlds, joints = target.shape
    prior = mp.from_pretrained(ROBOT.name)
    samples = sampled(prior, SAMPLES, 0, ROBOT.joint_names, None)
    motors = WarpMotors(samples, target.size, ROBOT.physics_dt, str(wp.get_device()))
    robots = np.random.default_rng(0).integers(0, SAMPLES, target.shape)
    columns = robots * joints + np.arange(joints)
    motors.sample_index.assign(columns.ravel())

    pos = wp.zeros(target.shape, dtype=float)
    vel = wp.zeros(target.shape, dtype=float)
    model.dof_damping = wp.zeros((worlds, model.nv), dtype=float)

    def restart() -> None:
        motors.waiting.fill_(True)

    def drive() -> None:
        wp.copy(pos, data.qpos[:, 7:])
        wp.copy(vel, data.qvel[:, 6:])
        motors.step(target.flatten(), pos.flatten(), vel.flatten())
        wp.copy(data.ctrl, motors.torque.reshape(target.shape))
        wp.copy(model.dof_damping[:, 6:], motors.damping.reshape(target.shape))

    return restart, drive


def seconds(work: Work, calls: int) -> float:
    """Time of a call [s], mean of several."""
    wp.synchronize()
    started = time.perf_counter()
    for _ in range(calls):
        work()
    wp.synchronize()
    return (time.perf_counter() - started) / calls


def graph(work: Work) -> Work:
    """The work as a CUDA graph; on a CPU the work itself."""
    work()  # compiles
    if not wp.get_device().is_cuda:
        return work
    with wp.ScopedCapture() as capture:
        work()
    # a graph does not keep the arrays of its work
    return lambda _owner=work: wp.capture_launch(capture.graph)


def _nothing() -> None:
    """Without a motor model, nothing is restarted or driven."""


def rounds_of(path: str, targets: wp.array, figures: dict[str, float]) -> Callable[[], float]:
    """Rounds from the start, which return the time of a control step [s].

    They write the other figures of the path.
    """
    count = targets.shape[1]
    compiled = model_of(path)
    model = mjw.put_model(compiled)
    data = mjw.make_data(compiled, nworld=count, nconmax=8, njmax=64)
    start = np.tile([*compiled.qpos0[:7], *ROBOT.nominal_pose], (count, 1)).astype(np.float32)

    target = data.ctrl
    restart: Work = _nothing
    drive: Work = _nothing
    if path == "learned":
        target = wp.zeros(targets.shape[1:], dtype=float)
        restart, drive = motors_of(model, data, target)

    def control_step() -> None:
        for _ in range(SUBSTEPS):
            drive()
            mjw.step(model, data)

    step = graph(control_step)

    def run() -> float:
        mjw.reset_data(model, data)
        data.qpos.assign(start)
        restart()
        numbers = iter(range(STEPS))

        def next_step() -> None:
            wp.copy(target, targets[next(numbers)])
            step()

        time_of_step = seconds(next_step, STEPS)
        pos = data.qpos.numpy()
        assert np.isfinite(pos).all(), f"{path}: a position is not finite"
        figures[f"upright/{path}/{count}"] = float((pos[:, 2] > ROBOT.min_base_height).mean())
        return time_of_step

    return run


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
