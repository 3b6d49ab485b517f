"""`load_log` gives what `motorprior logs import` writes: on a grid, with settings and loads."""

from pathlib import Path

import numpy as np
import pytest
from third_party_files import write_csv
from weighed_arm import arm_table, slow_motion, write_arm

import motorprior as mp
from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.logs.motor_log import POSTURES, channels


def test_a_log_of_a_fixed_robot_has_loads_and_is_what_an_import_writes(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot).rows(slice(0, 300)), tmp_path)
    log = mp.load_log(
        table,
        columns=columns,
        robot=mp.load_robot(robot),
        suspended=True,
        settings=mp.LogSettings(kp=20.0),
    )
    import_logs(
        LogsImport((table,), tmp_path / "out", columns, kp=(20.0,), suspended=True, robot=robot)
    )
    written = mp.read_log(tmp_path / "out" / "arm.parquet")
    assert channels(log).keys() == channels(written).keys()
    for name, values in channels(log).items():
        np.testing.assert_array_equal(values, getattr(written, name))
    np.testing.assert_allclose(np.diff(log.time), 0.002)
    assert log.posture is not None and set(log.posture) == {POSTURES.index("fixed")}
    assert log.gains is not None and log.gains.tolist() == [[20.0, 20.0], [20.0, 20.0]]
    with pytest.raises(mp.ConfigError, match="load_inertia"):
        mp.load_log(tmp_path / "out" / "arm.parquet", robot=robot, suspended=True)


def test_signs_that_contradict_gravity_are_a_python_warning(tmp_path: Path):
    robot = write_arm(tmp_path)
    table, columns = arm_table(slow_motion(robot), tmp_path, "elbow")
    with pytest.warns(UserWarning, match="elbow"):
        mp.load_log(table, columns=columns, robot=robot, suspended=True)


def test_given_settings_override_those_of_the_log(tmp_path: Path):
    path = write_csv(tmp_path)
    columns = tmp_path / "columns.toml"
    settings = {"dead_zone": 0.002}, {"supply_voltage": 7.0}
    log = mp.load_log(
        path,
        columns=columns,
        settings=mp.LogSettings(
            period=None, kp=3.0, kd=0.1, firmware=settings[0], operating_conditions=settings[1]
        ),
    )
    assert log.gains is not None and log.gains.tolist() == [[3.0, 3.0], [0.1, 0.1]]
    assert log.firmware == settings[0] and log.operating_conditions["supply_voltage"].tolist() == [
        7.0,
        7.0,
    ]
    np.testing.assert_array_equal(log.time, mp.read_log(path, columns=columns).time)
    with pytest.raises(mp.LogError, match="supply_voltage/pan is -1"):
        mp.load_log(
            path,
            columns=columns,
            settings=mp.LogSettings(operating_conditions={"supply_voltage": -1.0}),
        )
