"""`load_log` returns what `motorprior logs import` writes: rows on a grid, settings and loads."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from third_party_files import write_csv
from weighed_arm import arm_table, slow_motion, write_arm

import motorprior as mp
from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.logs.loads import load_source
from motorprior.logs.motor_log import POSTURES, channels


def test_a_log_of_a_fixed_robot_has_loads_and_equals_what_an_import_writes(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot).rows(slice(0, 300)), tmp_path)
    out = tmp_path / "out"
    log = mp.load_log(
        table,
        columns=columns,
        robot=mp.load_robot(robot),
        suspended=True,
        settings=mp.LogSettings(kp=20.0),
    )

    import_logs(LogsImport((table,), out, columns, kp=(20.0,), suspended=True, robot=robot))
    written = mp.read_log(tmp_path / "out" / "arm.parquet")

    assert channels(log).keys() == channels(written).keys()
    for name, values in channels(log).items():
        np.testing.assert_array_equal(values, getattr(written, name))
    np.testing.assert_allclose(np.diff(log.time), 0.002)
    assert log.posture is not None
    assert set(log.posture) == {POSTURES.index("fixed")}
    assert log.gains is not None
    assert log.gains.tolist() == [[20.0, 20.0], [20.0, 20.0]]

    with pytest.raises(mp.ConfigError, match="load_inertia"):
        mp.load_log(tmp_path / "out" / "arm.parquet", robot=robot, suspended=True)


def test_a_sign_that_contradicts_gravity_warns_of_its_joint(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot), tmp_path, "elbow")

    with pytest.warns(UserWarning, match="elbow"):
        mp.load_log(table, columns=columns, robot=robot, suspended=True)


def test_given_settings_override_those_of_the_log(tmp_path: Path):
    path = write_csv(tmp_path)
    columns = tmp_path / "columns.toml"
    firmware = {"dead_zone": 0.002}
    settings = mp.LogSettings(
        period=None,
        kp=3.0,
        kd=0.1,
        firmware=firmware,
        operating_conditions={"supply_voltage": 7.0},
    )

    log = mp.load_log(path, columns=columns, settings=settings)
    assert log.gains is not None
    assert log.gains.tolist() == [[3.0, 3.0], [0.1, 0.1]]
    assert log.firmware == firmware
    assert log.operating_conditions["supply_voltage"].tolist() == [7.0, 7.0]
    np.testing.assert_array_equal(log.time, mp.read_log(path, columns=columns).time)

    negative = mp.LogSettings(operating_conditions={"supply_voltage": -1.0})

    with pytest.raises(mp.LogError, match=r"supply_voltage/pan .*-1"):
        mp.load_log(path, columns=columns, settings=negative)


def test_a_robot_with_a_fixed_base_gets_loads_without_the_option_suspended(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot).rows(slice(0, 300)), tmp_path)
    log = mp.load_log(table, columns=columns, robot=robot)
    stated = mp.load_log(table, columns=columns, robot=robot, suspended=True)

    for name, values in channels(stated).items():
        np.testing.assert_array_equal(values, getattr(log, name))

    rows = mp.load_log(table, columns=columns, robot=robot, settings=mp.LogSettings(period=None))

    assert rows.load_inertia is None, "recorded rows have no smooth accelerations"


def test_loads_come_from_the_log_or_else_from_the_model_or_are_unknown(tmp_path: Path):
    arm = mp.load_robot(write_arm(tmp_path))
    log = replace(slow_motion(str(tmp_path / "arm.toml")), load_inertia=None)
    log = replace(log, external_torque=None, load_stiffness=None, posture=None)

    assert load_source(log, arm, False, "x").name == "model"
    assert load_source(log, None, False, "x").name == "unknown"
    assert load_source(log.joint(0), arm, False, "x").name == "unknown"

    with pytest.raises(mp.LogError):
        load_source(log.joint(0), arm, True, "x")

    pupper = mp.load_robot("pupper_v2")
    angle = np.zeros((log.num_rows, pupper.num_joints))
    walk = replace(
        log, position_target=angle, joint_pos=angle, joint_vel=None, joint_names=pupper.joint_names
    )
    source = load_source(walk, pupper, False, "x")

    assert source.name == "unknown"
    assert "posture" in source.reason
    assert load_source(walk, pupper, True, "x").name == "model"

    suspended = np.full(log.num_rows, POSTURES.index("suspended"))

    assert load_source(replace(walk, posture=suspended), pupper, False, "x").name == "model"

    loaded = replace(log, load_inertia=np.ones_like(log.joint_pos))

    assert load_source(loaded, arm, False, "x").name == "log"

    with pytest.raises(mp.ConfigError, match="load_inertia"):
        load_source(loaded, arm, True, "x")


def test_a_recording_with_errors_is_refused_unless_they_are_allowed(tmp_path: Path):
    robot = write_arm(tmp_path)
    moving = slow_motion(robot).rows(slice(0, 3000))
    table, columns = arm_table(replace(moving, joint_pos=-moving.joint_pos), tmp_path)
    errors = mp.check_log(mp.read_log(table, columns=columns)).errors

    assert errors

    with pytest.raises(mp.LogError, match="against its command"):
        mp.load_log(table, columns=columns, robot=robot)

    with pytest.warns(UserWarning, match="against its command"):
        log = mp.load_log(table, columns=columns, robot=robot, allow_errors=True)

    assert log.num_joints == moving.num_joints


@pytest.mark.parametrize(
    "use",
    [
        lambda path: mp.fit_prior(path),
        lambda path: mp.fit_prior([path]),
        lambda path: mp.adapt(mp.from_pretrained("so101"), path),
        lambda path: mp.validate(mp.from_pretrained("so101"), path),
        lambda path: mp.check_log(path),
    ],
)
@pytest.mark.parametrize("path", ["a.csv", Path("a.csv")])
def test_a_path_in_place_of_a_log_is_an_error_that_names_the_function_to_read_it(use, path):
    with pytest.raises(mp.ConfigError, match=r"'a\.csv' is a path, not a MotorLog.*load_log"):
        use(path)
