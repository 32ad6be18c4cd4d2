"""Lines in the samples of the dwells: shaking at a few frequencies, told from noise of any smooth spectrum.

A vibration has no fixed phase from dwell to dwell; all it leaves is the covariance of a dwell's samples,
which it makes periodic.  With K dwells of n samples, freed of mean and slope and of what all dwells of
one kind share (creep after a move), the sum of squares S/K is compared with

    C = w (I + r B) + Σ ½ a² (c cᵀ + s sᵀ),      ln L = −½ K (ln|C| + tr C⁻¹ S/K),

B a smooth background (a power law, an exponential or a Gaussian correlation), c and s a cosine and a
sine.  Air that boils, a filter in the sensor or a drift that wanders is a background and no line, and the
white level is measured, not believed.  The likelihood ratio with and without lines is the evidence.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.thresholds import (
    BACKGROUND_ALARM,
    GROWTH_SIGMAS,
    LEAST_GROWTH,
    MISFIT,
    VIBRATION_ALARM,
)
from stepdiag_ros.model.log import CalibrationLog

LEAST_SAMPLES = 5
LEAST_RANK = 3
"""Dimensions that a dwell must have left: in two a line cannot be told from a smooth spectrum."""
LEAST_DWELLS = 24
MOST_SAMPLES = 128
"""Of a dwell; of a longer one the first are taken."""
PADDING = 4
"""Frequencies tried in one over the dwell's length."""
LEAST_CYCLES = 1.0
"""Of a line in a dwell; slower shaking is no more than a bend."""
COHERENT = 4.0
"""Variance between kinds of dwells over that within, above which a pattern belongs to the move."""
MOST_PATTERNS = 5
LATER = 3
"""Powers of the time between a dwell's begin and its first sample with which a move's pattern may go: what creeps
or rings out is seen at other times in each dwell."""
HELD = 4.0
"""Powers of single dwells are held to this many medians: a dwell that jumps is no line."""
MOST_LINES = 3
WORTH = 3.0
"""Log likelihood that a background must bring before lines are looked for on top of it."""
RATIOS = np.concatenate([[0.0], np.logspace(-2.0, 6.0, 81)])
"""Sizes of the background against the white noise that are tried."""
SIZES = np.logspace(-2.5, 5.5, 33)
"""Powers of a line in one sample against the white noise that are tried."""


@dataclass(frozen=True)
class Vibration:
    """Lines in the dwells' spectrum: ``frequency`` [Hz] of the strongest (as sampled: it may be an alias),
    its ``amplitude`` and ``sigma`` [m]; ``log_bayes`` of ``lines`` lines against a smooth spectrum;
    ``share`` of them in the dwells' variance; ``powers`` [m²]: variance of each line in one sample."""

    frequency: float
    amplitude: float
    sigma: float
    log_bayes: float
    share: float
    lines: tuple[float, ...] = ()
    powers: tuple[float, ...] = ()

    def variance(self, length: float) -> float:
        """Variance [m²] that the lines bring into means over ``length`` [s]."""
        return sum(p * np.sinc(f * length) ** 2 for f, p in zip(self.lines, self.powers, strict=True))


@dataclass(frozen=True)
class Unrest:
    """What the samples of the dwells show besides white noise.

    ``displacement`` and ``spot``: lines of each, None where dwells are too short to tell; ``slow``: log
    evidence for a smooth background in the displacement, ``slow_spot`` in the spot; ``growth``: exponent
    with which the displacement's unrest grows with the path, and ``growth_sigma`` (infinite: not seen);
    ``power`` (n,) [m²]: of that unrest at each stop, per e-fold of frequency.
    """

    displacement: Vibration | None
    spot: Vibration | None
    slow: float
    slow_spot: float
    growth: float
    growth_sigma: float
    power: np.ndarray

    @property
    def shakes(self) -> bool:
        """Whether the tool point shakes: lines that no smooth spectrum explains, alike near and far."""
        return self._clear(self.displacement, self.slow) and not self.boils

    @property
    def boils(self) -> bool:
        """Whether slow noise grows with the path, as that of moving air does and shaking does not."""
        return self.slow > BACKGROUND_ALARM and self.growth > LEAST_GROWTH \
            and self.growth > GROWTH_SIGMAS * self.growth_sigma

    @property
    def hums(self) -> bool:
        """Whether the spot alone swings: no motion that the displacement sees."""
        return self._clear(self.spot, self.slow_spot) and not self.shakes

    @staticmethod
    def _clear(lines: Vibration | None, slow: float) -> bool:
        # No smooth form holds to the last part: what it leaves of much noise is not yet a line.
        return lines is not None and lines.log_bayes > VIBRATION_ALARM + MISFIT * slow


@dataclass(frozen=True)
class Dwells:
    """Samples of K dwells of n, freed of mean, slope and what the move leaves: ``values`` (K, m), ``basis``
    (n, m) orthonormal; ``rows`` (K,) their stops; ``period`` [s]."""

    values: np.ndarray
    basis: np.ndarray
    rows: np.ndarray
    period: float

    @property
    def length(self) -> float:
        return len(self.basis) * self.period


def unrest(log: CalibrationLog, table: StopTable, distance: np.ndarray) -> Unrest:
    """What the samples inside the dwells show; ``distance`` (n,) [m] of the stops to the mirror."""
    kind = (table.setup * 256 + table.axis) * 3 + table.direction
    beams = dwells_of(log.displacement.values.mean(axis=1), log.displacement.time_ns,
                      table.displacement_rows, kind, table.dwell_ns)
    lines, slow = find_lines(beams) if beams else (None, 0.0)
    growth, sigma, power = growth_with(beams, distance) if beams else \
        (0.0, np.inf, np.zeros(len(table)))
    spots = [(None, 0.0)]
    for column in log.spot.values.T:
        dwells = dwells_of(column, log.spot.time_ns, table.spot_rows, kind, table.dwell_ns)
        if dwells is not None:
            spots.append(find_lines(dwells))
    spot, slow_spot = max(spots, key=lambda s: s[0].log_bayes - MISFIT * s[1] if s[0] else -np.inf)
    return Unrest(lines, spot, slow, slow_spot, growth, sigma, power)


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
    full = np.isfinite(values[index]).all(axis=1)
    chosen, index = chosen[full], index[full]
    if len(chosen) < LEAST_DWELLS:
        return None
    period = float(np.median(np.diff(time_ns[index], axis=1))) * 1e-9
    if period <= 0.0:
        return None
    place = np.linspace(-1.0, 1.0, size)
    dwells = values[index] - values[index[:, :1]]
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
    return Dwells(inside, basis, chosen, period)


def _of_the_move(dwells: np.ndarray, kind: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Orthonormal patterns (n, p) in which dwells (K, n) differ more from kind to kind, and with the time
    ``later`` (K,) [samples] at which their first sample was taken, than otherwise."""
    power = np.sum(dwells**2, axis=1)
    calm = dwells * np.sqrt(np.minimum(1.0, HELD * np.median(power) / np.maximum(power, 1e-300)))[:, None]
    alike, terms = np.empty_like(calm), 0
    for number in np.unique(kind):
        mine = kind == number
        courses = np.vander(later[mine], LATER) if mine.sum() > 2 * LATER else np.ones((mine.sum(), 1))
        directions, size, _ = np.linalg.svd(courses, full_matrices=False)
        directions = directions[:, size > 1e-6 * size[0]]
        alike[mine] = directions @ (directions.T @ calm[mine])
        terms += directions.shape[1]
    _, _, pattern = np.linalg.svd(alike, full_matrices=False)
    pattern = pattern[:MOST_PATTERNS]
    between = np.sum((alike @ pattern.T) ** 2, axis=0) / terms
    inside = np.sum(((calm - alike) @ pattern.T) ** 2, axis=0) / max(len(calm) - terms, 1)
    return pattern[between > COHERENT * np.maximum(inside, 1e-300)].T


@lru_cache(maxsize=8)
def _backgrounds(size: int) -> tuple[np.ndarray, ...]:
    """Covariances (n, n) of smooth noise, of size 1 in a sample."""
    return tuple(_smooth(size))


def _smooth(size: int) -> Iterator[np.ndarray]:
    lag = np.abs(np.subtract.outer(np.arange(size), np.arange(size)))
    for width in (0.5, 1.5, size / 8.0, size / 2.0):
        yield np.exp(-lag / width)
    for width in (0.8, size / 16.0, size / 8.0):
        yield np.exp(-0.5 * (lag / width) ** 2)
    frequency = np.geomspace(0.05, size / 2.0, 200) / size
    for power in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0):
        weight = frequency ** (1.0 - power)
        yield np.cos(2.0 * np.pi * lag[..., None] * frequency) @ (weight / weight.sum())


def _likelihood(covariance: np.ndarray, moment: np.ndarray, count: int) -> tuple[float, float]:
    """ln L and the white level of dwells whose covariance is known but for its size."""
    factor = np.linalg.cholesky(covariance)
    half = np.linalg.solve(factor, moment)
    level = float(np.trace(np.linalg.solve(factor, half.T))) / len(moment)
    return -0.5 * count * (2.0 * float(np.sum(np.log(np.diag(factor))))
                           + len(moment) * (np.log(level) + 1.0)), level


def find_lines(dwells: Dwells) -> tuple[Vibration | None, float]:
    """Lines in dwells, or None where too few samples can tell; log likelihood ratio of the best smooth
    background against white noise."""
    count, size = len(dwells.values), len(dwells.basis)
    rank = dwells.basis.shape[1]
    moment = dwells.values.T @ dwells.values / count
    # At half the sampling rate itself a sine is not seen.
    cycles = np.arange(LEAST_CYCLES, (size - 0.5) / 2.0, 1.0 / PADDING)
    if rank < LEAST_RANK or len(cycles) < 4:
        return None, 0.0
    turn = 2.0 * np.pi * np.outer(np.arange(size), cycles) / size
    waves = np.stack([dwells.basis.T @ np.cos(turn), dwells.basis.T @ np.sin(turn)], axis=2)
    # A line that the mean, the slope or the creep takes away is not seen.
    usable = np.sum(waves**2, axis=(0, 2)) > 0.4 * size
    waves, cycles = waves[:, usable], cycles[usable]
    if len(cycles) < 4:
        return None, 0.0
    nothing = np.eye(rank)
    null = plain = _likelihood(nothing, moment, count)[0]
    grounds = [nothing]
    for background in _backgrounds(size):
        inner = dwells.basis.T @ background @ dwells.basis
        ratio, log = _background(inner, moment, count)
        null = max(null, log)
        if log > plain + WORTH:
            # With lines beside it, less of it may be enough.
            grounds += [nothing + ratio / less * inner for less in (1.0, 3.0, 10.0)]
    price = np.log(len(cycles) / PADDING) + 1.0
    best, lines, powers = -np.inf, (), ()
    for covariance in grounds:
        chosen: list[int] = []
        heights: list[float] = []
        last = -np.inf
        while len(chosen) < MOST_LINES:
            k, height = _next_line(covariance, moment, waves, count)
            covariance = covariance + height * waves[:, k] @ waves[:, k].T
            chosen.append(k)
            heights.append(height)
            log, level = _likelihood(covariance, moment, count)
            log -= price * len(chosen)
            if log < last:
                break
            last = log
            if log > best:
                best, lines, powers = log, tuple(chosen), tuple(h * level for h in heights)
    strongest = int(np.argmax(powers))
    amplitude = float(np.sqrt(2.0 * powers[strongest]))
    k = lines[strongest]
    excess = powers[strongest] * float(np.sum(waves[:, k] ** 2)) / 2.0
    noise = max(float(np.trace(moment)) - sum(powers) * size, 0.0) / rank
    sigma = amplitude * (1.0 + noise / max(excess, 1e-300)) / np.sqrt(4.0 * count)
    share = min(sum(powers) * size / max(float(np.trace(moment)), 1e-300), 1.0)
    return Vibration(float(cycles[k] / dwells.length), amplitude, float(sigma),
                     float(min(best - null, 1e4)), float(share),
                     tuple(float(cycles[i] / dwells.length) for i in lines), powers), null - plain


def _background(inner: np.ndarray, moment: np.ndarray, count: int) -> tuple[float, float]:
    """Size of a background against the white noise that suits best, and ln L with it."""
    value, vector = np.linalg.eigh(inner)
    power = np.einsum('ij,ik,kj->j', vector, moment, vector)
    growth = 1.0 + RATIOS[:, None] * np.maximum(value, 0.0)
    level = np.mean(power / growth, axis=1)
    logs = -0.5 * count * (np.sum(np.log(growth), axis=1) + len(value) * (np.log(level) + 1.0))
    best = int(np.argmax(logs))
    return float(RATIOS[best]), float(logs[best])


def _next_line(base: np.ndarray, moment: np.ndarray, waves: np.ndarray,
               count: int) -> tuple[int, float]:
    """The line that raises the likelihood most: its number, its power in a sample over the white level."""
    rank, number, _ = waves.shape
    inverse = np.linalg.inv(base)
    flat = waves.reshape(rank, -1)
    seen = (inverse @ flat).reshape(rank, number, 2)
    level = float(np.trace(inverse @ moment)) / rank
    over = (moment @ seen.reshape(rank, -1)).reshape(rank, number, 2) / level
    along = np.einsum('rfi,rfj->fij', waves, seen)
    power = np.einsum('rfi,rfj->fij', seen, over)
    root = np.linalg.cholesky(along + 1e-12 * np.eye(2))
    turned = np.linalg.solve(root, np.linalg.solve(root, power).transpose(0, 2, 1))
    # Both parts of a line are about equally well seen: one size serves them.
    strength = np.einsum('fii->f', along)[:, None] / 2.0 * SIZES
    mean = np.einsum('fii->f', turned)[:, None] / 2.0
    gain = count * (mean * strength / (1.0 + strength) - np.log1p(strength))
    f, s = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return int(f), float(SIZES[s])


def growth_with(dwells: Dwells, distance: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Exponent with which the dwells' unrest grows with ``distance`` (stops,), its σ, and the unrest's
    power (stops,) per e-fold of frequency by that law.

    The power of the slow half of the spectrum, above that of the fast half, is fitted as c dᵖ.  Of noise as 1/f the
    k-th half wave has 1/k of what an e-fold has.
    """
    size = len(dwells.basis)
    waves = np.arange(2, max(size // 4, 4))
    slow = np.linalg.qr(dwells.basis.T @ np.cos(np.pi * np.outer(np.arange(size) + 0.5, waves) / size))[0]
    power = np.sum((dwells.values @ slow) ** 2, axis=1)
    rest = np.sum(dwells.values**2, axis=1) - power
    white = np.median(rest) / max(dwells.basis.shape[1] - slow.shape[1], 1) * slow.shape[1]
    far = distance[dwells.rows]
    kept = np.isfinite(far) & (far > 0.0)
    if kept.sum() < LEAST_DWELLS or np.ptp(np.log(far[kept])) < 0.3:
        return 0.0, np.inf, np.zeros(len(distance))
    order = np.argsort(far[kept])
    place, excess = np.log(far[kept])[order], (power[kept] - white)[order]
    parts = np.array_split(np.arange(len(order)), 6)
    x = np.array([place[p].mean() for p in parts])
    mean = np.array([excess[p].mean() for p in parts])
    error = np.array([excess[p].std() / np.sqrt(len(p)) for p in parts])
    if (mean > 0.0).sum() < 3 or mean.sum() < 6.0 * np.sqrt(np.sum(error**2)):
        return 0.0, np.inf, np.zeros(len(distance))
    mean = np.maximum(mean, error)
    y, weight = np.log(mean), (mean / np.maximum(error, 1e-300)) ** 2
    middle = float(np.sum(weight * x) / weight.sum())
    x = x - middle
    slope = float(np.sum(weight * x * y) / np.sum(weight * x * x))
    level = float(np.sum(weight * y) / weight.sum())
    misfit = y - level - slope * x
    spread = max(float(np.sum(weight * misfit**2)) / (len(x) - 2), 1.0)
    near = np.log(np.where(np.isfinite(distance) & (distance > 0.0), distance, np.exp(middle))) - middle
    return slope, float(np.sqrt(spread / np.sum(weight * x * x))), \
        np.exp(level + slope * near) / size / float(np.sum(1.0 / waves))
