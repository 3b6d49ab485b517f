"""The table of results: selection of rows, names of figures, and the file of rows."""

from pathlib import Path

import pytest

from motorprior.results import Result, Results, read_results, write_results

WALKS = Results(
    Result("speed", "m/s", value, model, motors, seed=seed)
    for model, values in (("rollout", (0.2, 0.4)), ("ideal_pd", (0.1, 0.3)))
    for motors in ("own", "twin")
    for seed, value in enumerate(values)
)
ERRORS = Results(
    Result("standing_rmse", "rad", value, "rollout", motors, statistic)
    for motors, statistic, value in (
        ("train", "median", 0.01),
        ("train", "mean", 0.02),
        ("held_out", "median", 0.03),
        ("held_out", "mean", 0.04),
    )
)
MIXED = Results(
    (
        Result("real_rmse", "rad", 0.1, "rollout", statistic="median", log="1_joint"),
        Result(
            "real_joint_rmse",
            "rad",
            0.1,
            "rollout",
            statistic="median",
            log="1_joint",
            part="FR_hip",
        ),
        Result("two_sample_auc", "1", 0.7, statistic="high"),
        Result("adapt_rmse_ratio", "1", 1.2, motors="held_out", seconds=2.5),
        Result("identify_seconds", "s", 3.0, "rollout"),
    )
)


def test_rows_are_selected_by_their_columns():
    twin = WALKS.where(motors="twin", model="rollout")

    assert [row.value for row in twin] == [0.2, 0.4]
    assert twin.mean() == pytest.approx(0.3)
    assert WALKS.distinct("model") == ["rollout", "ideal_pd"]
    assert WALKS.value(model="ideal_pd", motors="own", seed=1) == 0.3
    assert len(WALKS.where(model=("rollout", "ideal_pd"))) == 8
    assert len(MIXED.where(log=None)) == 3


def test_names_of_figures_are_made_from_the_columns():
    assert WALKS.where(model="rollout", motors="twin").to_figures() == {
        "twin_speed/rollout/seed_0": 0.2,
        "twin_speed/rollout/seed_1": 0.4,
        "twin_speed/rollout": pytest.approx(0.3),
    }
    assert ERRORS.to_figures() == {
        "standing_rmse/rollout": 0.01,
        "standing_rmse/rollout/train": 0.01,
        "standing_rmse_mean/rollout": 0.02,
        "standing_rmse_mean/rollout/train": 0.02,
        "standing_rmse/rollout/held_out": 0.03,
        "standing_rmse_mean/rollout/held_out": 0.04,
    }
    assert MIXED.to_figures() == {
        "real_rmse/1_joint/rollout": 0.1,
        "real_joint_rmse/1_joint/FR_hip/rollout": 0.1,
        "two_sample_auc/high": 0.7,
        "adapt_rmse_ratio/2.5": 1.2,
        "identify_seconds/rollout": 3.0,
    }


def test_written_results_are_read_as_the_same_rows(tmp_path: Path):
    table = WALKS + ERRORS + MIXED
    write_results(tmp_path, table)

    assert read_results(tmp_path) == table
