"""Energy that the residual network of a grey box adds to a motor that is switched off.

Its torque is bounded, since a softsign is below 1,

    |torque| <= bound = min(torque_limit, torque_scale·(|b3| + Σ|w3|)),

so that over a cycle it adds at most bound·travel. The physics of a grey box are passive, the network need not be.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.learned_kernels import SCALES
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.results import Result, Results

AMPLITUDES = (0.02, 0.1, 0.3, 0.6)  # [rad], from within the backlash to those of a trot
FREQUENCIES = (0.5, 1.0, 2.0, 4.0)  # [Hz], up to those of a fast trot
CYCLES = 3  # the first is a transient, the others are evaluated


def residual_bound(network: LatentNetwork) -> float:
    """Largest torque of the network for any input [N·m]."""
    linear = network.torque_scale * (abs(float(network.b3)) + float(np.abs(network.w3).sum()))
    return min(network.torque_limit, linear)


def cycle_work(actuator: LatentActuator, amplitude: float, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """(n,) mean work per cycle on the joints [J] of switched-off motors: by the network, and by the physics (< 0).

    The joints are moved along amplitude·sin(2π·frequency·t) with servo gains of 0; the target is 0.
    """
    dt = actuator.network.period
    steps = round(CYCLES / frequency / dt)
    angle = 2 * np.pi * frequency * dt * np.arange(steps + 1)
    q = amplitude * np.sin(angle)
    dq = np.diff(q, prepend=q[0] - (q[1] - q[0])) / dt  # the step with dq[k] ends at q[k], as in an engine
    arrays, count = actuator.arrays(dt), actuator.num_motors
    for name in ("kp", "kd_over_kp"):  # the second row holds kd itself
        arrays.parameters[SCALES + PARAMETERS.index(name)] = 0.0
    zero, torque, work = np.zeros(count), np.zeros(count), np.zeros((2, count))
    reset_actuator(arrays, zero, np.full(count, q[0]))
    for step in range(steps):
        step_actuator(arrays, dt, zero, np.full(count, q[step]), np.full(count, dq[step]), torque)
        if step >= steps // CYCLES:
            travel, network = dt * 0.5 * (dq[step] + dq[step + 1]), arrays.memory[0]
            work[0] += travel * network
            work[1] += travel * (torque - network - arrays.damping * dq[step + 1])
    by_network, by_physics = work / (CYCLES - 1)
    return by_network, by_physics


def residual_work(actuator: LatentActuator) -> float:
    """Largest work of the network per cycle over the work taken by the physics [-].

    The maximum is over motors, AMPLITUDES and FREQUENCIES. Below 1 no cycle gains energy; below 0 the network brakes
    in all of them.
    """
    works = [cycle_work(actuator, amplitude, frequency) for amplitude, frequency in product(AMPLITUDES, FREQUENCIES)]
    return max(float(np.max(network / np.maximum(-physics, 1e-12))) for network, physics in works)


def residual_results(priors: Mapping[str, MotorPrior]) -> Results:
    """``residual_work`` [-] and ``residual_bound`` [N·m] of the training motors of every grey box."""
    rows: list[Result] = []
    for name, prior in priors.items():
        if prior.network.motor is not None:
            motors = prior.training_motors(np.arange(len(prior.mean)))
            rows.append(Result("residual_work", "1", residual_work(motors), name, "train"))
            rows.append(Result("residual_bound", "1", residual_bound(prior.network), name, "train"))
    return Results.of(rows)
