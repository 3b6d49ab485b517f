"""A fatal error of MuJoCo in a compiled episode loses no finished iteration."""

import subprocess
import sys
from pathlib import Path

from motorprior.artifacts import read_tensors

WALK = ("walk", "--motors", "pd", "--episode-steps", "20", "--iterations", "12")
SABOTAGE = """
import mujoco, sys
from numba import njit
from motorprior.cli.main import main
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.scene import WalkSimulator
from motorprior.simulation.mujoco_library import mj_step, prepare_mujoco

FLOOR = '<size memory="2K"/><worldbody><geom type="plane" size="9 9 1"/>'
XML = PUPPER_V2.model.path.read_text().replace("<worldbody>", FLOOR, 1)
XML = XML.replace('contype="0" conaffinity="0"', "")
model = mujoco.MjModel.from_xml_string(XML)
data = mujoco.MjData(model)  # its memory is too small for a step: mju_error

@njit(nogil=True)
def step(address, model, data):
    mj_step(address, model, data)

episodes = [0]
healthy = WalkSimulator.run

LIMIT = int(sys.argv.pop())
def limited(self, *args, **options):
    episodes[0] += 1
    if episodes[0] == LIMIT:
        step(prepare_mujoco(), model._address, data._address)
    return healthy(self, *args, **options)

WalkSimulator.run = limited
main()
"""


def test_after_a_fatal_error_the_same_command_continues_from_the_finished_iterations(
    tmp_path: Path,
):
    words = [*WALK, "--workers", "2", "--out", str(tmp_path / "walk")]

    def run(*head: str, tail: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, *head, *words, *tail]
        return subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path)

    # an iteration has 32 episodes, the evaluations at the start and after the tenth 16 each:
    # episode 366 is in the 11th
    failed = run("-c", SABOTAGE, tail=("366",))

    assert failed.returncode == 2

    output = failed.stderr.strip().splitlines()[-1]

    assert output.startswith("error: ")
    assert "mj_stackAlloc" in output

    state, header = read_tensors(tmp_path / "walk" / "search.safetensors")

    assert int(state["iteration"]) == len(header["curve"]) == 10
    assert not (tmp_path / "walk" / "stage.json").exists()
    assert not list(tmp_path.glob("MUJOCO_LOG*"))
    assert run("-m", "motorprior").returncode == 0


def test_a_closed_output_pipe_is_no_error():
    words = [sys.executable, "-m", "motorprior", "--help"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None

    process.stdout.close()

    assert process.wait(timeout=120.0) == 141
    assert process.stderr.read() == ""
