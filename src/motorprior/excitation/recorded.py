"""Streams that play the windows of runs one after the other."""

import numpy as np

from motorprior.excitation.excitation import Rng
from motorprior.excitation.frames import CHANNELS

FADE = 10  # frames of the cross-fade between two windows
FOLLOWERS = 128  # windows from which the next one is chosen


def recorded_stream(windows: np.ndarray, rng: Rng, num_frames: int) -> np.ndarray:
    """(num_frames, CHANNELS) all windows in random order, then again, with cross-faded seams.

    The next window is the one of FOLLOWERS random ones whose targets best continue the last one.
    """
    num_played = -(-num_frames // (windows.shape[1] - FADE))
    played = windows[_order(windows, rng, num_played)]

    rising = (0.5 - 0.5 * np.cos(np.pi * (np.arange(FADE) + 0.5) / FADE))[:, None]
    falling = rising[::-1]
    played[1:, :FADE] = rising * played[1:, :FADE] + falling * played[:-1, -FADE:]
    return played[:, :-FADE].reshape(-1, CHANNELS)[:num_frames]


def _order(windows: np.ndarray, rng: Rng, num_played: int) -> list[int]:
    """Indices of the windows to play."""
    last = rng.integers(len(windows))
    not_played = np.empty(0, int)
    order = []
    for _ in range(num_played):
        if not len(not_played):
            not_played = rng.permutation(len(windows))

        candidates = not_played[:FOLLOWERS]
        seams = windows[candidates, :FADE, 0] - windows[last, -FADE:, 0]
        best = int(np.argmin(np.sum(seams**2, axis=1)))

        last = not_played[best]
        not_played = np.delete(not_played, best)
        order.append(last)
    return order
