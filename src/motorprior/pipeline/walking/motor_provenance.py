"""What a policy says about the motors that it was trained on: files by name and digest, never where on a disk they are.

Beside them stands the way from the policy's folder to the file, so that both can be moved together. It is looked for
there and in the policy's own folder; only a regular file of at most LARGEST_FILE bytes is opened, and only one of that
very digest is used.
"""

from __future__ import annotations

import os
from dataclasses import asdict, fields
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.pipeline.motor_choice import ACTUATORS, MotorChoice
from motorprior.pipeline.stage import digest
from motorprior.schema import TEXT, TRUTH, Schema, maybe, number, one_of

LARGEST_FILE = 64 * 2**20
"""Bytes of a prior, posterior or fleet that a policy names; they have some thousands."""
_LARGEST = 1e9
_SHOWN = 16
"""Characters of a digest in a message."""
_REMEDY = "train it again"
_FILES = ("prior", "posterior", "fleet")
_KEYS = tuple(f"{name}{ending}" for name in _FILES for ending in ("", "_beside", "_sha256"))
"""The file's name, or that of a shipped fleet; the way to it from the policy's folder; its SHA-256."""
_NEWER = ("coulomb", "spread", "latent_spread")
_CHOICE = Schema(
    {
        "actuator": one_of(*ACTUATORS),
        **dict.fromkeys(_KEYS, maybe(TEXT)),
        **dict.fromkeys(("kp", "kd", "torque_limit"), maybe(number(-_LARGEST, _LARGEST))),
        **dict.fromkeys(("armature", "delay", *_NEWER), number(-_LARGEST, _LARGEST)),
        "limit_follows_gain": TRUTH,
        "name": maybe(TEXT),
    },
    _REMEDY,
    optional=frozenset(
        {"fleet_beside", "fleet_sha256", "limit_follows_gain", "name", *_NEWER}
    ),  # policies of earlier versions lack them
    name="its motors",
)


def choice_as_json(choice: MotorChoice, folder: Path) -> dict[str, Any]:
    """For the provenance of a policy in ``folder``."""
    values = asdict(choice) | {key: None for key in _KEYS if key != "fleet"}
    for name in _FILES:
        file = getattr(choice, name)
        if isinstance(file, Path) or _is_file_name(file):
            path = Path(file)
            values[name] = path.name
            values[f"{name}_beside"] = _way(path.resolve(), folder.resolve())
            values[f"{name}_sha256"] = digest(path)
    return values


def choice_from_json(data: Any, policy: Path) -> MotorChoice:
    """Read what `choice_as_json` wrote.

    Args:
        data: the provenance of the motors.
        policy: the file it stands in.

    Raises:
        ArtifactError: unknown or missing keys, or a value of another type.
        ConfigError: a file is gone, is not the one the policy was trained on, or there is no digest of it.
    """
    if not isinstance(data, dict):
        raise ArtifactError(
            "it does not say which motors it walked on", where=policy,
            remedy="train it with `motorprior walk`, which says so, or let it walk on a twin",
        )  # fmt: skip
    _CHOICE.check(data, policy)
    defaults = {field.name: field.default for field in fields(MotorChoice)}
    data = dict.fromkeys(_KEYS) | defaults | data
    values: dict[str, Any] = {name: data[name] for name in MotorChoice.__dataclass_fields__}
    for name in ("prior", "posterior"):
        values[name] = None if data[name] is None else _found(name, data, policy)
    if _is_file_name(data["fleet"]):
        values["fleet"] = str(_found("fleet", data, policy))
    return MotorChoice(**values)


def _is_file_name(fleet: str | None) -> bool:
    """Of a fleet that is not shipped, see `fleet_path`."""
    return fleet is not None and fleet.endswith(".toml")


def _way(file: Path, folder: Path) -> str | None:
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # on another drive of Windows
        return None


def _found(name: str, data: dict[str, Any], policy: Path) -> Path:
    """The file, where it stood from the policy's folder, or beside the policy.

    Raises:
        ConfigError: neither is the one of the digest.
    """
    called, way, wanted = (data[f"{name}{ending}"] for ending in ("", "_beside", "_sha256"))
    called = PurePosixPath(called).name
    for inside in (way, called):
        if inside is not None and not (PurePosixPath(inside).is_absolute() or PureWindowsPath(inside).drive):
            path = policy.parent / inside
            if _is_small(path) and digest(path) == wanted:
                return path
    raise ConfigError(
        f"the {name} it was trained on, {called[:100]} with SHA-256 {str(wanted)[:_SHOWN]}…, is gone or has changed",
        where=policy, remedy="put it back, or beside the policy, or train the policy again",
    )  # fmt: skip


def _is_small(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size <= LARGEST_FILE
    except (OSError, ValueError):  # no name of a file at all
        return False
