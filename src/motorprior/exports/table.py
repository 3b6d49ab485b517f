"""Format table: samples, quantiles and correlations of the parameters of plain joints, as JSON."""

from functools import partial
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_json
from motorprior.exports.exporter import Exporter, Request
from motorprior.exports.motion_profile import ACCELERATION, KEY, SPEED
from motorprior.exports.plain_joint import NOT_EXPRESSED, PARAMETERS, replayed, write_plain

FILE = "motors.json"
_QUANTILES = (0.05, 0.5, 0.95)
_SMALLEST = 1e-12  # parameters below have the logarithm of this value


def write_table(request: Request) -> list[Path]:
    """Write the parameters of every sample and joint, their quantiles and their correlations.

    Correlations are between units: of the deviations of logarithms from the mean of each joint.
    """
    samples: dict[str, np.ndarray] = {}  # (K, J)
    for name, (constant, _) in PARAMETERS.items():
        samples[name] = request.constants[constant]
    quantiles = {}
    for name, values in samples.items():
        quantiles[name] = np.quantile(values, _QUANTILES, axis=0).T.tolist()

    path = request.out / FILE
    content = {
        **request.provenance(),
        "units": {name: unit for name, (_, unit) in PARAMETERS.items()},
        "samples": {name: values.tolist() for name, values in samples.items()},
        "quantiles_5_50_95": quantiles,
        "correlation_of_logarithms": _correlation(samples),
    }
    if SPEED in request.constants:
        limits = {name: request.constants[name].tolist() for name in (SPEED, ACCELERATION)}
        content[KEY] = limits
    write_json(path, content)
    return [path]


def _correlation(samples: dict[str, np.ndarray]) -> dict[str, object]:
    """Correlation matrix of the positive parameters; None for fewer than 3 robots."""
    positive = [name for name in samples if name != "offset"]
    # (parameters, K, J)
    logarithms = np.stack([np.log(np.maximum(samples[name], _SMALLEST)) for name in positive])
    if logarithms.shape[1] <= 2:
        return {"order": positive, "matrix": None}

    deviations = logarithms - logarithms.mean(axis=1, keepdims=True)
    columns = deviations.reshape(len(logarithms), -1)
    spread = columns.std(axis=1, keepdims=True)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    matrix = scaled @ scaled.T / scaled.shape[1]
    return {"order": positive, "matrix": matrix.tolist()}


TABLE = Exporter(
    name="table",
    not_expressed=NOT_EXPRESSED,
    write=write_table,
    replay=partial(replayed, write=write_plain),
)
