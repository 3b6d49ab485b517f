"""Replay of exported motors next to our own, which gives the loss of a format.

The replay simulates one hinge in closed loop on two loads. With the motors' median armature a, the
shank has the inertia 0.1·a and the leg 1.25·a. Both have the gravity of a pendulum of 0.1 m,
linearised at 45°. For the shipped robot's motors (a = 0.0032 kg·m²) these are its bare shank and
its leg. Motors of velocity or torque commands get the targets times VELOCITY_PER_TARGET, or times
the stiffness of gravity.
"""

import numpy as np

from motorprior.actuator.command_frame import Frames
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.bench.dynamometer import Trial, run, trial_of
from motorprior.exceptions import LogError
from motorprior.excitation.hand_made import zero_order_hold
from motorprior.excitation.registry import EXCITATIONS
from motorprior.exports.exporter import ReplayFunction
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import resample
from motorprior.signals import rmse

MAX_STEP = 0.002  # largest physics step of the replay [s]
# trial -> load inertia over the median armature [-], and signals in turn for the motors; steps
# reach the torque limit
TRIALS = {
    "leg": (1.25, ("gait", "sine")),
    "shank": (0.1, ("gait", "sine")),
    "leg_steps": (1.25, ("steps",)),
}
# torque of gravity, and its change with the angle, over the load inertia [1/s²]
GRAVITY_PER_INERTIA = 0.7 * 98.0
VELOCITY_PER_TARGET = 5.0  # [1/s]
SECONDS = 3.0  # duration of a trial [s]
HOLD = 0.01  # duration of each target: the period of a 100 Hz policy [s]
_SEED = 54


def constants(motors: GreyBoxActuator, dt: float) -> dict[str, np.ndarray]:
    """(n,) constants by name, with kd = kp·kd_over_kp [N·m·s/rad] in place of kd_over_kp.

    ``friction`` is the dry friction with its load-dependent part at the mean absolute torque on the
    leg [N·m]. kp is 0 for velocity commands; kp and kd are 0 for torque commands.
    """
    values = motors.constants()
    values["kd"] = values["kp"] * values.pop("kd_over_kp")
    if motors.command_mode in ("velocity", "torque"):
        values["kp"] = np.zeros(motors.num_motors)
    if motors.command_mode == "torque":
        values["kd"] = np.zeros(motors.num_motors)
    torque = run(motors, replay_trial("leg", motors, dt)).joint_torque
    mean_torque = np.abs(torque).mean(axis=0)
    values["friction"] = values["coulomb"] + values["load_friction"] * mean_torque
    return values


def losses(
    replay: ReplayFunction, motors: GreyBoxActuator, dt: float, log: Trial | None = None
) -> dict[str, float]:
    """RMSE over all motors of the exported against our own joint angles [rad].

    Keys are the names in TRIALS, and "log" if the trial of a log is given.
    """
    values = constants(motors, dt)
    trials = {name: replay_trial(name, motors, dt) for name in TRIALS}
    if log is not None:
        trials["log"] = log

    errors = {}
    for name, trial in trials.items():
        exported = replay(values, trial)
        errors[name] = float(rmse(exported, run(motors, trial).joint_pos))
    return errors


def replay_trial(name: str, motors: GreyBoxActuator, dt: float) -> Trial:
    """One of TRIALS for these motors, at steps of ``dt`` [s]."""
    load, signal_names = TRIALS[name]
    rng = np.random.default_rng(_SEED)
    steps = round(SECONDS / dt)
    num_motors = motors.num_motors

    targets = []
    for motor in range(num_motors):
        signal = EXCITATIONS[signal_names[motor % len(signal_names)]].target
        targets.append(zero_order_hold(signal(rng, steps, dt), round(HOLD / dt)))

    inertia = np.full(num_motors, load * float(np.median(motors.constants()["armature"])))
    weight = np.tile(-GRAVITY_PER_INERTIA * inertia, (steps, 1))
    target = np.stack(targets, axis=1)
    frames = {
        "velocity": Frames(velocity_target=VELOCITY_PER_TARGET * target),
        "torque": Frames(torque_feedforward=-weight * target),
    }.get(motors.command_mode)
    return Trial(target, weight, inertia, dt, load_stiffness=weight, frames=frames)


def log_trial(log: MotorLog, robots: int, dt: float) -> Trial:
    """Commands and loads of a log's longest segment, robot after robot.

    Of commands in MIT mode, the position targets are used.

    Raises LogError for a log without loads.
    """
    if log.load_inertia is None or log.external_torque is None:
        raise LogError(
            "no loads", where=log.source, remedy="import it with loads (docs/your-motors.md)"
        )
    segment = max(log.segments(), key=lambda segment: segment.num_rows)
    trial = trial_of(resample(segment, dt))
    stiffness = trial.load_stiffness
    if stiffness is None:
        stiffness = np.zeros_like(trial.external_torque)

    frames = None
    if log.command_mode in ("velocity", "torque"):
        assert trial.frames is not None
        frames = Frames(*(np.tile(values, robots) for values in trial.frames))

    return Trial(
        np.tile(trial.position_target, robots),
        np.tile(trial.external_torque, robots),
        np.tile(trial.load_inertia, robots),
        dt,
        load_stiffness=np.tile(stiffness, robots),
        frames=frames,
    )
