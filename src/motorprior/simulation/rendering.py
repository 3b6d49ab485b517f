"""Pictures of walks by MuJoCo's renderer, where OpenGL works with or without a screen."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.exceptions import ConfigError
from motorprior.scratch import scratch_folder

WIDTH, HEIGHT = 480, 288
"""Of a walk's picture [pixel]; multiples of 16, as video encoders want them."""
REMEDY = "install EGL or OSMesa (Debian: libegl1 with libgl1-mesa-dri, or libosmesa6)"


@contextmanager
def rendered(robot: str, walks: Sequence[np.ndarray]) -> Iterator[Iterator[np.ndarray]]:
    """Frames (walks · HEIGHT, WIDTH, 3) uint8, the walks one under the other.

    Every way to OpenGL is tried in a process of its own until one draws the first frame; MUJOCO_GL names the only one
    to try.

    Args:
        robot: name, or path of its .toml file.
        walks: (F, 7 + joints) base pose and joint angles of each, all of one length, at least one frame.

    Raises:
        ConfigError: no OpenGL, with what the last process said; or a process that ended too early.
    """
    with scratch_folder() as folder:
        request = folder / "walks.safetensors"
        header = {"robot": robot, "width": WIDTH, "height": HEIGHT}
        write_tensors(request, {str(number): walk for number, walk in enumerate(walks)}, header)
        shape, said = (len(walks) * HEIGHT, WIDTH, 3), ""
        for way in _ways():
            with (folder / "stderr").open("w+b") as errors, _process(request, way, errors) as process:
                assert process.stdout is not None
                first = process.stdout.read(int(np.prod(shape)))
                if len(first) == np.prod(shape):
                    yield _frames(first, process.stdout, len(walks[0]), shape)
                    return
                process.wait()
                errors.seek(0)
                said = (errors.read().decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
        raise ConfigError(f"MuJoCo cannot draw here ({said})", remedy=REMEDY)


def _ways() -> list[str | None]:
    """Values of MUJOCO_GL to try; None leaves the choice to MuJoCo."""
    if "MUJOCO_GL" in os.environ or not sys.platform.startswith("linux"):
        return [None]
    return ["egl", "osmesa", *(["glfw"] if os.environ.get("DISPLAY") else [])]


@contextmanager
def _process(request: Path, way: str | None, errors: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The drawing process, which ends with the context."""
    command = [sys.executable, "-P", "-m", "motorprior.simulation.render_process", str(request)]
    environment = os.environ | ({} if way is None else {"MUJOCO_GL": way})
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def _frames(first: bytes, stream: IO[bytes], count: int, shape: tuple[int, ...]) -> Iterator[np.ndarray]:
    data = first
    for number in range(count):
        if number:
            data = stream.read(len(first))
        if len(data) < len(first):
            raise ConfigError(f"MuJoCo stopped drawing at frame {number} of {count}", remedy=REMEDY)
        yield np.frombuffer(data, dtype=np.uint8).reshape(shape)
