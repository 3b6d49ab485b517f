"""Real Pupper logs against simulated motors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.physical import PhysicalActuator
from motorprior.artifacts import write_json, write_tensors
from motorprior.bounds import require_count, require_seed
from motorprior.logs.checks import check_log
from motorprior.logs.joint_checks import excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.pupper_import import read_pupper_logs
from motorprior.pipeline.motor_choice import load_prior, load_robot_fleet, nominal_pd
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import description, fleet_files, is_finished, read_figures, working
from motorprior.robots.pupper_v2 import spec
from motorprior.transfer.real_replay import LogReplay, prepare, replay_log

FIGURES, TRACES = "figures.json", "traces.safetensors"


@dataclass(frozen=True)
class Replay:
    """Replay the commands of real Pupper v2 logs on simulated motors and compare the joint angles."""

    logs: Path
    """Folder with the logs: the original pickles of jietan/puppersim, puppersim/data/system_id, or CSV."""
    prior: Path
    """Prior whose draws are replayed."""
    out: Path
    """Folder for figures.json and the traces of the report."""
    fleet: str = "pupper_v2"
    """Fleet whose central motor is replayed, and whose nominal gains the ideal PD gets."""
    draws: int = 20
    """Draws of twelve motors from the prior."""
    seed: int = 0
    """Draws the motors."""


def run_replay(config: Replay, progress: Progress = SILENT) -> dict[str, float]:
    """Check and replay, or read what this very replay found; returns the figures.

    Raises:
        LogError, ArtifactError, ConfigError: a log, prior, fleet or setting that cannot be used.
    """
    require_count("draws", config.draws)
    require_seed(config.seed)
    load_robot_fleet(config.fleet)
    logs, prepared = read_logs(config.logs)
    for name, log in logs.items():
        _note_findings(name, log, progress)
    prior = load_prior(config.prior)
    files = sorted(path for path in config.logs.iterdir() if path.is_file())
    wanted = description("replay", asdict(config), [config.prior, *fleet_files(config.fleet), *files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            _replay_all(config, logs, prepared, prior, progress)
    return read_figures(config.out / FIGURES)


def read_logs(folder: Path) -> tuple[dict[str, MotorLog], dict[str, MotorLog]]:
    """Every log of a folder by its short name, as it is and without repeated measurements.

    Raises:
        LogError: a log that cannot be read or replayed.
    """
    logs = read_pupper_logs(folder)
    return logs, {name: prepare(log, f"{folder}, log {name}") for name, log in logs.items()}


def _note_findings(name: str, log: MotorLog, progress: Progress) -> None:
    for finding in check_log(log, spec.JOINT_LIMITS).findings:
        if finding.severity != "info":
            progress.note(f"log {name}: {finding.severity}: {finding.message}")


def _replay_all(
    config: Replay, logs: dict[str, MotorLog], prepared: dict[str, MotorLog], prior: MotorPrior, progress: Progress
) -> None:
    figures: dict[str, float] = {}
    traces: dict[str, np.ndarray] = {}
    with progress.start(f"replay of {len(logs)} real logs", len(logs) * (2 + 2 * config.draws)) as task:
        for name, log in logs.items():
            results = _replay_models(config, log, prepared[name], prior, task)
            figures |= _log_figures(name, prepared[name], results)
            traces |= _log_traces(name, prepared[name], results)
    write_json(config.out / FIGURES, figures)
    write_tensors(config.out / TRACES, traces, {"logs": sorted(logs), "prior": prior.preset})


def _replay_models(
    config: Replay, log: MotorLog, prepared: MotorLog, prior: MotorPrior, task: Task
) -> dict[str, list[LogReplay]]:
    fleet = load_robot_fleet(config.fleet)
    rng = np.random.default_rng(config.seed)
    models: dict[str, list[Actuator]] = {
        "ideal_pd": [nominal_pd(fleet, spec.NUM_JOINTS)],
        "physical": [PhysicalActuator(fleet.center(spec.NUM_JOINTS))],
        "physical_draws": [PhysicalActuator(fleet.sample(rng, spec.NUM_JOINTS)) for _ in range(config.draws)],
        prior.preset: [prior.sample(rng, spec.NUM_JOINTS) for _ in range(config.draws)],
    }
    results: dict[str, list[LogReplay]] = {}
    for name, actuators in models.items():
        for actuator in actuators:
            results.setdefault(name, []).append(replay_log(log, actuator, prepared))
            task.advance()
    return results


def _log_figures(name: str, log: MotorLog, results: dict[str, list[LogReplay]]) -> dict[str, float]:
    """Mean joint RMSE [rad] over excited joints, and per joint; draws by median, 5 % and 95 %."""
    figures: dict[str, float] = {}
    for model, runs in results.items():
        per_joint = np.array([run.rmse for run in runs])
        mean = np.nanmean(per_joint, axis=1)
        figures[f"real_rmse/{name}/{model}"] = float(np.median(mean))
        if len(runs) > 1:
            figures[f"real_rmse_p05/{name}/{model}"] = float(np.quantile(mean, 0.05))
            figures[f"real_rmse_p95/{name}/{model}"] = float(np.quantile(mean, 0.95))
        for joint in excited_joints(log):
            key = f"real_joint_rmse/{name}/{spec.JOINT_NAMES[joint]}/{model}"
            figures[key] = float(np.median(per_joint[:, joint]))
    return figures


def _log_traces(name: str, log: MotorLog, results: dict[str, list[LogReplay]]) -> dict[str, np.ndarray]:
    """The first excited knee (or joint) of a log, for the report; draws as median and 90 % band."""
    excited = excited_joints(log)
    knees = [joint for joint in excited if spec.JOINT_NAMES[joint].endswith("knee")]
    joint = int(knees[0] if knees else excited[0])
    traces = {
        f"{name}/joint": np.array(joint),
        f"{name}/time": log.time,
        f"{name}/target": log.position_target[:, joint],
        f"{name}/measured": log.joint_pos[:, joint],
    }
    for model, runs in results.items():
        curves = np.array([run.joint_pos[:, joint] for run in runs])
        traces[f"{name}/model/{model}"] = np.median(curves, axis=0)
        if model not in ("ideal_pd", "physical", "physical_draws"):
            traces[f"{name}/low"], traces[f"{name}/high"] = np.quantile(curves, [0.05, 0.95], axis=0)
    return traces
