"""Series of training data from their first channels."""

import numpy as np

from motorprior.identification.windows import CHANNELS, KD, KP, POS, READING, SUPPLY


def complete(series: np.ndarray) -> np.ndarray:
    """With zeros for the channels (...) that are not given, gains of 1 and the usual voltage."""
    missing = CHANNELS - series.shape[-1]
    whole = np.pad(series, [(0, 0)] * (series.ndim - 1) + [(0, missing)])
    whole[..., [KP, KD, SUPPLY]] = 1.0
    whole[..., READING] = whole[..., POS]
    return whole
