"""The coordinates of `actuator.estimates`, for the unknowns of a fit."""

import numpy as np

from motorprior.actuator.estimates import coordinate, scale_of, value_at
from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import SIGNED
from motorprior.identification.physics.effect_scales import effect_scale
from motorprior.identification.physics.window_runs import WindowRuns


class Coordinates:
    """The map between unknowns x of the fit and coordinates y of M motors.

    Attributes:
        names: (K) names of the constants.
        x: (M, K) unknowns of the fit.
        scale: (M, K) scales s [SI], see `Estimates`.

    A constant has no effect below the value that the errors hide, (M,) in ``hidden`` by its name.
    """

    def __init__(
        self, model: GreyBox, runs: WindowRuns, x: np.ndarray, hidden: dict[str, np.ndarray]
    ):
        self.names = parameters_of(model.terms)
        self.x = x
        self._center = model.center
        self.scale = np.zeros_like(x)
        values = model.constants(x)
        for column, name in enumerate(self.names):
            scale = effect_scale(name, values, runs)
            self.scale[:, column] = np.maximum(scale, hidden.get(name, 0.0))

    def moved(self, column: int, y_change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns (M,) of a constant at y + y_change (M,), and the real change of y (M,).

        The change is smaller where it would leave the reach of the decoder.
        """
        name = self.names[column]
        y = self.of_fit(column)
        value = value_at(name, y + y_change, self.scale_of(column))
        if name in SIGNED:
            moved = value / SIGNED[name] - self._center[column]
        else:
            with np.errstate(divide="ignore"):
                moved = np.log(value) - self._center[column]
        moved = np.clip(moved, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        return moved, self._of(column, moved) - y

    def half_width(self, column: int, size: np.ndarray) -> np.ndarray:
        """(M,) widths to both sides in y that hold v ± ``size`` (M,) of a positive constant v.

        A width is the linear one, which reaches further upwards, or the exact one downwards if that
        is larger. For a gear stiffness, v and ``size`` are of the compliance.
        """
        # y = log(v + s)
        sum_of_both = np.exp(self.of_fit(column))
        below = np.minimum(size, sum_of_both - self.scale[:, column])
        return np.maximum(size / sum_of_both, -np.log1p(-below / sum_of_both))

    def changes(self, x: np.ndarray) -> np.ndarray:
        """(M, K) changes of y from the fit to the unknowns x (M, K)."""
        changes = [
            self._of(column, x[:, column]) - self.of_fit(column) for column in range(x.shape[1])
        ]
        return np.stack(changes, axis=1)

    def of_fit(self, column: int) -> np.ndarray:
        """(M,) coordinates y of a constant of the fitted motors."""
        return self._of(column, self.x[:, column])

    def scale_of(self, column: int) -> np.ndarray:
        """(M,) scales s of a constant; limits have none."""
        return scale_of(self.scale, self.names[column], column)

    def _of(self, column: int, x: np.ndarray) -> np.ndarray:
        """(M,) coordinates y of a constant at unknowns x (M,)."""
        name = self.names[column]
        raw = x + self._center[column]
        value = raw * SIGNED[name] if name in SIGNED else np.exp(raw)
        return coordinate(name, value, self.scale_of(column))
