"""What is said of the distribution of a prior: the middle, the least and the largest of five comparisons."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.identification.evaluation import distribution as statistics
from motorprior.pipeline.validation import held_out

AREAS, DISTANCES = [0.9, 0.5, 0.7, 0.6, 0.55], [0.1, 0.5, 0.2, 0.4, 0.3]


def test_of_five_comparisons_the_middle_and_the_ends_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """The first comparison's behaviours are told apart by hand: of 2 and 3 against 1 and 2 three pairs and a tie."""
    areas, distances, values = iter(AREAS), iter(DISTANCES), iter([[2.0, 3.0], [1.0, 2.0]] * len(AREAS))
    monkeypatch.setattr(statistics, "two_sample_auc", lambda *_: next(areas))
    monkeypatch.setattr(statistics, "energy_distance", lambda *_: next(distances))
    monkeypatch.setattr(statistics, "permutation_p_value", lambda *_: 0.25)
    monkeypatch.setattr(
        held_out,
        "behaviours",
        lambda motors: SimpleNamespace(names=("lag",), units=("s",), values=np.array(next(values))[:, None]),
    )
    fleet = SimpleNamespace(sample=lambda *_: SimpleNamespace(after=lambda _: SimpleNamespace(actuator=lambda: None)))
    prior: Any = SimpleNamespace(sample=lambda *_: None, metrics={})
    facts: Any = SimpleNamespace(fleet=fleet, seed=0)
    found = held_out.distribution(prior, facts, tmp_path / "quantiles.png")
    area = found.where(quantity="two_sample_auc")
    assert [area.value(statistic=name) for name in ("low", "median", "high")] == [0.5, 0.6, 0.9]
    assert found.where(quantity="energy_distance").value(statistic="median") == 0.3
    assert found.where(quantity="energy_p_value").value() == 0.25
    assert found.where(quantity="behaviour_auc").value(part="lag") == 3.5 / 4
    assert (tmp_path / "quantiles.png").is_file()
