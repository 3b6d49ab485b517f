"""The walking policy: its formulas, compiled, and its file.

An action is in [-1, 1]: a residual on the gait's target of every joint, then frequency, stride
scale, height, swing/stance ratio and turn of the gait. The layout is that of Iscen et al. 2018 and
jietan/puppersim (Apache-2.0), plus the turn.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bounds import TABLE, TEXT, many, number
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.locomotion.gait import NUM_MODULATIONS, WalkerArrays, action_size, observation_size
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.schema import Header, Tensor, check_tensors
from motorprior.texts import Overview, Printable

# key of a policy's provenance: weight of the robot in its training [N]
ROBOT_WEIGHT = "robot_weight"
NORMALISED_LIMIT = 10.0  # a normalised observation beyond ten standard deviations is clipped
ACTION_CUTOFF = 3.0  # cutoff frequency of the first-order low-pass on actions [Hz]

# indices in a command after the residuals
FREQUENCY = 0
STRIDE_SCALE = 1
HEIGHT = 2
SWING_STANCE_RATIO = 3
TURN = 4

FREQUENCY_SHARE = 0.4  # ± share of the usual frequency
STRIDE_SCALE_SHARE = 0.75  # ± share of the commanded stride
HEIGHT_SHARE = 0.5  # ± change of the base's height [swing heights]
# maximum swing/stance ratio over the usual one; the minimum is its inverse
MAX_RATIO = 2.0

_REMEDY = "use a policy written by this version of motorprior"
_HEADER = Header(
    "policy",
    4,
    {
        "control_dt": number(above=0.0),
        "robot": TEXT,
        "joint_names": many(TEXT, minimum=1),
        "slowest": number(-10.0, 0.0, unit="m/s"),
        "fastest": number(0.0, 10.0, above=0.0, unit="m/s"),
        "provenance": TABLE,
    },
    _REMEDY,
    "policy.safetensors",
    "walk",
)
_TENSORS = {  # in the order of `PolicyArrays`
    "weights": Tensor(("actions", "inputs")),
    "hidden": Tensor(("units", "inputs")),
    "readout": Tensor(("units", "actions")),
    "observation_mean": Tensor(("observations",)),
    "observation_std": Tensor(("observations",), above=0.0),
    "kp": Tensor(("joints",)),
    "kd": Tensor(("joints",)),
}


class PolicyArrays(NamedTuple):
    """The numbers of a policy, for compiled code."""

    weights: np.ndarray  # W, (actions, observations + 1); the last column is the bias
    hidden: np.ndarray  # H, (units, observations + 1); no rows for a linear policy
    readout: np.ndarray  # V, (units, actions)
    mean: np.ndarray  # (observations,) running mean of observations
    std: np.ndarray  # (observations,) running standard deviation, > 0


@njit(cache=True)
def act(policy: PolicyArrays, observation: np.ndarray, out: np.ndarray) -> None:
    """Write the action clip(W·[n; 1] + Vᵀ·tanh(H·[n; 1]), -1, 1) to (actions,) ``out``.

    n = clip((x - mean) / std, -10, 10) is the normalised observation x: Mania et al. 2018,
    algorithm 2 (V2).
    """
    weights = policy.weights
    hidden = policy.hidden
    actions = weights.shape[0]
    observations = weights.shape[1] - 1

    for i in range(actions):
        out[i] = weights[i, observations]
    for j in range(observations):
        normalised = _normalised(policy, observation, j)
        for i in range(actions):
            out[i] += weights[i, j] * normalised

    for unit in range(hidden.shape[0]):
        activation = hidden[unit, observations]
        for j in range(observations):
            activation += hidden[unit, j] * _normalised(policy, observation, j)
        activation = math.tanh(activation)
        for i in range(actions):
            out[i] += policy.readout[unit, i] * activation

    for i in range(actions):
        out[i] = min(1.0, max(-1.0, out[i]))


@njit(cache=True)
def _normalised(policy: PolicyArrays, observation: np.ndarray, index: int) -> float:
    value = (observation[index] - policy.mean[index]) / policy.std[index]
    return min(NORMALISED_LIMIT, max(-NORMALISED_LIMIT, value))


@njit(cache=True)
def low_pass(action: np.ndarray, control_dt: float, state: np.ndarray) -> None:
    """First-order low-pass at 3 Hz, in place.

    The state s gets s + α (clip(action, -1, 1) - s) with α = 1 - exp(-2π · 3 · control_dt).
    """
    alpha = 1.0 - math.exp(-2.0 * math.pi * ACTION_CUTOFF * control_dt)
    for i in range(state.shape[0]):
        state[i] += alpha * (min(1.0, max(-1.0, action[i])) - state[i])


@njit(cache=True)
def scale_action(walker: WalkerArrays, action: np.ndarray, out: np.ndarray) -> None:
    """Scale a filtered (actions,) action a in [-1, 1] to physical units; zero is the usual trot.

    Writes residuals a · max_residual [rad], frequency f (1 + 0.4 a) [Hz], stride scale 1 + 0.75 a,
    height a · swing_height / 2 [m], ratio 2^a, and turn a · max_yaw_rate [rad/s] to ``out``
    (actions,).
    """
    joints = out.shape[0] - NUM_MODULATIONS
    for joint in range(joints):
        out[joint] = walker.max_residual * action[joint]
    out[joints + FREQUENCY] = walker.frequency * (
        1.0 + FREQUENCY_SHARE * action[joints + FREQUENCY]
    )
    out[joints + STRIDE_SCALE] = 1.0 + STRIDE_SCALE_SHARE * action[joints + STRIDE_SCALE]
    out[joints + HEIGHT] = HEIGHT_SHARE * walker.swing_height * action[joints + HEIGHT]
    ratio = math.exp(action[joints + SWING_STANCE_RATIO] * math.log(MAX_RATIO))
    out[joints + SWING_STANCE_RATIO] = ratio
    out[joints + TURN] = walker.max_yaw_rate * action[joints + TURN]


@dataclass(frozen=True, eq=False, repr=False)
class Policy(Printable):
    """A trained walking policy and what it was trained for."""

    arrays: PolicyArrays  # float64, in the units of the observation
    kp: np.ndarray  # (joints,) position gains of the motors in training [N·m/rad]
    kd: np.ndarray  # (joints,) velocity gains of the motors in training [N·m·s/rad]
    control_dt: float  # control period [s] in training
    robot: str  # name of the robot
    joint_names: tuple[str, ...]  # in the order of residuals and observed angles
    # range of commanded speeds [m/s]: the robot's, extended by that of the training
    forward: tuple[float, float]
    provenance: Mapping[str, Any]  # settings of its training; JSON values only

    @classmethod
    def of(
        cls, robot: Robot, arrays: PolicyArrays, kp: np.ndarray, kd: np.ndarray, **provenance: Any
    ) -> "Policy":
        """A policy of a robot with the speed range of the training."""
        return cls(
            arrays=arrays,
            kp=kp,
            kd=kd,
            control_dt=robot.control_dt,
            robot=robot.name,
            joint_names=robot.joint_names,
            forward=robot.require_gait().forward,
            provenance=provenance,
        )

    def overview(self) -> Overview:
        """Overview for people: the robot, and the training."""
        training = self.provenance

        robot = self.robot
        if ROBOT_WEIGHT in training:
            robot += f", {training[ROBOT_WEIGHT] / GRAVITY:.2f} kg"

        motors = training.get("motors")
        if isinstance(motors, dict):
            motors = motors.get("text")

        best = ""
        if "iteration" in training:
            mean_return = f"mean return {training['best_return']:.2f} m"
            best = f"iteration {training['iteration']}, {mean_return}"

        facts = {
            "robot": robot,
            "commanded speed": f"{self.forward[0]:g} to {self.forward[1]:g} m/s",
            "control": f"{1.0 / self.control_dt:g} Hz",
            "trained on": str(motors or ""),
            "best": best,
        }
        return Overview("walking policy", facts)

    def require_robot(self, robot: Robot, where: str | Path | None = None) -> None:
        """Raise ConfigError unless robot, joints and control period are those of the policy."""
        joints = list(self.joint_names)
        robot_joints = list(robot.joint_names)
        # low-pass filter and gait depend on the period
        same_period = math.isclose(self.control_dt, robot.control_dt, rel_tol=1e-9)

        if self.robot != robot.name:
            problem = f"robot of the policy: {self.robot!r}, wanted {robot.name!r}"
        elif joints != robot_joints:
            problem = f"joints of the policy: {joints!r}, wanted {robot_joints!r}"
        elif not same_period:
            periods = f"{self.control_dt!r}, wanted {robot.control_dt!r}"
            problem = f"control period [s] of the policy: {periods}"
        else:
            return

        remedy = f"use a policy trained for {robot.name} as it is now"
        remedy += ", or give the policy's robot (--robot)"
        raise ConfigError(problem, where=where, remedy=remedy)

    def save(self, path: str | Path) -> None:
        """Write the policy as one file, atomically."""
        arrays = [np.ascontiguousarray(array) for array in (*self.arrays, self.kp, self.kd)]
        tensors = dict(zip(_TENSORS, arrays, strict=True))
        header = _HEADER.make(
            control_dt=self.control_dt,
            robot=self.robot,
            joint_names=list(self.joint_names),
            slowest=self.forward[0],
            fastest=self.forward[1],
            provenance=dict(self.provenance),
        )
        write_tensors(Path(path), tensors, header)

    @classmethod
    def load(cls, path: str | Path) -> "Policy":
        """Read a policy from its file.

        ArtifactError for another file, a wrong shape, or a value that is not finite.
        """
        path = Path(path)
        tensors, header = _HEADER.read(path)
        joint_names = tuple(header["joint_names"])
        observations = observation_size(len(joint_names))
        sizes = {
            "joints": len(joint_names),
            "actions": action_size(len(joint_names)),
            "observations": observations,
            "inputs": observations + 1,
        }
        check_tensors(tensors, _TENSORS, path, _REMEDY, sizes)

        arrays = PolicyArrays(
            # the inner loop of `act` runs over the actions
            weights=np.asfortranarray(tensors["weights"]),
            hidden=tensors["hidden"],
            readout=tensors["readout"],
            mean=tensors["observation_mean"],
            std=tensors["observation_std"],
        )
        return cls(
            arrays=arrays,
            kp=tensors["kp"],
            kd=tensors["kd"],
            control_dt=float(header["control_dt"]),
            robot=header["robot"],
            joint_names=joint_names,
            forward=(float(header["slowest"]), float(header["fastest"])),
            provenance=header["provenance"],
        )
