"""The motors of a training in the provenance of its policy: files by name, digest and relative path.

A file is searched for at its path relative to the policy's folder, so that both can be moved together, and in that
folder. Only a file with the same digest is used.
"""

from __future__ import annotations

import os
from dataclasses import asdict, fields
from pathlib import Path, PurePosixPath
from typing import Any

from motorprior.bounds import BOOLEAN, TEXT, maybe, number, one_of
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.schema import Schema
from motorprior.simulation.motor_choice import ACTUATORS, MotorChoice
from motorprior.stage import digest

_FILES = ("prior", "posterior", "fleet")
_KEYS = tuple(f"{name}{ending}" for name in _FILES for ending in ("", "_beside", "_sha256"))
_CHOICE = Schema(
    {
        "actuator": one_of(*ACTUATORS),
        **dict.fromkeys(_KEYS, maybe(TEXT)),
        **dict.fromkeys(("kp", "kd", "torque_limit"), maybe(number(-1e9, 1e9))),
        **dict.fromkeys(("armature", "delay", "coulomb", "spread", "latent_spread"), number(-1e9, 1e9)),
        "limit_follows_gain": BOOLEAN,
        "name": maybe(TEXT),
    },
    "train it again",
    name="its motors",
)


def choice_as_json(choice: MotorChoice, folder: Path) -> dict[str, Any]:
    """JSON values for the provenance of a policy in ``folder``."""
    values = asdict(choice) | {key: None for key in _KEYS if key != "fleet"}
    for name in _FILES:
        file = getattr(choice, name)
        if isinstance(file, Path) or _is_fleet_file(file):
            path = Path(file)
            values[name] = path.name
            values[f"{name}_beside"] = _relative(path.resolve(), folder.resolve())
            values[f"{name}_sha256"] = digest(path)
    return values


def choice_from_json(data: Any, policy: Path) -> MotorChoice:
    """The choice from `choice_as_json`, stored in the file ``policy``.

    Raises:
        ArtifactError: unknown or missing keys, or a value of another type.
        ConfigError: a file is missing or has changed.
    """
    if not isinstance(data, dict):
        raise ArtifactError(
            "its provenance does not record the motors of its training", where=policy,
            remedy="train it with `motorprior walk`, or evaluate it on a twin",
        )  # fmt: skip
    _CHOICE.check(data, policy)
    values = {field.name: data[field.name] for field in fields(MotorChoice)}
    for name in ("prior", "posterior"):
        if data[name] is not None:
            values[name] = _found(name, data, policy)
    if _is_fleet_file(data["fleet"]):
        values["fleet"] = str(_found("fleet", data, policy))
    return MotorChoice(**values)


def _is_fleet_file(fleet: str | None) -> bool:
    return fleet is not None and fleet.endswith(".toml")  # otherwise the name of a shipped one


def _relative(file: Path, folder: Path) -> str | None:
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # on another drive of Windows
        return None


def _found(name: str, data: dict[str, Any], policy: Path) -> Path:
    file, relative_path, wanted = (data[f"{name}{ending}"] for ending in ("", "_beside", "_sha256"))
    file = PurePosixPath(file).name
    for relative in (relative_path, file):
        if relative is not None and not PurePosixPath(relative).is_absolute():
            path = policy.parent / relative
            if path.is_file() and digest(path) == wanted:
                return path
    raise ConfigError(
        f"the {name} it was trained on, {file} with SHA-256 {str(wanted)[:16]}…, is missing or has changed",
        where=policy, remedy="put it back, or into the policy's folder, or train the policy again",
    )  # fmt: skip
