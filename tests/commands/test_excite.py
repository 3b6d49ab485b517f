"""`excite` writes an excitation from logs that a bench and a robot can play."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motor_logs import joints_of, log_of

from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.excite import Excite, run_excite
from motorprior.exceptions import LogError
from motorprior.excitation.robot_targets import hardware_targets
from motorprior.logs.loads import with_torque_balance
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def suspended_run() -> MotorLog:
    """Six seconds in which the knees swing and the other joints are static, with torques."""
    time = 0.002 * np.arange(3000)
    knees = np.array([name.endswith("knee") for name in PUPPER_V2.joint_names])
    target = PUPPER_V2.nominal_pose + 0.2 * knees * np.sin(2 * np.pi * 2.0 * time)[:, None]
    speed = 0.2 * knees * 4.0 * np.pi * np.cos(2 * np.pi * 2.0 * time)[:, None]

    return log_of(
        time,
        target,
        joint_vel=speed,
        joint_torque=np.full_like(target, 0.1),
        **joints_of(PUPPER_V2),
    )


def test_inertia_times_acceleration_is_external_plus_motor_torque():
    log = suspended_run()
    balanced = with_torque_balance(log, PUPPER_V2)
    assert balanced.load_inertia is not None
    assert balanced.external_torque is not None
    assert log.joint_vel is not None

    acceleration = np.gradient(log.joint_vel, log.time, axis=0)

    assert balanced.load_inertia * acceleration == pytest.approx(balanced.external_torque + 0.1)
    assert np.all(balanced.load_inertia > 1e-5)
    with pytest.raises(LogError):
        with_torque_balance(replace(log, joint_torque=None), PUPPER_V2)


def test_an_excitation_of_runs_plays_on_the_bench_on_the_robot_and_as_csv(tmp_path: Path):
    run = tmp_path / "run.parquet"
    out = tmp_path / "walk.safetensors"
    write_log(run, suspended_run())
    settings = Excite((run,), out, "recorded", robot="pupper_v2", max_torque=0.5, csv_seconds=2.0)
    excitation = run_excite(settings)

    assert excitation.classes == ("knee",)
    assert excitation.bounds[0, 3] <= 0.5

    table = np.loadtxt(tmp_path / "walk.csv", delimiter=",", skiprows=1)

    assert table.shape == (200, 4)
    assert np.abs(table[:, 1]).max() <= excitation.bounds[0, 0]
    assert table[:, 3] == pytest.approx(excitation.load_inertia[0, 0], rel=1e-5)

    run_bench(Bench(tmp_path / "bench", excitation=str(out), motors=2, steps=1500))
    log = read_parquet(tmp_path / "bench" / "log.parquet")

    assert log.load_inertia == pytest.approx(excitation.load_inertia[0, 0])  # equal for all knees
    assert 0.05 < log.position_target.std() < 0.2

    joints = range(PUPPER_V2.num_joints)
    targets = hardware_targets(PUPPER_V2, str(out), joints, 5.0, amplitude=0.1, speed=2.0, seed=0)
    away = targets - PUPPER_V2.nominal_pose

    assert 0.05 < np.abs(away).max() <= 0.1 + 1e-9
    assert np.abs(np.diff(targets, axis=0)).max() <= 2.0 * PUPPER_V2.control_dt + 1e-9
    assert np.all(targets[[0, -1]] == PUPPER_V2.nominal_pose)

    slow = hardware_targets(PUPPER_V2, str(out), joints, 5.0, amplitude=0.1, speed=0.6, seed=0)

    # an excitation that is merely scaled down to 0.6 rad/s would reach 0.06 rad
    assert np.abs(slow - PUPPER_V2.nominal_pose).max() > 0.065
    assert np.abs(np.diff(slow, axis=0)).max() <= 0.6 * PUPPER_V2.control_dt + 1e-9
