"""Means of samples for plots, about twenty a second: what a viewer can follow and a bag does not feel."""

import numpy as np

PERIOD_S = 0.05


class Decimator:
    """Averages as many blocks as come nearest to :data:`PERIOD_S`; blocks that are longer are one mean each."""

    def __init__(self) -> None:
        self._blocks: list[np.ndarray] = []
        self._begin_ns = 0
        self._span_s = 0.0

    def add(self, stamp_ns: int, period_s: float, samples: np.ndarray) -> tuple[int, np.ndarray] | None:
        """Samples (n, k) from ``stamp_ns`` on; the time of their middle [ns] and all (m, k) when they are enough."""
        begin_s = (stamp_ns - self._begin_ns) * 1e-9
        if self._blocks and abs(begin_s - self._span_s) > PERIOD_S:
            self._blocks.clear()    # a hole, or another time: what was before it belongs to no mean
        if not self._blocks:
            self._begin_ns, begin_s = stamp_ns, 0.0
        self._blocks.append(samples)
        self._span_s = begin_s + len(samples) * period_s
        # A polled instrument's block may be a sample short: half a block less than the period is enough.
        if self._span_s + 0.5 * len(samples) * period_s < PERIOD_S:
            return None
        whole = np.concatenate(self._blocks)
        self._blocks.clear()
        return self._begin_ns + round(0.5e9 * (self._span_s - period_s)), whole


def mean(values: np.ndarray) -> float:
    """The mean of what is a number; NaN where nothing is."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if there.size else float('nan')
