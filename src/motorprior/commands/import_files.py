"""Output files of an import: names, and messages about their content."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError, listed
from motorprior.logs.formats.registry import recording_name
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.settings_text import settings_text
from motorprior.progress import Progress


def targets_of(paths: Sequence[Path], out: Path) -> dict[Path, Path]:
    """Output file (.parquet) -> log file.

    Raises:
        ConfigError: two logs with one output file, or an output file that would overwrite a recording.
    """
    targets: dict[Path, Path] = {}
    for path in paths:
        target = out / f"{recording_name(path)}.parquet"
        if target in targets:
            raise ConfigError(f"it and {targets[target]} would both become {target}", where=path, remedy="rename one")
        targets[target] = path
    for target in targets:
        if target.exists() and any(_belongs_to(target, path) for path in paths):
            problem = "out: the import would overwrite the recording"
            raise ConfigError(problem, where=target, remedy="give another folder", argument="out")
    return targets


def _belongs_to(target: Path, path: Path) -> bool:
    """Whether a file is a recording, or lies in the folder of one."""
    if path.is_dir():
        return target.resolve().is_relative_to(path.resolve())
    return path.exists() and os.path.samefile(target, path)


def summary(log: MotorLog) -> str:
    """Rows, seconds, rate, joints, and the ranges of commands and angles in degrees, which reveal wrong units."""
    segments = len(log.segment_slices())
    parts = [f"{log.num_rows} rows", f"{log.duration:.4g} s", f"{1.0 / log.period:.4g} Hz"]
    parts += [f"{segments} segments"] if segments > 1 else []
    parts += [f"{log.num_joints} joints ({listed(log.joint_names, 8)})"]
    for name, values in (("commands", log.position_target), ("angles", log.joint_pos)):
        low, high = np.rad2deg([values.min(), values.max()])
        parts.append(f"{name} from {low:.1f} to {high:.1f}°")
    return ", ".join(parts)


def report(target: Path, log: MotorLog, progress: Progress) -> None:
    """Report an imported file in two lines: its content, and the settings that it records."""
    progress.note(f"{target}: {summary(log)}")
    progress.note(f"{target}: records {settings_text(log) or 'no gain, register, condition or posture'}")
