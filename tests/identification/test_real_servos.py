"""Real servos, an SO-101 arm at 50 Hz: its logs' joints are the model's; fitted servos follow held-out motions.

The logs (isaac-sim2real/sage, Apache-2.0) and the model without its meshes lie in so101/ and robots/ of the real logs.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
import shutil
from pathlib import Path

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator
from motorprior.identification.judging.log_fidelity import free_run_errors, free_runs
from motorprior.identification.physics.fleet_fit import fit_fleet
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.residual import without_residual
from motorprior.identification.training_data.windows import training_data
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.log_import.raw_logs import LogsImport, import_logs
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot

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


@pytest.fixture(scope="module")
def logs(shared_data: Path, description: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, MotorLog]:
    """With loads, at the period of the recipe, the first SECONDS of each."""
    out = tmp_path_factory.mktemp("logs")
    paths = tuple(shared_data / "so101" / f"{name}.csv.gz" for name in (*KNOWN, *HELD_OUT))
    import_logs(LogsImport(paths, out, columns="so101_sage", period=PRESET.period, hung=True, robot=str(description)))
    whole = {name: read_parquet(out / f"{name}.parquet") for name in (*KNOWN, *HELD_OUT)}
    return {name: log.rows(slice(0, round(SECONDS / PRESET.period))) for name, log in whole.items()}


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
