"""Walks of an invented study: tables and traces as a study writes them, of numbers that nobody measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_json, write_tensors
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.transfer.walk_table import WalkRow, WalkTable

CONDITIONS = {
    "ideal_pd": 0.13, "tuned_pd": 0.29, "pd_friction": 0.38, "pd_randomised": 0.37, "one_network": 0.35, "paper": 0.21,
    "paper_wide": 0.19,
    "prior_mean": 0.40, "prior": 0.42, "prior_adapted": 0.43, "prior_robust": 0.41, "oracle": 0.42,
}  # fmt: skip
"""Name -> mean speed on a twin [m/s]."""
PLACES = {"own": 1.2, "fleet": 1.0, "foreign": 0.9, "hard": 0.7, "pybullet": 0.95}
"""Name -> factor of the speed."""


def table_of(speeds: Mapping[tuple[str, str], Iterable[Iterable[float]]], **measures: float) -> WalkTable:
    """Walks of (place, condition) -> (seeds, draws) speeds, all with the same other measures."""
    return WalkTable.of(
        WalkRow(place, condition, seed, draw, {"speed": float(speed), **measures})
        for (place, condition), seeds in speeds.items()
        for seed, draws in enumerate(seeds)
        for draw, speed in enumerate(draws)
    )


def invented(conditions: Iterable[str] = CONDITIONS, places: Iterable[str] = PLACES, seeds: int = 3, draws: int = 6):
    """A table with every measure; PyBullet tells no torque."""
    rng = np.random.default_rng(7)
    legs = [leg.name for leg in PUPPER_V2.legs]
    walks = []
    for place in places:
        luck = 0.03 * rng.standard_normal(draws)
        for condition in conditions:
            for seed in range(seeds):
                center = CONDITIONS.get(condition, 0.3) * PLACES.get(place, 0.8) + 0.03 * rng.standard_normal()
                for draw in range(draws):
                    speed = center + luck[draw] + 0.02 * rng.standard_normal()
                    measures = _measures(rng, speed, legs, place == "pybullet")
                    walks.append(WalkRow(place, condition, seed, draw, measures))
    return WalkTable.of(walks)


def _measures(rng: np.random.Generator, speed: float, legs: list[str], torque_is_unknown: bool) -> dict[str, float]:
    upright = float(min(1.0, 0.4 + 2.0 * speed) if rng.random() < 0.3 else 1.0)
    near = {
        "distance": 10.0 * speed * upright, "heading_deg_per_m": 3.0, "lateral_share": 0.05, "drift": 0.3, "slip": 0.12,
        "transport": 1.3, "torque_beyond": 0.02, "step_frequency": 2.5, "foot_lift_mm": 14.0, "body_rate": 0.8,
        **{f"foot_lift_mm/{leg}": 14.0 for leg in legs},
    }  # fmt: skip
    found = {name: value * (1.0 + 0.1 * rng.standard_normal()) for name, value in near.items()}
    if torque_is_unknown:
        found["transport"] = found["torque_beyond"] = float("nan")
    return {"speed": speed, "upright": upright, **found}


def steps_in_place(frames: int) -> np.ndarray:
    """(frames, 7 + joints) a robot that goes forward while its knees swing."""
    qpos = np.zeros((frames, 7 + PUPPER_V2.num_joints))
    qpos[:, 0], qpos[:, 2], qpos[:, 3] = 0.004 * np.arange(frames), PUPPER_V2.standing_height, 1.0
    qpos[:, 7:] = PUPPER_V2.nominal_pose
    for number, leg in enumerate(PUPPER_V2.legs):
        swing = np.sin(np.arange(frames) / 6.0 + np.pi * (number in (0, 3)))
        qpos[:, 7 + leg.joints[2]] *= 1.0 + 0.2 * np.maximum(0.0, swing)
    return qpos


def write_study(run: Path, table: WalkTable, traces: Mapping[str, np.ndarray]) -> None:
    """The files of a finished study."""
    table.save(run / "walks.csv")
    write_tensors(run / "traces.safetensors", traces, {"robot": PUPPER_V2.name, "control_dt": PUPPER_V2.control_dt})
    write_json(run / "study.json", {"seeds": 3, "draws": 6, "seconds": 10.0, "robot": PUPPER_V2.name})
