"""Table of the walks of a study: independent of the order of its rows, saved without loss, and its statistics."""

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
    walks = [
        row(bench, "fleet", "oracle", seed, draw, speed=100 * bench + 10 * seed + draw)
        for bench in (2, 1)
        for seed in (7, 3)
        for draw in (2, 0, 1)
    ]
    expected = [[[130, 131, 132], [170, 171, 172]], [[230, 231, 232], [270, 271, 272]]]
    np.testing.assert_array_equal(scores(walks, "speed"), expected)


def test_a_saved_table_is_read_back_with_undefined_measures(tmp_path: Path):
    walks = [
        row(91, "own", "oracle", 3, draw, speed=0.123456, torque=float("nan")) for draw in range(2)
    ]
    write_walks(tmp_path / "walks.csv", walks)
    found = read_walks(tmp_path / "walks.csv")
    assert [{**walk, "torque": 0} for walk in found] == [{**walk, "torque": 0} for walk in walks]
    assert all(np.isnan(walk["torque"]) for walk in found)


def invented(
    conditions: dict[str, float], benches: int = 3, seeds: int = 4, walks: int = 8
) -> list[WalkRow]:
    """Walks in one environment and in the training simulation, upright for a share about that of the condition."""
    rng = np.random.default_rng(0)
    return [
        row(
            bench,
            environment,
            name,
            seed,
            draw,
            speed=upright,
            upright=float(np.clip(rng.normal(upright, 0.02), 0, 1)),
        )
        for environment in ("own", "fleet")
        for name, upright in conditions.items()
        for bench in range(benches)
        for seed in range(seeds)
        for draw in range(walks)
    ]


def test_a_clear_difference_is_significant_and_none_is_not():
    summary = summarise(
        invented({"sampled_prior": 0.9, "ideal_pd": 0.3, "friction_pd": 0.9, "adapted_pd": 0.3})
    )
    for condition in ("ideal_pd", "adapted_pd"):
        found = summary.differences["fleet", condition, "upright"]
        assert found.p < 0.05 and found.difference.value < -0.5 and found.difference.high < 0.0
    assert summary.differences["fleet", "friction_pd", "upright"].p > 0.05
    order = ["ideal_pd", "friction_pd", "adapted_pd", "sampled_prior"]
    for measure in ("upright", "speed"):
        assert [row[0] for row in estimate_table(summary, measure).rows] == order
        assert [row[0] for row in difference_table(summary, measure).rows] == order[:-1]


def test_every_bench_and_every_policy_is_shown():
    walks = invented({"sampled_prior": 1.0, "oracle": 1.0})
    for walk in walks:
        if (walk["bench"], walk["environment"], walk["condition"], walk["seed"]) == (
            1,
            "own",
            "oracle",
            2,
        ):
            walk["upright"] = 0.2
    summary = summarise(walks)
    (shown,) = (row for row in own_simulations(summary).tables[0].rows if row[0] == "oracle")
    assert [len(cell.split()) for cell in shown[1:]] == [4, 4, 4] and shown[2].split()[2] == "20"
    figures = summary.as_results().to_figures()
    assert figures["own/oracle/policies_upright"] == 11 / 12
    assert (
        figures["bench_1/own/oracle/upright"] < 0.85 < 0.95 < figures["bench_2/own/oracle/upright"]
    )


def test_walks_that_diverged_are_in_no_figure():
    walks = invented({"sampled_prior": 1.0, "oracle": 1.0})
    for walk in walks[:3]:
        walk["upright"] = walk["speed"] = float("nan")
    figures = summarise(walks).as_results().to_figures()
    assert (
        all(np.isfinite(value) for value in figures.values())
        and figures["own/sampled_prior/upright"] > 0.95
    )
