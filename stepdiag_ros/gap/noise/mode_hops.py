"""Mode hops of the laser, between two units of length: steps inside dwells, each the same share of its length.

A laser that changes between two modes scales all lengths by one factor, then by the other, then back.  In
the stops' means each hop looks like a slip of the counter; inside a dwell, where nothing moves, it is
seen by itself, to nanometres.  A slip is one amount whatever the length and comes back at a reset only; what
steps now up, now down, always by the same share of the length, is a unit that hops.

In each dwell of n samples a step is weighed against a smooth bend (a cubic: what settles or drifts) and one sample
that is far off, all with the noise that the dwells of the log typically have, a first-order autoregression:

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
MOST_CORRELATED = 0.95
"""Correlation of neighbouring samples up to which steps are looked for."""
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
    dwells = [(row, values[lo:hi][np.isfinite(values[lo:hi])]) for row, (lo, hi) in enumerate(table.displacement_rows)]
    dwells = [(row, dwell - dwell[0]) for row, dwell in dwells if len(dwell) >= LEAST_SAMPLES]
    correlation = _correlation([dwell for _, dwell in dwells])
    found = []
    for row, dwell in dwells:
        n = len(dwell)
        shapes = _Shapes.of(n, correlation)
        white = shapes.whitened @ dwell
        along, power = shapes.step @ white, shapes.power
        k = int(np.argmax(along**2 / power))
        flat = white - shapes.level * (shapes.level @ white)
        rest = white - shapes.bend @ (shapes.bend.T @ white)
        # Or one sample is far off, and those after it go with it.
        alone = flat @ flat - np.max(flat**2 / np.maximum(1.0 - shapes.level**2, 1e-9))
        found.append((row, n, shapes.bend.shape[1], along[k] / power[k], power[k],
                      float(flat @ flat) - along[k]**2 / power[k],
                      min(float(rest @ rest), float(alone)), 1.0 - (EDGE + k) / n))
    row, n, free, size, weight, step, bent, behind = np.array(found).reshape(-1, 8).T
    level = float(np.median(bent / (n - free))) if found else 0.0
    if level <= 0.0:
        return np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0)
    gain = 0.5 * (n + PRIOR_DOF) * np.log((bent + PRIOR_DOF * level)
                                          / (np.maximum(step, 0.0) + PRIOR_DOF * level)) - np.log(n)
    seen = gain > least
    return row[seen].astype(int), size[seen], np.sqrt(level / weight[seen]), behind[seen]


def _correlation(dwells: list[np.ndarray]) -> float:
    """Correlation of neighbouring samples: by how much more than those of neighbours the squared differences of every
    second sample are, what drifts taken off, in the median of the dwells, of which few have a step."""
    ratios = []
    for dwell in dwells:
        drift = (dwell[-1] - dwell[0]) / (len(dwell) - 1)
        neighbours, seconds = (np.mean((dwell[k:] - dwell[:-k] - k * drift)**2) for k in (1, 2))
        if neighbours > 0.0:
            ratios.append(seconds / neighbours)
    return float(np.round(np.clip(np.median(ratios) - 1.0, 0.0, MOST_CORRELATED), 2)) if ratios else 0.0


@dataclass(frozen=True)
class _Shapes:
    """What a dwell of n samples of one ``correlation`` may look like.

    ``whitened`` (n, n): what makes it white; all made white, ``bend`` (n, k): orthonormal polynomials up to a cubic, in
    a short dwell up to a parabola; ``level`` (n,): a constant, of length one; ``step`` (s, n): steps beside it, of
    ``power`` (s,).
    """

    whitened: np.ndarray
    bend: np.ndarray
    level: np.ndarray
    step: np.ndarray
    power: np.ndarray

    @staticmethod
    @lru_cache
    def of(n: int, correlation: float) -> '_Shapes':
        whitened = np.eye(n) - correlation * np.eye(n, k=-1)
        whitened[0, 0] = np.sqrt(1.0 - correlation**2)
        bend, _ = np.linalg.qr(whitened @ np.vander(np.linspace(-1.0, 1.0, n), 4 if n >= 2 * LEAST_SAMPLES - 4 else 3))
        level = whitened.sum(axis=1)
        level /= np.linalg.norm(level)
        step = (np.arange(n) >= np.arange(EDGE, n - EDGE + 1)[:, None]) @ whitened.T
        step -= np.outer(step @ level, level)
        return _Shapes(whitened, bend, level, step, np.sum(step**2, axis=1))
