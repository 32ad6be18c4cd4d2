"""What an arrival leaves behind and what fades in the dwell that follows: creep, or a swing that dies away."""

import numpy as np

from stepdiag_ros.effects.base import StopView
from stepdiag_ros.effects.made import Made
from stepdiag_ros.model.log import NONE


def last_arrivals(view: StopView) -> tuple[np.ndarray, np.ndarray]:
    """The axis (n, 3) that arrived last at each stop, no one where that is long ago, and how long [s] (n,) before the
    dwell it did."""
    moved, before = view.axis[:, None] == np.arange(3), np.zeros(len(view.axis))
    # A run that begins where the last one ended has what is left of its last arrival.
    step = np.diff(view.commanded, axis=0, prepend=np.inf)
    stayed = (view.axis == NONE) & (step == 0.0).all(axis=1) & (np.diff(view.setup, prepend=-1) == 0)
    for i in np.flatnonzero(stayed):
        moved[i], before[i] = moved[i - 1], before[i - 1] + view.time[i] - view.time[i - 1]
    return moved, before


def by_last_moves(view: StopView, moved: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """Derivatives (k, n, c) after the last move of each axis, in the direction in which it was, (3·k, n, c); ``moved``
    (n, 3) as :func:`last_arrivals` says."""
    return np.einsum('ni,knc->iknc', moved * view.approach, derivative).reshape(-1, *derivative.shape[1:])


def _at_rest(along: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Directions (a, n, c) times each mean (k, n) over the dwells: (a·k, n, c)."""
    return np.einsum('anc,kn->aknc', along, mean).reshape(-1, *along.shape[1:])


def _inside(along: np.ndarray, departures: np.ndarray) -> np.ndarray:
    """The same by the departures (k, n, b) from it inside the dwells: (a·k, n, b, c)."""
    n, c = along.shape[1:]
    return np.einsum('anc,knb->aknbc', along, departures).reshape(-1, n, departures.shape[2], c)


def fading_columns(along: np.ndarray, shapes: np.ndarray) -> tuple[Made, Made]:
    """What fades in ``shapes`` (k, n, b) along directions (a, n, c) does at the stops, (a·k, n, c), and inside the
    dwells, (a·k, n, b, c)."""
    mean, (n, c) = shapes.mean(axis=2), along.shape[1:]
    size, bins = len(along) * len(shapes), shapes.shape[2]
    return (Made((size, n, c), _at_rest, along, mean),
            Made((size, n, bins, c), _inside, along, shapes - mean[:, :, None]))


def bin_means(middle: np.ndarray, tau: complex) -> np.ndarray:
    """Means of ``exp(−t/τ)`` (n, b), which swings where ``tau`` is complex, over bins of equal width around
    ``middle`` (n, b) [s]."""
    width = np.mean(np.diff(middle, axis=1), axis=1, keepdims=True) if middle.shape[1] > 1 else 2.0 * middle
    half = np.maximum(width, 1e-9 * abs(tau)) / (2.0 * tau)
    return np.exp(-middle / tau) * np.sinh(half) / half


def swing_means(middle: np.ndarray, tau: float, hertz: float) -> np.ndarray:
    """Bin means (2, n, b) of ``exp(−t/τ) cos 2πft`` and ``exp(−t/τ) sin 2πft``, ``tau`` [s], ``hertz`` = f."""
    turning = bin_means(middle, 1.0 / (1.0 / tau - 2.0j * np.pi * hertz))
    return np.stack([turning.real, turning.imag])
