"""A short search has recorded bytes, where libraries and processor are those of the record."""

import hashlib
import platform
import re
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from drawn_motors import draw_pd
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import make_executor
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import DrawMotors, Scene, WalkConfig, WalkSimulator

# Compiled code is made for the processor, and numpy and the C library choose theirs by it. Another
# processor or library adds in another order and rounds otherwise.
HOLDS_FOR = {
    "mujoco": "4.0.0",
    "numba": "0.68.1",
    "llvmlite": "0.50.0",
    "numpy": "2.4.6",
    "machine": "x86_64",
    "libc": "glibc 2.36",
    "cpu": "znver3",
    "cpu's features": "11ec95ab57aa",
    "numpy's SIMD": "X86_V3",
}
LIBRARIES = ("mujoco", "numba", "llvmlite", "numpy")

# SHA-256 of the result of `digest_of_search`. A commit that changes one must state why.
DIGESTS = {
    "ideal_pd": "e3f4603a8c3a0c2ffb6664f3b4666db2f13376cbcdec9cd9fcd24d99e72a71d6",
    "grey_box": "11479e9759907d82aea7e3187ae181f984816120aabe072dc7331015258d41d5",
}


def digest_of_search(draw: DrawMotors) -> str:
    """SHA-256 of the state of a search on these motors after three iterations."""
    everything = Randomization(
        armature=(0.0, 0.002),
        damping=(0.0, 0.05),
        friction=(0.6, 1.4),
        mass=(0.8, 1.2),
        com=0.01,
        gravity_tilt=0.05,
        encoder_offset=0.02,
        joint_noise=0.002,
        tilt_noise=0.01,
        rate_noise=0.05,
        sensor_delay=(0.004, 0.025),
        command_delay=(0.001, 0.018),
        push=0.1,
        push_interval=0.2,
        gyro_bias=0.02,
    )
    walk = WalkConfig(episode_steps=80, randomization=everything)
    shape = PolicyShape.of(PUPPER_V2, hidden_units=4, symmetric=True)
    search = PolicySearch(ArsConfig(num_directions=4, num_top_directions=2, seed=11), shape)
    executor = make_executor(lambda: WalkSimulator(Scene(PUPPER_V2, draw, walk)), 1)

    for _ in range(3):
        search.advance(executor)
    search.evaluate(executor)

    content = b"".join(array.tobytes() for array in search.state().values())
    return hashlib.sha256(content).hexdigest()


@pytest.fixture(params=DIGESTS)
def motors(request, grey_box) -> tuple[str, DrawMotors]:
    box = grey_box()
    draws = {
        "ideal_pd": draw_pd,
        "grey_box": lambda rng: GreyBoxActuator(box, rng.standard_normal((12, 3))),
    }
    return request.param, draws[request.param]


def here() -> dict[str, str]:
    """Values of the keys of HOLDS_FOR on this machine."""
    numpy_config = np.show_config(mode="dicts")
    assert numpy_config is not None
    features = get_host_cpu_features().flatten().encode()
    machine = {
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "cpu": get_host_cpu_name(),
        "cpu's features": hashlib.sha256(features).hexdigest()[:12],
        "numpy's SIMD": " ".join(numpy_config["SIMD Extensions"]["found"]),
    }
    return {name: version(name) for name in LIBRARIES} | machine


def test_a_search_has_the_bytes_of_the_golden_run(motors):
    differences = {}
    for name, value in here().items():
        if value != HOLDS_FOR[name]:
            differences[name] = f"{value}, not {HOLDS_FOR[name]}"
    if differences:
        pytest.skip(f"the golden digest holds for another machine: {differences}")

    name, draw = motors
    assert digest_of_search(draw) == DIGESTS[name]


def test_the_digests_are_of_the_libraries_that_the_project_installs():
    """Otherwise the golden run would be skipped unnoticed after an upgrade."""
    lock = (Path(__file__).parents[2] / "requirements.lock").read_text(encoding="utf-8")
    pinned = dict(re.findall(r"^([a-z]+)==(\S+)", lock, flags=re.MULTILINE))

    for name in LIBRARIES:
        assert HOLDS_FOR[name] == pinned[name], name
