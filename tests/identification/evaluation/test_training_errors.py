"""The false-alarm rate of the loss test is the stated one for logs of any length."""

from collections import defaultdict

import numpy as np

from motorprior.evaluation.outliers import loss_p_value
from motorprior.evaluation.training_errors import loss_statistics, windows_per_block
from motorprior.identification.presets import identification_preset

RECIPE = identification_preset("rollout")


def losses_of(rng: np.random.Generator, motors: int, seconds: int) -> np.ndarray:
    """(motors, windows) losses.

    Their logarithms have a standard deviation of 0.5 between motors. The variance of the blocks of
    a motor is 2 times their mean squared.
    """
    length = windows_per_block(RECIPE)
    level = np.exp(-2.0 + 0.5 * rng.standard_normal((motors, 1)))
    log_variance = np.log(1.0 + 2.0)  # of a lognormal block with mean 1 and variance 2
    log_blocks = rng.normal(-0.5 * log_variance, np.sqrt(log_variance), (motors, seconds))
    return np.repeat(level * np.exp(log_blocks), length, axis=1)


def test_false_alarms_are_as_frequent_as_stated_on_logs_of_any_length():
    rng = np.random.default_rng(1)
    counts = (2, 5, 10, 20, 30)
    alarms = defaultdict(list)  # (number of blocks, level) -> share of false alarms
    alarms_without_length = []  # short logs, tested as if they were long

    # every prior is trained on other motors
    for _ in range(100):
        reference = loss_statistics(losses_of(rng, 32, 20), RECIPE)
        assert reference.blocks == 20.0
        for count in counts:
            losses = losses_of(rng, 300, count).mean(axis=1)
            p_values = loss_p_value(reference, losses, float(count))
            for level in (0.01, 0.05):
                alarms[count, level].append(np.mean(p_values < level))
            if count == 2:
                long_p_values = loss_p_value(reference, losses, 20.0)
                alarms_without_length.append(np.mean(long_p_values < 0.01))

    for (count, level), shares in alarms.items():
        assert 0.3 * level < np.mean(shares) < 2.0 * level, (count, level, np.mean(shares))

    assert np.mean(alarms_without_length) > 0.025
