"""Table of randomised PDs of several widths, on walks that nobody measured."""

import pytest
from study_walks import invented

import pd_spread


def test_a_row_per_width_with_what_it_does_at_home_and_on_the_validation_fleet():
    table = invented(("0.1", "0.25"), ("own", "foreign"))
    figures = pd_spread.figures_of(table, "mixed")
    assert set(figures) == {
        f"{width}/{place}/{measure}{end}"
        for width in ("0.1", "0.25") for place in ("own", "mixed") for measure in ("speed", "upright")
        for end in ("", "/low", "/high")
    }  # fmt: skip
    upright = table.scores("foreign", "0.25", "upright").mean()
    assert figures["0.25/mixed/upright"] == pytest.approx(upright)
    head, _, *rows = pd_spread.markdown(figures, "mixed").splitlines()
    assert head == "| varied by | own simulation | mixed |"
    assert [row.split(" | ")[0] for row in rows] == ["| ± 10%", "| ± 25%"]
    assert f"{figures['0.25/mixed/speed']:.2f} m/s, {upright:.0%} |" in rows[1]
