"""The Python loop that the kernel is timed against simulates the same motors."""

import numpy as np
import pytest

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.mujoco_backend import MujocoBackend
from motorprior.simulation.python_loop import PythonLoopBackend, numpy_torque, torchscript_torque
from motorprior.simulation.world_config import WorldConfig


def motors(period: float) -> LatentActuator:
    """Random networks, about as stiff as a PD of 6 N·m/rad and 0.3 N·m·s/rad."""
    rng = np.random.default_rng(0)
    w1, w2 = 0.02 * rng.standard_normal((6, 8)), 0.02 * rng.standard_normal((8, 8))
    w1[0, 0], w1[3, 0], w2[0, 0] = 0.1, -0.1, 1.0
    network = LatentNetwork(
        w1=w1, v1=0.05 * rng.standard_normal((3, 8)), b1=0.01 * rng.standard_normal(8), w2=w2, b2=np.zeros(8),
        w3=np.r_[1.0, 0.1 * rng.standard_normal(7)], b3=np.array(0.01), log_armature=np.array(np.log(0.003)),
        armature_slope=np.array([0.2, 0.0, 0.0]), taps=(0, 2, 5), period=period, error_scale=0.1,
        velocity_scale=2.0, torque_scale=6.0, torque_limit=1.26, has_armature=True,
    )  # fmt: skip
    return LatentActuator(network, rng.standard_normal((12, 3)))


@pytest.mark.parametrize("make", [numpy_torque, torchscript_torque])
@pytest.mark.parametrize("kind", ["network of 2 ms", "network of 10 ms", "grey box"])
def test_it_moves_as_the_kernel_does(make, kind, grey_network):
    actuator = motors(0.010 if kind == "network of 10 ms" else 0.002)
    if kind == "grey box":
        actuator = LatentActuator(grey_network(spread=0.1, network=0.2), actuator.z)
    torque = make(actuator)
    if torque is None:
        pytest.skip("PyTorch is not installed: pip install 'motorprior[rl]'")
    ours = PythonLoopBackend(PUPPER_V2, actuator, torque)
    kernel = MujocoBackend(lambda rng: actuator, WorldConfig.of(PUPPER_V2))
    ours.reset(0)
    kernel.reset(0)
    for step in range(15):
        target = spec.NOMINAL_POSE + 0.2 * np.sin(0.5 * step)
        one, other = ours.step(target), kernel.step(target)
        # float32 in the kernel, float64 in numpy
        np.testing.assert_allclose(one.measured_joint_pos, other.measured_joint_pos, atol=1e-4)
        assert one.torque_squared_sum == pytest.approx(other.torque_squared_sum, rel=1e-3)
