"""The samples of the dwells, freed of what no noise is: mean, slope and what the moves leave."""

from dataclasses import dataclass

import numpy as np

LEAST_SAMPLES = 5
LEAST_DWELLS = 24
MOST_SAMPLES = 128
"""Of a dwell; of a longer one the first are taken."""
LEAST_THERE = 0.75
"""Share of a dwell's samples that must be there; between them those that are not are put on a straight line."""
COHERENT = 4.0
"""Variance between kinds of dwells over that within, above which a pattern belongs to the move."""
MOST_PATTERNS = 5
LATER = 3
"""Powers of the time between a dwell's begin and its first sample with which a move's pattern may go: what creeps
or rings out is seen at other times in each dwell."""
HELD = 4.0
"""Powers of single dwells are held to this many medians: a dwell that jumps is no line."""


@dataclass(frozen=True)
class Dwells:
    """Samples of K dwells of n, freed of mean, slope and what the move leaves: ``values`` (K, m), ``basis``
    (n, m) orthonormal; ``rows`` (K,) their stops, ``kind`` (K,) of their moves, ``first_s`` (K,) of their
    first samples; ``period`` [s]; ``whole`` (K,): whether none of their samples was put on a line."""

    values: np.ndarray
    basis: np.ndarray
    rows: np.ndarray
    kind: np.ndarray
    first_s: np.ndarray
    period: float
    whole: np.ndarray

    @property
    def length(self) -> float:
        return len(self.basis) * self.period

    @property
    def slow_waves(self) -> np.ndarray:
        """Numbers (s,) of the half waves that count as slow, from one swing in a dwell on."""
        return np.arange(2, max(len(self.basis) // 4, 4))

    def slow_and_fast(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Power (K,) [m²] of each dwell's slow half waves and of the rest, and how many dimensions are slow."""
        size = len(self.basis)
        turns = np.pi * np.outer(np.arange(size) + 0.5, self.slow_waves) / size
        slow = np.linalg.qr(self.basis.T @ np.cos(turns))[0]
        power = np.sum((self.values @ slow) ** 2, axis=1)
        return power, np.sum(self.values**2, axis=1) - power, slow.shape[1]


def dwells_of(values: np.ndarray, time_ns: np.ndarray, rows: np.ndarray,
              kind: np.ndarray, begin_ns: np.ndarray) -> Dwells | None:
    """Dwells ``rows`` (k, 2) of one channel ``values`` (N,); ``kind`` (k,) numbers moves alike, ``begin_ns`` (k,):
    when the dwells began."""
    counts = rows[:, 1] - rows[:, 0]
    sizes = np.unique(counts[counts >= LEAST_SAMPLES])
    if not len(sizes):
        return None
    size = int(max(sizes, key=lambda n: n * np.sum(counts >= n)))
    chosen = np.flatnonzero(counts >= size)
    size = min(size, MOST_SAMPLES)
    index = rows[chosen, :1] + np.arange(size)
    there = np.isfinite(values[index])
    full = there.mean(axis=1) >= LEAST_THERE
    chosen, index, there = chosen[full], index[full], there[full]
    if len(chosen) < LEAST_DWELLS:
        return None
    period = float(np.median(np.diff(time_ns[index], axis=1))) * 1e-9
    if period <= 0.0:
        return None
    place = np.linspace(-1.0, 1.0, size)
    dwells = values[index]
    for k in np.flatnonzero(~there.all(axis=1)):
        dwells[k] = np.interp(np.arange(size), np.flatnonzero(there[k]), dwells[k, there[k]])
    dwells = dwells - dwells[:, :1]
    fixed, _ = np.linalg.qr(np.vander(place, 2))
    dwells = dwells - (dwells @ fixed) @ fixed.T
    later = (time_ns[index[:, 0]] - begin_ns[chosen]) * 1e-9 / period
    patterns = _of_the_move(dwells, kind[chosen], later)
    full_basis, _ = np.linalg.qr(np.column_stack([fixed, patterns]), mode='complete')
    basis = full_basis[:, 2 + patterns.shape[1]:]
    inside = dwells @ basis
    power = np.sum(inside**2, axis=1)
    limit = HELD * np.median(power)
    if limit <= 0.0:
        return None
    inside *= np.sqrt(np.minimum(1.0, limit / np.maximum(power, 1e-300)))[:, None]
    return Dwells(inside, basis, chosen, kind[chosen], (time_ns[index[:, 0]] - time_ns[index[0, 0]]) * 1e-9, period,
                  there.all(axis=1))


def _of_the_move(dwells: np.ndarray, kind: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Orthonormal patterns (n, p) in which dwells (K, n) differ more from kind to kind, and with the time
    ``later`` (K,) [samples] at which their first sample was taken, than otherwise."""
    power = np.sum(dwells**2, axis=1)
    calm = dwells * np.sqrt(np.minimum(1.0, HELD * np.median(power) / np.maximum(power, 1e-300)))[:, None]
    alike, terms = np.empty_like(calm), 0
    for number in np.unique(kind):
        mine = kind == number
        profiles = np.vander(later[mine], LATER) if mine.sum() > 2 * LATER else np.ones((mine.sum(), 1))
        directions, size, _ = np.linalg.svd(profiles, full_matrices=False)
        directions = directions[:, size > 1e-6 * size[0]]
        alike[mine] = directions @ (directions.T @ calm[mine])
        terms += directions.shape[1]
    _, _, pattern = np.linalg.svd(alike, full_matrices=False)
    pattern = pattern[:MOST_PATTERNS]
    between = np.sum((alike @ pattern.T) ** 2, axis=0) / terms
    inside = np.sum(((calm - alike) @ pattern.T) ** 2, axis=0) / max(len(calm) - terms, 1)
    return pattern[between > COHERENT * np.maximum(inside, 1e-300)].T
