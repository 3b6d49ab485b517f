"""The false-alarm rate of the loss test is the stated one for logs of any length."""

import numpy as np

from motorprior.evaluation.outliers import loss_p_value
from motorprior.evaluation.reference import loss_statistics, windows_per_block
from motorprior.identification.presets import identification_preset

RECIPE = identification_preset("rollout")


def losses_of(rng: np.random.Generator, motors: int, seconds: int) -> np.ndarray:
    """(motors, windows) losses.

    Logarithms have a standard deviation of 0.5 between motors, blocks a variance of 2 over the
    mean squared.
    """
    length = windows_per_block(RECIPE)
    level = np.exp(-2.0 + 0.5 * rng.standard_normal((motors, 1)))
    of_pieces = np.exp(rng.normal(-0.5 * np.log(3.0), np.sqrt(np.log(3.0)), (motors, seconds)))
    return np.repeat(level * of_pieces, length, axis=1)


def test_false_alarms_are_as_frequent_as_stated_on_logs_of_any_length():
    rng = np.random.default_rng(1)
    counts = (2, 5, 10, 20, 30)
    alarms = {(count, level): [] for count in counts for level in (0.01, 0.05)}
    as_if_long = []
    for _ in range(100):  # priors, each trained on motors of its own
        reference = loss_statistics(losses_of(rng, 32, 20), RECIPE)
        assert reference.blocks == 20.0
        for count in counts:
            losses = losses_of(rng, 300, count).mean(axis=1)
            found = loss_p_value(reference, losses, float(count))
            for level in (0.01, 0.05):
                alarms[count, level].append(np.mean(found < level))
            if count == 2:
                as_if_long.append(np.mean(loss_p_value(reference, losses, 20.0) < 0.01))
    for (count, level), shares in alarms.items():
        assert 0.3 * level < np.mean(shares) < 2.0 * level, (count, level, np.mean(shares))
    assert np.mean(as_if_long) > 0.025
