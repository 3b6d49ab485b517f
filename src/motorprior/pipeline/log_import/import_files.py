"""Files that an import writes: their names, which are no recording's own, and a line about what each holds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.logs.formats.parquet_io import has_loads
from motorprior.logs.formats.registry import recording_name
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.stated import stated_in_words
from motorprior.pipeline.progress import Progress

_MOST_NAMED = 8
"""Joints in a line."""


def targets_of(paths: Sequence[Path], out: Path) -> dict[Path, Path]:
    """The .parquet that every log becomes -> the log.

    Raises:
        ConfigError: two logs would become one file, or a file would take the place of a recording, or of a file of one.
    """
    targets: dict[Path, Path] = {}
    for path in paths:
        target = out / f"{recording_name(path)}.parquet"
        if target in targets:
            raise ConfigError(f"it and {targets[target]} would both become {target}", where=path, remedy="rename one")
        targets[target] = path
    for target in targets:
        for path in paths:
            if _is_of(target, path):
                raise ConfigError(
                    "out: the import would overwrite the recording", where=target,
                    remedy="give another folder", argument="out",
                )  # fmt: skip
    return targets


def _is_of(target: Path, path: Path) -> bool:
    """Whether a file that is there is a recording, or belongs to one that is a folder."""
    if not target.exists():
        return False
    if path.is_dir():
        return target.resolve().is_relative_to(path.resolve())
    return path.exists() and os.path.samefile(target, path)


def summary(log: MotorLog) -> str:
    """Rows, seconds, rate, joints, and the range of commands and angles in degrees, in which wrong units are seen."""
    rate = 1.0 / log.period
    segments = len(log.segment_slices())
    names = ", ".join(log.joint_names[:_MOST_NAMED]) + (", …" if log.num_joints > _MOST_NAMED else "")
    parts = [f"{log.num_rows} rows", f"{log.duration:.4g} s", f"{rate:.4g} Hz"]
    parts += [f"{segments} segments"] if segments > 1 else []
    ranges = [
        f"{word} from {low:.1f} to {high:.1f}°"
        for word, values in (("commands", log.position_target), ("angles", log.joint_pos))
        for low, high in (np.rad2deg([values.min(), values.max()]),)
    ]
    return ", ".join([*parts, f"{log.num_joints} joints ({names})", *ranges])


def tell_replaced(target: Path, log: MotorLog, progress: Progress) -> None:
    """Say, before a log is written, that an earlier import with loads goes, and that this one has none."""
    if log.load_inertia is None and target.is_file() and has_loads(target):
        progress.note(f"{target}: takes the place of an earlier import that had loads; this one has none")


def tell(target: Path, log: MotorLog, progress: Progress) -> None:
    """What an imported file holds, and what it states: a line each."""
    progress.note(f"{target}: {summary(log)}")
    progress.note(f"{target}: states {stated_in_words(log) or 'no gain, register, condition or posture'}")
