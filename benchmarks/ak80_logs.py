"""Logs of T-Motor AK80-6 drives, in a form that a column map can describe.

`ak80_logs` writes tables, column maps and the model of a robot. The originals are

    pd_system_identification_*, fft_*   dfki-ric-underactuated-lab/torque_limited_simple_pendulum
    design_C.0_*                        dfki-ric-underactuated-lab/double_pendulum

The first two are pairs of desired and measured values of a pendulum in MIT mode, without gains. The
first is read with the gains GAINS of its authors' settings. The second contradicts these gains, so
it is read without any. The third is a double pendulum under torque control.
"""

from pathlib import Path

import numpy as np

from figures import import_log
from motorprior.artifacts import write_text

GRAVITY = 9.81  # [m/s²]
# of the pendulum, in the settings of its trajectories
MASS = 0.6755  # [kg]
LENGTH = 0.5  # [m]
GAINS = "kp = 50.0\nkd = 4.0\n"
INERTIA = 0.139625  # [kg·m²]
PENDULUM_HEADER = ("t", "q_des", "dq_des", "tau_des", "q", "inertia", "gravity", "stiffness")
PENDULUM_MAP = """motor = "AK80-6"
time = "t"
position_target = "q_des"
velocity_target = "dq_des"
torque_feedforward = "tau_des"
joint_pos = "q"
load_inertia = "inertia"
external_torque = "gravity"
load_stiffness = "stiffness"
posture = "fixed"
[joints.pendulum]
"""
DOUBLE_MAP = """motor = "AK80-6"
robot = "double_pendulum"
time = "time"
torque_feedforward = "tau_con{joint}"
joint_pos = "pos_meas{joint}"
posture = "fixed"
[joints.1]
name = "shoulder"
[joints.2]
name = "elbow"
"""
ROBOT = """name = "double_pendulum"
motor = "AK80-6"
model = "double_pendulum.xml"
base = "fixed"
actuators = "remove"
nominal_pose = 0.0
joint_classes = ["shoulder", "elbow"]
kp = 50.0
kd = 4.0
torque_limit = 12.0
"""
# The parameters that its authors identified (design_C.0/model_3.0). Their mass and centre of the
# second link give a negative inertia; these masses and centres have the same dynamics.
MODEL = """<mujoco model="double_pendulum">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="upper">
      <inertial pos="0 0 -0.2" mass="0.5808917" diaginertia="0.001043 0.001043 0.001043"/>
      <joint name="shoulder" axis="0 1 0" range="-7 7"/>
      <body name="lower" pos="0 0 -0.2">
        <inertial pos="0 0 -0.29" mass="0.624738" diaginertia="0.0013376 0.0013376 0.0013376"/>
        <joint name="elbow" axis="0 1 0" range="-7 7"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def ak80_logs(folder: Path, out: Path) -> dict[str, Path]:
    """Motor logs with loads, by name of the log, from the raw logs in ``folder``."""
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "pendulum_pd.toml", PENDULUM_MAP + GAINS)
    write_text(out / "pendulum_fft.toml", PENDULUM_MAP)
    write_text(out / "double_pendulum_map.toml", DOUBLE_MAP)
    write_text(out / "double_pendulum.toml", ROBOT)
    write_text(out / "double_pendulum.xml", MODEL)

    paths = {}
    for name, pair in {
        "pendulum_pd": "pd_system_identification_{}.csv",
        "pendulum_fft": "fft_{}.csv.gz",
    }.items():
        table = out / f"{name}.csv"
        _write_pendulum(folder, pair, table)
        paths[name] = _imported(table, out / f"{name}.toml", None)
    raw = next(folder.glob("design_C.0_*.csv.gz"))
    columns = out / "double_pendulum_map.toml"
    paths["double_pendulum"] = _imported(raw, columns, out / "double_pendulum.toml")
    return paths


def _write_pendulum(folder: Path, pair: str, path: Path) -> None:
    """Write one table of a pair of desired and measured values, with the load of the pendulum."""
    desired = np.genfromtxt(folder / pair.format("desired"), delimiter=",", skip_header=1)
    measured = np.genfromtxt(folder / pair.format("measured"), delimiter=",", skip_header=1)
    # the last four columns are time, position, velocity, torque
    time, angle = measured[:, -4:-2].T
    weight = MASS * GRAVITY * LENGTH
    inertia = np.full_like(angle, INERTIA)
    load = (inertia, -weight * np.sin(angle), -weight * np.cos(angle))
    rows = np.column_stack([time, desired[:, -3:], angle, *load])
    np.savetxt(path, rows, delimiter=",", header=",".join(PENDULUM_HEADER), comments="")


def _imported(raw: Path, columns: Path, robot: Path | None) -> Path:
    path = columns.with_name(f"{raw.name.split('.')[0]}.parquet")
    import_log(raw, path, columns, robot)
    return path
