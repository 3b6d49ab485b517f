"""An ideal PD that is told gains in proportion to those that its logs state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd


@dataclass(frozen=True)
class ToldPd:
    """Motors of a PD that was fitted to logs whose stated gains have these medians.

    Attributes:
        pd: the motors at the medians.
        stated: (2,) medians of the stated kp and kd, in the logs' unit.
    """

    pd: IdealPd
    stated: np.ndarray

    def at(self, gains: np.ndarray) -> IdealPd:
        """The motors (M,) that are told gains (2, M).

            kp' = kp·told kp / stated kp,   kd' = kd·told kd / stated kd

        Where the median is 0 that gain stays as it is.
        """
        middle = self.stated[:, None]
        kp, kd = np.where(middle > 0.0, gains / np.where(middle > 0.0, middle, 1.0), 1.0)
        return replace(self.pd, kp=self.pd.kp * kp, kd=self.pd.kd * kd)
