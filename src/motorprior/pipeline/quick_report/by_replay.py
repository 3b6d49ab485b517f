"""Quick report of logs of a robot on its feet or in the air: its commands on a simulated robot with known motors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.bench.fleet import Fleet
from motorprior.logs.doctor.excitation import excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.motor_choice import nominal_pd
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.quick_report.findings import Errors, Findings
from motorprior.pipeline.validation.log_stretches import awake
from motorprior.report.real_motor_tables import RMSE, Trace
from motorprior.robots.robot import Robot
from motorprior.transfer.log_replay import LogReplay, Replayer, prepare, with_logged_gains
from motorprior.transfer.posture import PostureName, replayers_of

DRAWS = 20
"""Robots drawn from the fleet."""
LONGEST = 120.0
"""Replayed of all logs together [s], each from its beginning."""
BAND = (0.05, 0.95)


def report_by_replay(
    logs: Mapping[str, MotorLog], robot: Robot, fleet: Fleet, posture: PostureName, seed: int, progress: Progress
) -> Findings:
    """Replay on an ideal PD, on the fleet's central motor and on draws of it.

    Args:
        logs: of the robot, by name, as they were recorded.
        robot: that they are of, with a free base.
        fleet: of its motors.
        posture: of all logs, or "auto".
        seed: of the draws.
        progress: where to report to.

    Raises:
        LogError: a log that cannot be replayed.
    """
    logs = {name: beginning(log, LONGEST / len(logs)) for name, log in logs.items()}
    prepared = {name: prepare(log, robot, f"{log.source}, log {name}") for name, log in logs.items()}
    replayers = replayers_of(logs, prepared, robot, fleet, posture, progress.note)
    rng, joints = np.random.default_rng(seed), robot.num_joints
    pd, center = nominal_pd(fleet, joints), fleet.center(joints)
    draws = [fleet.sample(joints, rng) for _ in range(DRAWS)]
    found: dict[str, dict[str, list[LogReplay]]] = {}
    with progress.start(f"replay of {len(logs)} logs", len(logs)) as task:
        for name, replayer in replayers.items():
            log = replayer.prepared
            models = {
                "ideal_pd": [with_logged_gains(pd, log)],
                "physical": [with_logged_gains(center, log).actuator()],
                "physical_draws": [with_logged_gains(motors, log).actuator() for motors in draws],
            }
            found[name] = {model: [replayer.run(motors) for motors in each] for model, each in models.items()}
            task.advance()
    return _findings(found, replayers, robot, fleet)


def beginning(log: MotorLog, seconds: float) -> MotorLog:
    """Rows until the recorded time of ``seconds``, pauses included; if nothing moves in them, from where it does."""
    found = log.rows(slice(0, max(2, int(np.searchsorted(log.time, log.time[0] + seconds)))))
    moving = awake(log)
    if excited_joints(found).size or moving.num_rows == log.num_rows:
        return found
    return beginning(moving, seconds)


def _findings(
    found: dict[str, dict[str, list[LogReplay]]], replayers: Mapping[str, Replayer], robot: Robot, fleet: Fleet
) -> Findings:
    models = {
        model: np.stack([np.median([run.rmse for run in runs[model]], axis=0) for runs in found.values()])
        for model in next(iter(found.values()))
    }
    errors = Errors(tuple(found), robot.joint_names, models)
    places = list(dict.fromkeys((errors.typical("physical"), errors.worst("physical"))))
    traces = tuple(_trace(errors, replayers, found, *place) for place in places)
    told = f"replayed on a simulated {robot.name}, motors of fleet {fleet.name!r}; {errors.compared()}"
    return Findings((told, errors.unlike("physical"), _outside(found, replayers, robot)), errors.rows(RMSE), traces)


def _outside(found: dict[str, dict[str, list[LogReplay]]], replayers: Mapping[str, Replayer], robot: Robot) -> str:
    """A sentence: which joint leaves the band of the fleet's draws most of the time."""
    inside: dict[tuple[str, str], float] = {}
    for log, runs in found.items():
        replayer = replayers[log]
        low, high = np.quantile([run.joint_pos for run in runs["physical_draws"]], BAND, axis=0)
        held = (replayer.prepared.joint_pos >= low) & (replayer.prepared.joint_pos <= high)
        for joint in replayer.excited:
            inside[log, robot.joint_names[joint]] = float(held[replayer.compared, joint].mean())
    (log, joint), share = min(inside.items(), key=lambda item: item[1])
    return (
        f"{100 * np.mean(list(inside.values())):.0f} % of what was recorded is within 90 % of that fleet's draws; "
        f"least is {joint} in {log} with {100 * share:.0f} %"
    )


def _trace(
    errors: Errors,
    replayers: Mapping[str, Replayer],
    found: dict[str, dict[str, list[LogReplay]]],
    log: int,
    joint: int,
) -> Trace:
    name = errors.logs[log]
    prepared = replayers[name].prepared
    first = prepared.rows(prepared.segment_slices()[0])
    rows = slice(0, first.num_rows)
    models = {model: found[name][model][0].joint_pos[rows, joint] for model in ("ideal_pd", "physical")}
    target, measured = first.position_target[:, joint], first.joint_pos[:, joint]
    return Trace(name, errors.joints[joint], first.time, target, measured, models)
