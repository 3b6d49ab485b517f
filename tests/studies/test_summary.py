"""The table of walks of a study: its order, its file, and the statistics over it."""

from itertools import product
from pathlib import Path

import numpy as np

from motorprior.report.transfer_page import difference_table, estimate_table, own_simulations
from motorprior.studies.statistics import WalkRow, read_walks, scores, summarise, write_walks


def row(
    bench: int, environment: str, condition: str, seed: int, draw: int, **measures: float
) -> WalkRow:
    return {
        "bench": bench,
        "environment": environment,
        "condition": condition,
        "seed": seed,
        "walk": draw,
    } | measures


def test_scores_are_sorted_by_bench_seed_and_draw():
    walks = []
    for bench, seed, draw in product((2, 1), (7, 3), (2, 0, 1)):
        speed = 100 * bench + 10 * seed + draw
        walks.append(row(bench, "fleet", "oracle", seed, draw, speed=speed))

    expected = [[[130, 131, 132], [170, 171, 172]], [[230, 231, 232], [270, 271, 272]]]
    np.testing.assert_array_equal(scores(walks, "speed"), expected)


def test_a_saved_table_is_read_back_with_undefined_measures(tmp_path: Path):
    undefined = float("nan")
    walks = []
    for draw in range(2):
        walks.append(row(91, "own", "oracle", 3, draw, speed=0.123456, torque=undefined))

    write_walks(tmp_path / "walks.csv", walks)
    saved = read_walks(tmp_path / "walks.csv")

    assert all(np.isnan(walk["torque"]) for walk in saved)
    assert [{**walk, "torque": 0} for walk in saved] == [{**walk, "torque": 0} for walk in walks]


def invented(
    conditions: dict[str, float], benches: int = 3, seeds: int = 4, walks: int = 8
) -> list[WalkRow]:
    """Walks in the training simulation and in one environment.

    ``conditions`` are the upright shares of the conditions, about which the walks vary.
    """
    rng = np.random.default_rng(0)
    rows = []
    for environment, (condition, share) in product(("own", "fleet"), conditions.items()):
        for bench, seed, draw in product(range(benches), range(seeds), range(walks)):
            upright = float(np.clip(rng.normal(share, 0.02), 0, 1))
            measures = {"speed": share, "upright": upright}
            rows.append(row(bench, environment, condition, seed, draw, **measures))
    return rows


def test_a_clear_difference_is_significant_and_none_is_not():
    shares = {"sampled_prior": 0.9, "ideal_pd": 0.3, "friction_pd": 0.9, "adapted_pd": 0.3}

    summary = summarise(invented(shares))

    for condition in ("ideal_pd", "adapted_pd"):
        comparison = summary.differences["fleet", condition, "upright"]
        assert comparison.p < 0.05
        assert comparison.difference.value < -0.5
        assert comparison.difference.high < 0.0
    assert summary.differences["fleet", "friction_pd", "upright"].p > 0.05


def test_tables_of_a_study_have_its_conditions_in_the_same_order():
    shares = {"sampled_prior": 0.9, "ideal_pd": 0.3, "friction_pd": 0.9, "adapted_pd": 0.3}
    summary = summarise(invented(shares))
    order = ["ideal_pd", "friction_pd", "adapted_pd", "sampled_prior"]
    for measure in ("upright", "speed"):
        assert [row[0] for row in estimate_table(summary, measure).rows] == order
        assert [row[0] for row in difference_table(summary, measure).rows] == order[:-1]


def test_every_bench_and_every_policy_is_shown():
    walks = invented({"sampled_prior": 1.0, "oracle": 1.0})
    for walk in walks:
        policy = (walk["environment"], walk["condition"], walk["bench"], walk["seed"])
        if policy == ("own", "oracle", 1, 2):
            walk["upright"] = 0.2

    summary = summarise(walks)

    table = own_simulations(summary).tables[0]
    (row_of_oracle,) = (row for row in table.rows if row[0] == "oracle")
    policies_of_benches = [cell.split() for cell in row_of_oracle[1:]]
    assert [len(policies) for policies in policies_of_benches] == [4, 4, 4]
    assert policies_of_benches[1][2] == "20*"

    figures = summary.as_results().to_figures()
    assert figures["own/oracle/policies_upright"] == 11 / 12
    assert figures["bench_1/own/oracle/upright"] < 0.85
    assert figures["bench_2/own/oracle/upright"] > 0.95


def test_walks_that_diverged_are_in_no_figure():
    walks = invented({"sampled_prior": 1.0, "oracle": 1.0})
    for walk in walks[:3]:
        walk["upright"] = float("nan")
        walk["speed"] = float("nan")

    figures = summarise(walks).as_results().to_figures()

    assert all(np.isfinite(value) for value in figures.values())
    assert figures["own/sampled_prior/upright"] > 0.95
