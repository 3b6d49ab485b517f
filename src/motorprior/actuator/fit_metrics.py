"""Metrics of the fit of a motor prior, saved in its file."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import TABLE, Field, is_number, many, number
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema

# upper bound of the joint's speed in each pool of residuals [rad/s]; residuals grow with speed
SPEED_POOLS = {"slow": 0.3, "medium": 2.0, "fast": math.inf}
RESIDUAL_LEVELS = tuple(range(5, 100, 5))  # percentiles of the residuals that are saved [%]


@dataclass(frozen=True)
class LossStatistics:
    """Window losses of the training motors at their posterior means.

    A block is BLOCK seconds of log (`reference`).
    """

    mean: float  # mean window loss of all motors
    log_mean: float  # mean over motors of log(mean window loss of a motor)
    log_std: float  # its standard deviation over motors
    motors: int  # number of motors
    blocks: float  # number of blocks per motor
    # variance of the blocks' mean losses within a motor, over its mean loss squared
    block_variance: float


@dataclass(frozen=True)
class FitMetrics:
    """Metrics of a fit. None, or an empty collection, stands for a metric that was not measured."""

    final_loss: float | None = None
    minutes_of_log: float | None = None  # of all motors together
    aggregate_posterior_kl: float | None = None  # of the posteriors from N(0, I) [nat]
    losses: LossStatistics | None = None
    # the same without the log's torques, if it has any: for new motors whose log has none
    losses_without_torque: LossStatistics | None = None
    # (speed pools, RESIDUAL_LEVELS) percentiles of recorded minus simulated angles [rad]
    residual_percentiles: tuple[tuple[float, ...], ...] = ()
    replay_rmse: float | None = None  # median over motors [rad]
    unexplained: float | None = None  # median of `LogErrors.unexplained` over motors [-]
    # factor by which residuals grow from the rows of a fit to later rows [-], and the standard
    # deviation of its logarithm over motors
    residual_growth: float = 1.0
    residual_growth_std: float = 0.0
    # optional term that was tried -> share of the held-out loss that it saves; negative: it costs
    saved_loss: Mapping[str, float] = field(default_factory=dict)
    # constant -> whether the logs identify it
    identified: Mapping[str, bool] = field(default_factory=dict)
    # limit -> its maximum over the motors whose logs do not identify it [SI]
    unidentified_limits: Mapping[str, float] = field(default_factory=dict)
    unknown_torque_scales: int = 0  # number of motors whose logs do not identify their torque scale

    def losses_for(self, has_torque: bool) -> LossStatistics:
        """Losses that new logs are compared with, with or without torques.

        Raises ArtifactError if they were not measured.
        """
        losses = self.losses if has_torque else self.losses_without_torque
        if losses is None:
            raise ArtifactError("no losses of the training motors", remedy=_REMEDY)
        return losses

    @property
    def residuals(self) -> np.ndarray:
        """(pools, levels) `residual_percentiles`; ArtifactError for a prior without them."""
        if not self.residual_percentiles:
            problem = "no residuals: the prior was not trained in closed loop"
            raise ArtifactError(problem, remedy="identify it with preset rollout")
        return np.array(self.residual_percentiles)

    def as_json(self) -> dict[str, Any]:
        """The metrics that were measured, as JSON values."""
        table = {}
        for name, value in asdict(self).items():
            if value is not None and value not in ((), {}):
                table[name] = value
        return table

    @classmethod
    def from_json(cls, table: Mapping[str, Any], where: str | Path) -> "FitMetrics":
        """Metrics from the header of a prior's file; ArtifactError for unknown keys or values."""
        _SCHEMA.check(table, where)
        values = dict(table)
        for name in ("losses", "losses_without_torque"):
            if name in values:
                _LOSSES.check(values[name], where)
                values[name] = LossStatistics(**values[name])
        values["residual_percentiles"] = tuple(map(tuple, values.get("residual_percentiles", ())))
        return cls(**values)


def _of_pools(value: Any) -> bool:
    """Whether a value is a table of percentiles by speed pool."""
    is_list = isinstance(value, list) and len(value) == len(SPEED_POOLS)
    return is_list and all(_PERCENTILES.accepts(row) for row in value)


def _by_name(meaning: str, accepts: Any) -> Field:
    """A table from names to values."""
    return Field(
        f"a table of {meaning}",
        lambda value: isinstance(value, Mapping) and all(map(accepts, value.values())),
    )


_REMEDY = "identify it again with this version"
_PERCENTILES = many(number(), len(RESIDUAL_LEVELS))
_NUMBERS = _by_name("numbers", is_number)
_LOSSES = Schema(
    dict.fromkeys(LossStatistics.__dataclass_fields__, number()), _REMEDY, name="losses"
)
_SCHEMA = Schema(
    {
        **dict.fromkeys(
            (
                "final_loss",
                "minutes_of_log",
                "aggregate_posterior_kl",
                "replay_rmse",
                "unexplained",
                "residual_growth",
                "residual_growth_std",
                "unknown_torque_scales",
            ),
            number(),
        ),
        **dict.fromkeys(("losses", "losses_without_torque"), TABLE),
        "residual_percentiles": Field("percentiles of each speed pool", _of_pools),
        "saved_loss": _NUMBERS,
        "identified": _by_name("true or false", lambda value: isinstance(value, bool)),
        "unidentified_limits": _NUMBERS,
    },
    _REMEDY,
    optional=frozenset(FitMetrics.__dataclass_fields__),
    name="metrics",
)
