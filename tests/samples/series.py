"""Series of training data from their first channels."""

import numpy as np

from motorprior.identification.windows import CHANNELS, KD, KP, POS, READING, SUPPLY


def complete(series: np.ndarray) -> np.ndarray:
    """The series with all channels: gains and supply factor of 1, zeros in the others.

    The reading of the encoder is the position.
    """
    missing = CHANNELS - series.shape[-1]
    whole = np.pad(series, [(0, 0)] * (series.ndim - 1) + [(0, missing)])
    whole[..., [KP, KD, SUPPLY]] = 1.0
    whole[..., READING] = whole[..., POS]
    return whole
