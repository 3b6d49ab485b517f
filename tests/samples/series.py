"""Series of training data from their first channels."""

import numpy as np

from motorprior.identification.training_data.windows import CHANNELS, SUPPLY


def complete(series: np.ndarray) -> np.ndarray:
    """With zeros for the channels (...) that are not given, and the usual voltage."""
    missing = CHANNELS - series.shape[-1]
    whole = np.pad(series, [(0, 0)] * (series.ndim - 1) + [(0, missing)])
    whole[..., SUPPLY] = 1.0
    return whole
