"""A fatal error of MuJoCo saves the results and ends the process with one line."""

import subprocess
import sys

import pytest

FATAL = """
import contextlib, ctypes, sys, threading, time
from motorprior.simulation import fatal_errors
from motorprior.simulation.mj_call import library

def save():
    sys.stderr.write("saving ")
    time.sleep(0.3)
    if sys.argv[1] == "full":
        raise OSError("disk full")
    return "7 iterations are saved"

die = ctypes.CFUNCTYPE(None, ctypes.c_char_p)(("mju_error", library()))
fatal_errors.install_handler()
with contextlib.nullcontext() if sys.argv[1] == "none" else fatal_errors.saved_on_fatal_error(save):
    threads = [threading.Thread(target=die, args=(b"out of memory",)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
"""
REPORTED = {
    "kept": "7 iterations are saved; run the same command again to continue",
    "none": "there were no results to save",
    "full": "the results could not be saved (OSError: disk full)",
}


@pytest.mark.parametrize("case", REPORTED)
def test_threads_that_fail_at_once_save_once_and_report_in_one_line(case: str):
    ended = subprocess.run([sys.executable, "-c", FATAL, case], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("saving") == (case != "none")
    assert ended.stderr.splitlines()[-1] == f"error: MuJoCo stopped: out of memory -> {REPORTED[case]}"
    assert ended.stderr.count("MuJoCo stopped") == 1
