"""The table of faults in docs/hardware.md names a test in every row, and every such test exists."""

import re
from pathlib import Path

from motorprior.hardware.virtual.injected import KINDS

HERE = Path(__file__).parent
PAGE = (HERE.parents[1] / "docs" / "hardware.md").read_text("utf-8")


def test_every_fault_of_the_table_has_its_test():
    table = PAGE[PAGE.index("| fault |") :].split("\n\n")[0].splitlines()[2:]
    written = "".join(file.read_text("utf-8") for file in HERE.glob("test_*.py"))
    assert len(table) >= 20
    for row in table:
        named = re.findall(r"`(test_\w+)(?:\[([^\]]*)\])?`", row)
        assert named, row
        for name, case in named:
            assert f"def {name}(" in written, row
            assert not case or f'"{case.split("-")[0]}"' in written, row


def test_every_fault_of_the_table_has_a_measured_figure():
    table = PAGE[PAGE.index("| fault |") :].split("\n\n")[0].splitlines()[2:]
    for row in table:
        assert re.search(r"\d", row.split("|")[4]), row


def test_every_fault_that_can_be_injected_is_in_a_test():
    written = (HERE / "test_reactions.py").read_text("utf-8")
    assert [kind for kind in KINDS if f'"{kind}"' not in written] == []


def test_the_page_is_complete():
    assert not re.search(r"@\w+@", PAGE)
