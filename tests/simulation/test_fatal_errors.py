"""A fatal error of MuJoCo ends the process once, with one line that promises no more than was kept."""

import subprocess
import sys

import pytest

FATAL = """
import contextlib, ctypes, sys, threading, time
from motorprior.simulation import fatal_errors
from motorprior.simulation.mj_call import library

def rescue():
    sys.stderr.write("rescued ")
    time.sleep(0.3)
    if sys.argv[1] == "full":
        raise OSError("disk full")
    return "7 iterations are kept"

die = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(("mju_error", library()))
fatal_errors.install_handler()
with contextlib.nullcontext() if sys.argv[1] == "none" else fatal_errors.saved_on_fatal_error(rescue):
    threads = [threading.Thread(target=die, args=(b"out of memory",)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
"""
SAID = {
    "kept": "7 iterations are kept; run the same command again to continue",
    "none": "nothing was being kept",
    "full": "what there was could not be kept (OSError: disk full)",
}


@pytest.mark.parametrize("case", SAID)
def test_threads_that_fail_at_once_are_rescued_once_and_one_line_says_what_was_kept(case: str):
    ended = subprocess.run([sys.executable, "-c", FATAL, case], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("rescued") == (case != "none")
    assert ended.stderr.splitlines()[-1] == f"error: MuJoCo stopped: out of memory -> {SAID[case]}"
    assert ended.stderr.count("MuJoCo stopped") == 1
