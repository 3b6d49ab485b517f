"""Commands of every mode: read by a column map, checked, put on a grid, written and read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motor_logs import log_of

import motorprior as mp
from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.command_modes import commands_angles, gain_factors, unmeasured_scales
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog, checked, settings_text
from motorprior.logs.operations import joined, resample
from motorprior.logs.readers.motor_log_file import read_parquet, write_log

ROWS = 200
TIME = 0.002 * np.arange(ROWS)
COLUMNS = ("t", "goal", "speed", "tau", "p", "d", "pos")
HEAD = 'motor = "drive"\ntime = "t"\njoint_pos = "pos"\n'
COMMANDS = 'position_target = "goal"\nvelocity_target = "speed"\ntorque_feedforward = "tau"\n'
GAINS = 'kp = "p"\nkd = "d"\n'
JOINT = "[joints.a]\n"


def table(folder: Path, kp: np.ndarray | float = 40.0, kd: np.ndarray | float = 1.0) -> Path:
    """A CSV with COLUMNS."""
    shape = (ROWS,)
    goal = np.sin(5.0 * TIME)
    speed = 5.0 * np.cos(5.0 * TIME)
    gains = [np.broadcast_to(kp, shape), np.broadcast_to(kd, shape)]
    rows = np.column_stack([TIME, goal, speed, 0.3 * goal, *gains, goal - 0.01])
    path = folder / "run.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(COLUMNS), comments="")
    return path


def map_of(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(text)
    return path


def mit_log(**fields: object) -> MotorLog:
    ramp = np.minimum(1.0, TIME / 0.1)[:, None]
    target = np.sin(5.0 * TIME)[:, None]
    commands = {
        "command_mode": "mit",
        "velocity_target": 5.0 * np.cos(5.0 * TIME)[:, None],
        "torque_feedforward": 0.3 * target,
        "logged_kp": 40.0 * ramp,
        "logged_kd": np.ones_like(ramp),
    }
    return checked(log_of(TIME, target, **(commands | fields)))


@pytest.mark.parametrize(
    ("entries", "kp", "kd", "mode"),
    [
        ('position_target = "goal"\n', 40.0, 1.0, "position"),
        (COMMANDS + GAINS, 40.0, 1.0, "mit"),
        (COMMANDS + GAINS, 0.0, 1.0, "velocity"),
        (COMMANDS + GAINS, 0.0, 0.0, "torque"),
        ('velocity_target = "speed"\n', 40.0, 1.0, "velocity"),
        ('torque_feedforward = "tau"\n', 40.0, 1.0, "torque"),
        ('torque_feedforward = "tau"\n' + GAINS, 0.0, 0.3, "velocity"),
    ],
)
def test_the_columns_of_a_map_and_gains_of_zero_give_the_command_mode(
    tmp_path: Path, entries: str, kp: float, kd: float, mode: str
):
    columns = map_of(tmp_path, HEAD + entries + JOINT)
    log = mp.read_log(table(tmp_path, kp, kd), columns=columns)

    assert log.command_mode == mode
    assert f"{mode} commands" in settings_text(log) or mode == "position"


@pytest.mark.parametrize(
    ("entries", "kd", "unit", "ends"),
    [
        ('velocity_target = "speed"\n', 1.0, "rad/s", ("-2.04", "5.00")),
        ('torque_feedforward = "tau"\n', 0.0, "N·m", ("0.00", "0.30")),
    ],
)
def test_the_overview_has_the_commands_of_the_mode(
    tmp_path: Path, entries: str, kd: float, unit: str, ends: tuple[str, str]
):
    columns = map_of(tmp_path, HEAD + entries + JOINT)

    overview = mp.read_log(table(tmp_path, 0.0, kd), columns=columns).overview()

    assert overview.columns[3] == f"command from [{unit}]"
    assert tuple(overview.rows[0][3:]) == ends


def test_gains_of_every_row_are_read_from_columns(tmp_path: Path):
    ramp = np.linspace(0.0, 40.0, ROWS)
    columns = map_of(tmp_path, HEAD + COMMANDS + GAINS + JOINT)

    log = mp.read_log(table(tmp_path, ramp), columns=columns)

    assert log.logged_kp is not None
    np.testing.assert_allclose(log.logged_kp[:, 0], ramp)
    np.testing.assert_allclose(gain_factors(log)[0, :, 0], ramp / 40.0)


def test_a_damped_torque_command_keeps_its_kd_and_has_a_velocity_target_of_zero(tmp_path: Path):
    columns = map_of(tmp_path, HEAD + 'torque_feedforward = "tau"\n' + GAINS + JOINT)

    log = mp.read_log(table(tmp_path, 0.0, 0.3), columns=columns)

    assert log.logged_kd is not None
    np.testing.assert_array_equal(log.logged_kd, 0.3)
    np.testing.assert_array_equal(log.velocity_target, 0.0)
    assert np.any(log.torque_feedforward)


def test_a_position_gain_without_a_position_target_is_refused(tmp_path: Path):
    columns = map_of(tmp_path, HEAD + 'torque_feedforward = "tau"\n' + GAINS + JOINT)

    with pytest.raises(LogError, match="kp is 40, and no angle is commanded") as refused:
        mp.read_log(table(tmp_path, 40.0), columns=columns)

    assert "position_target" in str(refused.value.remedy)


def test_gains_of_the_map_that_contradict_the_file_are_a_warning_with_both(tmp_path: Path):
    columns = map_of(tmp_path, HEAD + COMMANDS + GAINS + JOINT + "kp = 25\nkd = 1\n")

    with pytest.warns(UserWarning, match="kp of a is 40 in the file.* 25 in the column map"):
        log = mp.load_log(table(tmp_path), columns=columns)

    assert log.logged_kp is not None
    assert log.logged_kp[0, 0] == 40.0


def test_a_stated_gain_that_replaces_a_ramp_is_a_warning(tmp_path: Path):
    columns = map_of(tmp_path, HEAD + COMMANDS + GAINS + JOINT)
    path = table(tmp_path, np.linspace(0.0, 40.0, ROWS))

    with pytest.warns(UserWarning, match="kp of the recording changes from 0 to 40") as warned:
        log = mp.load_log(path, columns=columns, settings=mp.LogSettings(kp=40.0, kd=1.0))

    assert log.logged_kp is not None
    assert np.all(log.logged_kp == 40.0)
    assert not [item for item in warned if "kd of the recording" in str(item.message)]


def test_gains_of_a_joint_are_elements_of_an_array(tmp_path: Path):
    path = tmp_path / "run.npz"
    motion = np.tile(np.sin(5.0 * TIME)[:, None], (1, 2))
    np.savez(path, t=TIME, goal=motion, pos=motion - 0.01, kp=[40.0, 80.0], kd=[1.0, 2.0])
    text = (
        'motor = "drive"\ntime = "t"\nposition_target = "goal[{joint}]"\n'
        'joint_pos = "pos[{joint}]"\nkp = "kp[{joint}]"\nkd = "kd[{joint}]"\n'
        "[joints.0]\n[joints.1]\n"
    )

    log = mp.read_log(path, columns=map_of(tmp_path, text))

    assert log.gains is not None
    np.testing.assert_array_equal(log.gains, [[40.0, 80.0], [1.0, 2.0]])


@pytest.mark.parametrize(("shipped", "joints"), [("go2_tensors", 12), ("z1_tensors", 7)])
def test_shipped_maps_of_tensors_take_gains_from_the_file(
    tmp_path: Path, shipped: str, joints: int
):
    path = tmp_path / "run.npz"
    motion = np.tile(np.sin(5.0 * TIME)[:, None], (1, joints))
    kp = np.linspace(15.0, 60.0, joints)
    kd = np.linspace(0.5, 3.0, joints)
    np.savez(
        path, time=TIME, des_dof_pos=motion, dof_pos=motion - 0.01, dof_vel=motion, kp=kp, kd=kd
    )

    log = mp.read_log(path, columns=shipped)

    assert log.gains is not None
    np.testing.assert_array_equal(log.gains, [kp, kd])


def test_gains_of_a_file_that_its_map_ignores_are_a_warning(tmp_path: Path):
    path = tmp_path / "run.npz"
    motion = np.sin(5.0 * TIME)
    np.savez(path, t=TIME, goal=motion, pos=motion - 0.01, kp=[20.0], kd=[1.5], skpd=[1.0])
    columns = map_of(tmp_path, HEAD + 'position_target = "goal"\n' + JOINT + "kp = 25\nkd = 1\n")

    with pytest.warns(UserWarning, match="map.toml ignores gains of the file: kp ->"):
        log = mp.load_log(path, columns=columns)

    assert log.gains is not None
    assert log.gains[0] == 25.0

    table_path = tmp_path / "run.csv"
    rows = np.column_stack([TIME, motion, motion - 0.01, np.full(ROWS, 1.5)])
    np.savetxt(table_path, rows, delimiter=",", header="t,goal,pos,Kd_hip", comments="")

    with pytest.warns(UserWarning, match="ignores gains of the file: Kd_hip -> .* by kd"):
        mp.load_log(table_path, columns=columns)


@pytest.mark.parametrize("shape", [(), (1,)])
def test_a_gain_of_an_array_may_be_one_number(tmp_path: Path, shape: tuple[int, ...]):
    path = tmp_path / "run.npz"
    motion = np.sin(5.0 * TIME)
    kp = np.full(shape, 40.0)
    np.savez(path, t=TIME, goal=motion, pos=motion - 0.01, p=kp, d=np.full(shape, 2.0))
    text = HEAD + 'position_target = "goal"\n' + GAINS + JOINT

    log = mp.read_log(path, columns=map_of(tmp_path, text))

    np.testing.assert_array_equal(log.gains, [[40.0], [2.0]])


def test_a_map_without_any_command_is_refused(tmp_path: Path):
    with pytest.raises(ArtifactError, match="no command") as refused:
        mp.read_log(table(tmp_path), columns=map_of(tmp_path, HEAD + JOINT))

    assert "torque_feedforward" in str(refused.value.remedy)


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        ({"command_mode": "position"}, "velocity_target"),
        ({"command_mode": "velocity"}, "logged_kp"),
        ({"command_mode": "torque"}, "velocity_target"),
        ({"command_mode": "current"}, "current"),
    ],
)
def test_channels_that_do_not_fit_the_command_mode_are_refused(
    fields: dict[str, object], named: str
):
    with pytest.raises(LogError, match=named):
        mit_log(**fields)


def test_a_log_in_mit_mode_survives_its_file(tmp_path: Path):
    log = mit_log()
    write_log(tmp_path / "log.parquet", log)
    read = read_parquet(tmp_path / "log.parquet")

    assert read.command_mode == "mit"
    for name in ("velocity_target", "torque_feedforward", "logged_kp", "logged_kd"):
        np.testing.assert_array_equal(getattr(read, name), getattr(log, name))


def test_on_a_grid_gains_are_held_and_commands_are_means():
    log = mit_log(torque_feedforward=(TIME >= 0.011)[:, None].astype(float))
    step = np.where(TIME >= 0.011, 40.0, 10.0)[:, None]

    grid = resample(replace(log, logged_kp=step), 0.005)

    assert grid.logged_kp is not None
    assert grid.torque_feedforward is not None
    assert set(grid.logged_kp.ravel()) == {10.0, 40.0}
    # the command of 12 ms holds for 3 of the 5 ms from 10 ms on
    assert grid.torque_feedforward[2, 0] == pytest.approx(0.6)


def test_logs_of_all_modes_are_joined_at_the_gains_of_their_rows():
    shape = (ROWS, 1)
    stated = {"logged_kp": np.full(shape, 40.0), "logged_kd": np.ones(shape)}
    none = dict.fromkeys(("velocity_target", "torque_feedforward", "logged_kp", "logged_kd"))
    torque = {"command_mode": "torque", "torque_feedforward": np.ones(shape)}
    speed = {"command_mode": "velocity", "velocity_target": np.ones(shape)}
    logs = [
        mit_log(),
        mit_log(velocity_target=None),
        mit_log(**none | stated | {"command_mode": "position"}),
        mit_log(**none | torque),
        mit_log(**none | speed | {"logged_kd": np.full(shape, 3.0)}),
    ]

    whole = joined(logs)

    factors = np.array([gain_factors(segment)[:, -1, 0] for segment in whole.segments()])
    assert whole.command_mode == "mit"
    np.testing.assert_array_equal(factors, [[1, 1], [1, 1], [1, 1], [0, 0], [0, 1]])
    np.testing.assert_array_equal(whole.gains, [[40.0], [1.0]])
    assert whole.velocity_target is not None
    assert not whole.velocity_target[ROWS : 4 * ROWS].any()


def test_logs_in_mit_mode_measure_the_scale_of_the_velocity_gain():
    assert unmeasured_scales("torque", "mit") == "position gains and velocity gains"
    assert not unmeasured_scales("mit", "velocity")


def test_torque_and_velocity_commands_are_joined_as_velocity_commands():
    none = dict.fromkeys(("velocity_target", "torque_feedforward", "logged_kp", "logged_kd"))
    column = np.ones((ROWS, 1))
    torque = mit_log(**none | {"command_mode": "torque", "torque_feedforward": column})
    speed = {"command_mode": "velocity", "velocity_target": column, "logged_kd": column}

    whole = joined([torque, mit_log(**none | speed)])

    assert whole.command_mode == "velocity"
    assert [gain_factors(part)[1, 0, 0] for part in whole.segments()] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("modes", "missing"),
    [
        (("position", "torque"), "kp and kd"),
        (("position", "velocity"), "kp and kd"),
        (("mit", "torque"), "kp and kd"),
        (("velocity", "torque"), "kd"),
    ],
)
def test_logs_of_other_modes_need_the_gains_that_are_0_in_some(
    modes: tuple[str, str], missing: str
):
    none = dict.fromkeys(("velocity_target", "torque_feedforward", "logged_kp", "logged_kd"))
    column = np.ones((ROWS, 1))
    commands = {
        "position": {},
        "mit": {"velocity_target": column},
        "velocity": {"velocity_target": column},
        "torque": {"torque_feedforward": column},
    }
    logs = [mit_log(**none | commands[mode] | {"command_mode": mode}) for mode in modes]

    with pytest.raises(LogError) as refused:
        joined(logs)

    assert f"{' and '.join(modes)} commands, and no log has {missing}" in str(refused.value)
    assert str(refused.value.remedy).startswith(f"give {missing} of every log that uses them")


def test_position_and_mit_commands_need_no_gains():
    none = dict.fromkeys(("torque_feedforward", "logged_kp", "logged_kd"))
    position = mit_log(**none | {"velocity_target": None, "command_mode": "position"})

    assert joined([position, mit_log(**none)]).command_mode == "mit"


def test_a_log_without_gains_is_not_joined_to_a_log_with_gains():
    position = log_of(TIME, np.sin(5.0 * TIME), joint_names=("b",))
    with pytest.raises(LogError, match="logged_kp"):
        joined([mit_log(), checked(position)])


def test_a_passive_joint_is_read_in_the_mode_of_the_robot(tmp_path: Path):
    path = tmp_path / "run.npz"
    motion = np.tile(np.sin(5.0 * TIME)[:, None], (1, 2))
    kp = np.tile([40.0, 0.0], (ROWS, 1))
    feedforward = 0.1 * motion
    np.savez(path, t=TIME, goal=motion, pos=motion - 0.01, tau=feedforward, kp=kp, kd=[1.0, 2.0])
    text = (
        'motor = "drive"\ntime = "t"\nposition_target = "goal[{joint}]"\n'
        'joint_pos = "pos[{joint}]"\nkp = "kp[{joint}]"\nkd = "kd[{joint}]"\n'
        'torque_feedforward = "tau[{joint}]"\n[joints.0]\n[joints.1]\n'
    )

    log = mp.read_log(path, columns=map_of(tmp_path, text))

    assert log.command_mode == "mit"
    np.testing.assert_array_equal(commands_angles(log), [True, False])
    np.testing.assert_array_equal(gain_factors(log)[:, 0], [[1.0, 0.0], [1.0, 1.0]])
    # its position target is its angle, which must not look like a copied channel
    assert not [finding for finding in check_log(log).findings if finding.check == "copied"]


def test_a_log_names_its_joints_whose_commands_were_sent_faster_than_logged(tmp_path: Path):
    time = 0.005 * np.arange(4000)
    sent = 0.4 * np.sin(2.0 * np.pi * 0.7 * time) + 0.3 * np.sin(2.0 * np.pi * 1.3 * time + 1.0)
    angle = np.zeros_like(sent)
    speed = 0.0
    for row in range(1, len(sent)):
        speed += 0.005 * (200.0 * (sent[row - 1] - angle[row - 1]) - 20.0 * speed)
        angle[row] = angle[row - 1] + 0.005 * speed
    held = np.repeat(sent[::10], 10)
    rows = np.column_stack([time, held, sent, angle, angle])
    path = tmp_path / "run.csv"
    header = "t,goal_a,goal_b,pos_a,pos_b"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    columns = map_of(
        tmp_path,
        'motor = "drive"\ntime = "t"\nposition_target = "goal_{joint}"\n'
        'joint_pos = "pos_{joint}"\n[joints.a]\n[joints.b]\n',
    )

    with pytest.warns(UserWarning, match="command of a changes every 50 ms"):
        log = mp.load_log(path, columns=columns)
    write_log(tmp_path / "log.parquet", log)
    read = read_parquet(tmp_path / "log.parquet")

    assert read.slow_commands == {"a": pytest.approx(0.05)}
    assert not read.joint(1).slow_commands
