"""Quick report of logs of a robot whose loads are unknown: replayed in simulation with the motors of its fleet."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.bench.fleet import Fleet
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.log_errors import LogErrors
from motorprior.pipeline.motor_choice import nominal_pd
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.quick_report.fitted_models import QuickReport
from motorprior.pipeline.replay.log_postures import PostureName, replayers_of
from motorprior.pipeline.validation.log_splits import moving_part
from motorprior.report.log_tables import WHOLE_RUN, Trace
from motorprior.robots.robot import Robot
from motorprior.transfer.log_replay import LogReplay, prepare, with_logged_gains

SAMPLES = 20  # robots drawn from the fleet
SECONDS = 120.0  # of all logs together, each from its beginning


def report_by_replay(
    logs: Mapping[str, MotorLog], robot: Robot, fleet: Fleet, posture: PostureName, seed: int, progress: Progress
) -> QuickReport:
    """Replay on an ideal PD, on the fleet's central motor, and on samples of the fleet (median of their errors).

    Args:
        logs: recorded on the robot, by name.
        robot: with a free base.
        fleet: of its motors.
        posture: of all logs, or "auto".
        seed: of the samples.
        progress: where to report to.

    Raises:
        LogError: a log that cannot be replayed.
    """
    logs = {name: beginning(log, SECONDS / len(logs)) for name, log in logs.items()}
    prepared = {name: prepare(log, robot, f"{log.source}, log {name}") for name, log in logs.items()}
    replayers = replayers_of(logs, prepared, robot, fleet, posture, progress)
    rng, joints = np.random.default_rng(seed), robot.num_joints
    pd, center = nominal_pd(fleet, joints), fleet.center(joints)
    samples = [fleet.sample(joints, rng) for _ in range(SAMPLES)]
    found: dict[str, dict[str, list[LogReplay]]] = {}
    with progress.start(f"replay of {len(logs)} logs", len(logs)) as task:
        for name, replayer in replayers.items():
            log = replayer.prepared
            models = {
                "ideal_pd": [with_logged_gains(pd, log)],
                "physical": [with_logged_gains(center, log).actuator()],
                "physical_draws": [with_logged_gains(motors, log).actuator() for motors in samples],
            }
            found[name] = {model: [replayer.run(motors) for motors in each] for model, each in models.items()}
            task.advance()
    tables = {
        model: np.stack([np.median([run.rmse for run in runs[model]], axis=0) for runs in found.values()])
        for model in ("ideal_pd", "physical", "physical_draws")
    }
    errors = LogErrors(tuple(found), robot.joint_names, tables)
    traces = []
    for place, joint in errors.median_and_max("physical"):
        name = errors.logs[place]
        log = replayers[name].prepared
        first = log.rows(log.segment_slices()[0])
        runs = {model: found[name][model][0] for model in ("ideal_pd", "physical")}
        simulated = {model: run.joint_pos[: first.num_rows, joint] for model, run in runs.items()}
        target, measured = first.position_target[:, joint], first.joint_pos[:, joint]
        traces.append(Trace(name, robot.joint_names[joint], first.time, target, measured, simulated))
    line = f"replayed on a simulated {robot.name} with motors of fleet {fleet.name!r} (physical: its central motor)"
    return QuickReport((line,), errors.results(WHOLE_RUN), tuple(traces))


def beginning(log: MotorLog, seconds: float) -> MotorLog:
    """Rows until the recorded time of ``seconds``, pauses included, from the first motion if none is earlier."""
    found = log.rows(slice(0, max(2, int(np.searchsorted(log.time, log.time[0] + seconds)))))
    moving = moving_part(log)
    if excited_joints(found).size or moving.num_rows == log.num_rows:
        return found
    return beginning(moving, seconds)
