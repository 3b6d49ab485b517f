"""Whether the machine or the host's program was late is found out beside the run, and said."""

import pytest

from motorprior.hardware.real_time import granted, locked_memory


def locked_kilobytes() -> int:
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line.split()[1] for line in status if line.startswith("VmLck:")))


@pytest.mark.skipif(not granted()["memory_locked"], reason="this user may not lock memory")
def test_memory_is_locked_meanwhile_and_no_longer():
    with locked_memory() as locked:
        assert locked and locked_kilobytes() > 0
    assert locked_kilobytes() == 0
