"""Real servos, an SO-101 arm at 50 Hz: its logs' joints are the model's; fitted servos follow held-out motions.

The logs (isaac-sim2real/sage, Apache-2.0) and the model without its meshes lie in so101/ and robots/ of the real logs.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
import itertools
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.identification.judging.log_fidelity import free_run_errors, free_runs
from motorprior.identification.physics.fleet_fit import fit_fleet
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.residual import without_residual
from motorprior.identification.training_data.smoothing import quantum
from motorprior.identification.training_data.windows import training_data
from motorprior.logs.doctor.gravity_checks import signs
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.formats.registry import read_log
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.log_import.raw_logs import LogsImport, import_logs
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.hung_load import gravity_of_held

PRESET = PRESETS["long_runs"]
TERMS = ("profile", "output_encoder", "dead_zone", "output_damping")
KNOWN = ("step_response", "inertia_coupling", "boundary_exploration", "coupled_joints")
HELD_OUT = ("custom_motion", "multisine", "wave_motion")
SECONDS = 20.0
"""Of every motion."""
LIFT, ELBOW, WRIST = 1, 2, 3
"""Joints that carry weight."""


@pytest.fixture(scope="module")
def description(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = shared_data / "robots" / "so101.xml"
    if not model.is_file() or not (shared_data / "so101").is_dir():
        pytest.skip("no so101/ or no robots/so101.xml in the folder that MOTORPRIOR_SHARED names")
    folder = tmp_path_factory.mktemp("so101")
    for path in (model, Path(__file__).resolve().parents[2] / "examples" / "robots" / "so101.toml"):
        shutil.copy(path, folder)
    return folder / "so101.toml"


def moving(log: MotorLog, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows at which a joint follows its command steadily, up to 0.5 rad/s, and its velocities there [rad/s]."""
    speed, wanted = (
        (angles[10:, joint] - angles[:-10, joint]) / (log.time[10:] - log.time[:-10])
        for angles in (log.joint_pos, log.position_target)
    )
    steady = np.flatnonzero((np.abs(speed) > 0.04) & (np.abs(speed) < 0.5) & (np.abs(speed - wanted) < 0.08))[::60]
    return steady + 5, speed[steady]


def misfit(samples: tuple[np.ndarray, ...], joint: int, signs: np.ndarray, model: mujoco.MjModel) -> float:
    """RMS [rad] of error - (gravity·compliance + friction·sign(speed) + lag·speed), a compliance below 0 refused."""
    angles, errors, speeds = samples
    data, gravity = mujoco.MjData(model), np.empty(len(angles))
    for row, pose in enumerate(angles):
        data.qpos[:] = signs * pose
        mujoco.mj_forward(model, data)
        gravity[row] = signs[joint] * data.qfrc_bias[joint]
    columns = np.stack([gravity, np.sign(speeds), speeds], axis=1)
    found, *_ = np.linalg.lstsq(columns, errors, rcond=None)
    if found[0] < 0.0:
        columns[:, 0], found[1:] = 0.0, np.linalg.lstsq(columns[:, 1:], errors, rcond=None)[0]
    return float(np.sqrt(np.mean((errors - columns @ found) ** 2)))


def test_gravity_says_that_the_logs_signs_and_zeros_are_the_models(shared_data: Path, description: Path):
    robot = load_robot(str(description))
    logs = [read_log(path, robot, "so101_sage") for path in sorted((shared_data / "so101").glob("*.csv.gz"))]
    assert len(logs) == 40 and {log.joint_names for log in logs} == {robot.joint_names}
    model = mujoco.MjModel.from_xml_path(str(description.with_suffix(".xml")))
    found = {}
    for joint in (LIFT, ELBOW, WRIST):
        picked = [(log, *moving(log, joint)) for log in logs]
        angles = np.concatenate([log.joint_pos[rows] for log, rows, _ in picked])
        errors = np.concatenate([(log.position_target - log.joint_pos)[rows, joint] for log, rows, _ in picked])
        samples = angles, errors, np.concatenate([speeds for *_, speeds in picked])
        for flips in itertools.product((1.0, -1.0), repeat=3):
            signs = np.array([1.0, *flips, 1.0, 1.0])
            found[joint, flips] = misfit(samples, joint, signs, model)
    totals = {flips: sum(found[joint, flips] for joint in (LIFT, ELBOW, WRIST)) for _, flips in found}
    as_it_is = totals.pop((1.0, 1.0, 1.0))
    assert as_it_is < 0.9 * min(totals.values())


@pytest.mark.parametrize(("turned", "fewest"), [((), 0), ((LIFT, ELBOW), 34), ((LIFT,), 30), ((ELBOW,), 20)])
def test_the_doctor_finds_turned_signs_and_none_where_they_are_right(
    shared_data: Path, description: Path, turned: tuple[int, ...], fewest: int
):
    """In so many of the 40 motions, one by one, and in all as one log."""
    robot, sign = load_robot(str(description)), np.ones(6)
    sign[list(turned)] = -1.0
    logs = [read_log(path, robot, "so101_sage") for path in sorted((shared_data / "so101").glob("*.csv.gz"))]
    logs = [replace(log, position_target=sign * log.position_target, joint_pos=sign * log.joint_pos) for log in logs]
    gravity = gravity_of_held(logs[0], robot)
    assert gravity is not None
    warned = {Path(log.source).name.split(".")[0] for log in logs if signs(log, gravity)}
    assert len(warned) >= fewest and (not warned or {"multisine", "large_amplitude"} <= warned)
    assert turned or not warned
    assert bool(signs(joined(logs), gravity)) == bool(turned)


@pytest.fixture(scope="module")
def logs(shared_data: Path, description: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, MotorLog]:
    """With loads, at the period of the recipe, the first SECONDS of each."""
    out = tmp_path_factory.mktemp("logs")
    paths = tuple(shared_data / "so101" / f"{name}.csv.gz" for name in (*KNOWN, *HELD_OUT))
    import_logs(LogsImport(paths, out, columns="so101_sage", period=PRESET.period, hung=True, robot=str(description)))
    whole = {name: read_parquet(out / f"{name}.parquet") for name in (*KNOWN, *HELD_OUT)}
    return {name: log.rows(slice(0, round(SECONDS / PRESET.period))) for name, log in whole.items()}


def test_commands_are_held_from_the_row_that_has_them_and_smoothing_stays_within_the_encoders_steps(
    shared_data: Path, description: Path, logs: dict[str, MotorLog]
):
    raw = read_log(shared_data / "so101" / "multisine.csv.gz", load_robot(str(description)), "so101_sage")
    fine = logs["multisine"]
    for row in (100, 400, 800):
        at = np.searchsorted(fine.time, raw.time[row] + 1e-9)
        np.testing.assert_array_equal(fine.position_target[at], raw.position_target[row])
        np.testing.assert_array_equal(fine.position_target[at - 1], raw.position_target[row - 1])
    rows = raw.time < fine.time[-1]
    seen = np.stack([np.interp(raw.time[rows], fine.time, column) for column in fine.joint_pos.T], axis=1)
    assert quantum(raw.joint_pos[:, LIFT]) == pytest.approx(2 * np.pi / 4096, rel=1e-3)
    assert np.sqrt(np.mean((seen - raw.joint_pos[rows]) ** 2)) < 1e-3


def held_out_errors(logs: dict[str, MotorLog], robot: Robot) -> tuple[float, float]:
    """Mean over joints and motions [rad] of free runs of a second: of motors fitted to KNOWN, and of a pure delay."""
    known = joined([logs[name] for name in KNOWN])
    data = training_data(known, PRESET, "known")
    bare = without_residual(data.scales, PRESET)
    fit = fit_fleet(bare, WindowRuns(data, PRESET), TERMS, True, 0, turns=((0.1, 3),))
    motors = LatentActuator(fit.network(bare), fit.offsets)
    errors, delayed = [], []
    lag = round(0.1 / PRESET.period)  # the best on these motions, to 20 ms
    for name in HELD_OUT:
        errors.append(free_run_errors([free_runs(logs[name], PRESET, name)], {"motors": motors})["motors"])
        apart = logs[name].position_target[:-lag] - logs[name].joint_pos[lag:]
        delayed.append(np.sqrt(np.mean(apart**2, axis=0)))
    return float(np.mean(errors)), float(np.mean(delayed))


@pytest.mark.slow
def test_servos_fitted_to_some_motions_follow_others(logs: dict[str, MotorLog], description: Path):
    error, delay = held_out_errors(logs, load_robot(str(description)))
    assert error < 0.0045
    assert error < 0.22 * delay
