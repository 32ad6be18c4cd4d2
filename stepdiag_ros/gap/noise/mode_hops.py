"""Mode hops of the laser, between two units of length: steps inside dwells, each the same share of its length.

A laser that changes between two modes scales all lengths by one factor, then by the other, then back.  In
the stops' means each hop looks like a slip of the counter; inside a dwell, where nothing moves, it is
seen by itself, to nanometres.  A slip is one amount whatever the length and comes back at a reset only; what
steps now up, now down, always by the same share of the length, is a unit that hops.

In each dwell of n samples a step is weighed against a smooth bend (a cubic: what settles or drifts), both
with the noise that the dwells of the log typically have:

    gain = ½ (n + ν) ln((RSS_bend + ν σ²) / (RSS_step + ν σ²)) − ln n.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.constants import LEAST_HOPS, SUSPICION
from stepdiag_ros.model.log import Samples

LEAST_SAMPLES = 6
EDGE = 2
"""Fewest samples on either side of a step."""
PRIOR_DOF = 10.0
"""ν: degrees of freedom by which the log's typical noise is known to hold in one dwell."""
ALIKE = 0.05
"""Share by which steps of one unit may differ: the lengths are the fit's, the step lasts part of a sample."""
ALARM = 3.0
"""Log evidence by which shares of the length must hold better than one amount for all."""


@dataclass(frozen=True)
class ModeHops:
    """``unit``: share by which lengths hop; ``rows`` (k,): stops in whose dwells a step was seen.

    As noise: lengths are in one of two states ``step`` (n,) [m] apart, which change ``per_s`` times a second;
    ``inside`` (n,) [m²]: variance of a sample about the dwell's mean, by steps that were not seen.
    """

    unit: float
    rows: np.ndarray
    step: np.ndarray
    per_s: float
    inside: np.ndarray

    @property
    def words(self) -> str:
        return (f'displacement: lengths hop to and fro by {self.unit * 1e9:.3g} nm in each metre while the machine '
                f'stands, seen in {len(self.rows)} dwells (look at the laser: is it locked to one mode?)')


def mode_hops(samples: Samples, table: StopTable, distance: np.ndarray) -> ModeHops | None:
    """Mode hops, None where none are seen; ``distance`` (n,) [m] of the stops to the mirror."""
    rows, size, sigma, _ = steps(samples.values.mean(axis=1), table)
    far = distance[rows]
    kept = np.isfinite(far) & (far > 0.0)
    rows, size, sigma, far = rows[kept], np.abs(size[kept]), sigma[kept], far[kept]
    if len(rows) < LEAST_HOPS:
        return None
    spread = np.hypot(sigma, ALIKE * size)
    unit, misfit = _common(size / far, spread / far)
    _, constant = _common(size, spread)
    # One amount for all is what a counter loses; shares that agree by chance alone are not enough.
    if 0.5 * (constant - misfit) < ALARM or misfit > len(rows) + ALARM * np.sqrt(2.0 * len(rows)):
        return None
    step = np.where(np.isfinite(distance), unit * distance, 0.0)
    dwells = (table.done_ns - table.dwell_ns) * 1e-9
    often = len(rows) / float(dwells.sum())  # as seen while the machine stood
    return ModeHops(unit, rows, step, often, step**2 / 6.0 * np.minimum(often * dwells, 1.0))


def _common(values: np.ndarray, sigma: np.ndarray) -> tuple[float, float]:
    """Weighted mean and its χ²."""
    mean = float(np.sum(values / sigma**2) / np.sum(sigma**-2.0))
    return mean, float(np.sum(((values - mean) / sigma) ** 2))


def steps(values: np.ndarray, table: StopTable,
          least: float = SUSPICION) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stops (k,) in whose dwells the displacement ``values`` (N,) of the samples steps, with log evidence above
    ``least``; the steps (k,) [m], their standard deviations, and the share of each dwell that lies behind its step."""
    found = []
    for row, (lo, hi) in enumerate(table.displacement_rows):
        dwell = values[lo:hi][np.isfinite(values[lo:hi])]
        n = len(dwell)
        if n < LEAST_SAMPLES:
            continue
        dwell = dwell - dwell[0]
        bend = _bend(n)
        before = np.arange(EDGE, n - EDGE + 1)
        sums = np.cumsum(dwell)
        size = (sums[-1] - sums[before - 1]) / (n - before) - sums[before - 1] / before
        weight = before * (n - before) / n
        k = int(np.argmax(size**2 * weight))
        total = float(np.sum((dwell - sums[-1] / n) ** 2))
        rest = dwell - bend @ (bend.T @ dwell)
        found.append((row, n, bend.shape[1], size[k], weight[k], total - size[k] ** 2 * weight[k],
                      float(rest @ rest), 1.0 - before[k] / n))
    row, n, free, size, weight, step, bent, behind = np.array(found).reshape(-1, 8).T
    level = float(np.median(bent / (n - free))) if found else 0.0
    if level <= 0.0:
        return np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0)
    gain = 0.5 * (n + PRIOR_DOF) * np.log((bent + PRIOR_DOF * level)
                                          / (np.maximum(step, 0.0) + PRIOR_DOF * level)) - np.log(n)
    seen = gain > least
    return row[seen].astype(int), size[seen], np.sqrt(level / weight[seen]), behind[seen]


@lru_cache
def _bend(n: int) -> np.ndarray:
    """Orthonormal polynomials (n, k) up to a cubic; in a short dwell up to a parabola."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), 4 if n >= 2 * LEAST_SAMPLES - 4 else 3))
    return basis
