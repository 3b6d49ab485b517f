"""The linear walking policy: its formulas, compiled, and its file.

An action is numbers in [-1, 1]: a residual on the trot's target of every joint, then frequency, intensity, height and
swing/stance ratio of the trot. Layout and ranges: jietan/puppersim (Apache-2.0).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import require_keys, write_tensors
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import MODULATION, action_size, observation_size
from motorprior.robots.robot import Robot
from motorprior.schema import TABLE, TEXT, Header, Tensor, check_tensors, many, number

NORMALISED_LIMIT = 10.0  # a normalised observation beyond ten standard deviations is clipped
ACTION_CUTOFF = 3.0  # [Hz] of the first-order low-pass on actions
FREQUENCY, INTENSITY, HEIGHT, SWING_STANCE_RATIO = 0, 1, 2, 3  # places in a command after the residuals
FREQUENCY_LOW, FREQUENCY_HIGH = 0.5, 2.0  # [Hz]
INTENSITY_LOW, INTENSITY_HIGH = 0.0, 1.0
HEIGHT_LOW, HEIGHT_HIGH = -0.5, 1.0  # [rad] of knee extension
RATIO_HIGH = 5.0  # time in swing over time in stance; the lowest is 1/5

_REMEDY = "use a policy written by this version of motorprior"
_HEADER = Header(
    "policy",
    1,
    {"control_dt": number(above=0.0), "robot": TEXT, "joint_names": many(TEXT, least=1), "provenance": TABLE},
    _REMEDY,
    "policy.safetensors",
    "walk",
)
_TENSORS = {
    "weights": Tensor(("actions", "inputs")),
    "observation_mean": Tensor(("observations",)),
    "observation_std": Tensor(("observations",), above=0.0),
    "kp": Tensor(("joints",)),
    "kd": Tensor(("joints",)),
}


@njit(cache=True)
def act(weights: np.ndarray, mean: np.ndarray, std: np.ndarray, observation: np.ndarray, out: np.ndarray) -> None:
    """Action of the linear policy: clip(W · [n; 1], -1, 1), n = clip((observation - mean) / std, -10, 10).

    Observation normalisation: Mania et al. 2018, algorithm 2 (V2).

    Args:
        weights: shape (actions, observations + 1); the last column is the bias.
        mean: shape (observations,), running mean of observations.
        std: shape (observations,), running standard deviation, > 0.
        observation: shape (observations,), see `motorprior.locomotion.task.observe`.
        out: shape (actions,), in [-1, 1], overwritten.
    """
    actions, observations = weights.shape[0], weights.shape[1] - 1
    for i in range(actions):
        out[i] = weights[i, observations]
    for j in range(observations):
        normalised = (observation[j] - mean[j]) / std[j]
        normalised = min(NORMALISED_LIMIT, max(-NORMALISED_LIMIT, normalised))
        for i in range(actions):
            out[i] += weights[i, j] * normalised
    for i in range(actions):
        out[i] = min(1.0, max(-1.0, out[i]))


@njit(cache=True)
def low_pass(action: np.ndarray, control_dt: float, state: np.ndarray) -> None:
    """First-order low-pass at 3 Hz: s += α (clip(action, -1, 1) - s), α = 1 - exp(-2π · 3 · control_dt).

    Args:
        action: shape (actions,), clipped to [-1, 1] first.
        control_dt: control period [s].
        state: s, shape (actions,), the filtered action, updated in place; zeros at the start of an episode.
    """
    alpha = 1.0 - math.exp(-2.0 * math.pi * ACTION_CUTOFF * control_dt)
    for i in range(state.shape[0]):
        state[i] += alpha * (min(1.0, max(-1.0, action[i])) - state[i])


@njit(cache=True)
def action_to_command(action: np.ndarray, residual: float, out: np.ndarray) -> None:
    """Scale an action to the trot's units. Zero trots: 1.25 Hz, half intensity, height 0.25, ratio 1.

    Linear in each range but the ratio's, which is 5^action: longer in swing as easily as shorter. Height 0.25
    stands 12 mm taller than the nominal pose; that is no tiptoe, so zero means the middle of this range too.

    Args:
        action: shape (actions,), in [-1, 1], already filtered.
        residual: largest residual [rad].
        out: shape (actions,), overwritten: residuals [rad], frequency [Hz], intensity, height [rad], ratio.
    """
    joints = out.shape[0] - MODULATION
    for joint in range(joints):
        out[joint] = residual * action[joint]
    frequency, intensity, height = (
        0.5 * (action[joints + FREQUENCY] + 1.0),
        0.5 * (action[joints + INTENSITY] + 1.0),
        0.5 * (action[joints + HEIGHT] + 1.0),
    )
    out[joints + FREQUENCY] = FREQUENCY_LOW + frequency * (FREQUENCY_HIGH - FREQUENCY_LOW)
    out[joints + INTENSITY] = INTENSITY_LOW + intensity * (INTENSITY_HIGH - INTENSITY_LOW)
    out[joints + HEIGHT] = HEIGHT_LOW + height * (HEIGHT_HIGH - HEIGHT_LOW)
    out[joints + SWING_STANCE_RATIO] = math.exp(action[joints + SWING_STANCE_RATIO] * math.log(RATIO_HIGH))


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained walking policy and what it was trained for.

    Attributes:
        weights: shape (actions, observations + 1), the last column is the bias.
        observation_mean: shape (observations,), units of the observation.
        observation_std: shape (observations,), > 0.
        kp: shape (joints,) [N·m/rad], position gains of the motors in training.
        kd: shape (joints,) [N·m·s/rad], velocity gains.
        control_dt: control period [s] in training.
        robot: name of the robot.
        joint_names: the joints in the order of residuals and observed angles.
        provenance: settings of its training; JSON values only.
    """

    weights: np.ndarray
    observation_mean: np.ndarray
    observation_std: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    control_dt: float
    robot: str
    joint_names: tuple[str, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def check(self, where: str | Path | None = None) -> None:
        """Refuse an invalid policy.

        Raises:
            ArtifactError: a wrong shape or a value that is not finite.
        """
        _HEADER.check(self._header(), where)
        joints = len(self.joint_names)
        observations = observation_size(joints)
        sizes = {"joints": joints, "actions": action_size(joints)}
        sizes |= {"observations": observations, "inputs": observations + 1}
        check_tensors({name: getattr(self, name) for name in _TENSORS}, _TENSORS, where, _REMEDY, sizes)

    def _header(self) -> dict[str, Any]:
        return _HEADER.write(
            control_dt=self.control_dt, robot=self.robot, joint_names=list(self.joint_names),
            provenance=dict(self.provenance),
        )  # fmt: skip

    def require_robot(self, robot: Robot, where: str | Path | None = None) -> None:
        """Refuse a policy that ``robot`` cannot run.

        Raises:
            ConfigError: it was trained for another robot, or one of other joints.
        """
        remedy = f"use a policy trained for {robot.name}"
        if self.robot != robot.name:
            raise ConfigError(f"policy of robot {self.robot!r}, wanted {robot.name!r}", where=where, remedy=remedy)
        if self.joint_names != robot.joint_names:
            problem = f"its joints are {list(self.joint_names)}, the robot's are {list(robot.joint_names)}"
            raise ConfigError(problem, where=where, remedy=remedy)

    def require_clock(self, control_dt: float, where: str | Path | None = None) -> None:
        """Refuse to run at another rate than the policy learned: its low-pass and its trot count control steps.

        Raises:
            ConfigError: it was trained with another control period than ``control_dt`` [s].
        """
        if not math.isclose(self.control_dt, control_dt, rel_tol=1e-9):
            raise ConfigError(
                f"trained with a control period of {self.control_dt:g} s, here it is {control_dt:g} s",
                where=where,
                remedy=f"train a policy at {control_dt:g} s",
            )

    def save(self, path: Path) -> None:
        """Write the policy as one file, atomically."""
        self.check(path)
        write_tensors(path, {name: np.asarray(getattr(self, name)) for name in _TENSORS}, self._header())

    @classmethod
    def load(cls, path: Path) -> Policy:
        """Read what `save` wrote.

        Raises:
            ArtifactError: not a policy of this version, or damaged.
        """
        tensors, header = _HEADER.read(path)
        require_keys(tensors, _TENSORS, path, _REMEDY)
        policy = cls(
            **tensors, control_dt=float(header["control_dt"]), robot=header["robot"],
            joint_names=tuple(header["joint_names"]), provenance=header["provenance"],
        )  # fmt: skip
        policy.check(path)
        return policy
