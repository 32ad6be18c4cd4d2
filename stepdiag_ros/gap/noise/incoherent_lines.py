"""Lines in the samples of the dwells: shaking at a few frequencies, distinguished from noise of any smooth spectrum.

A vibration has no fixed phase from dwell to dwell; all it leaves is the covariance of a dwell's samples,
which it makes periodic.  With K dwells of n samples, freed of mean and slope and of what all dwells of
one kind share (creep after a move), the sum of squares S/K is compared with

    C = w (I + r B) + Σ ½ a² (c cᵀ + s sᵀ),      ln L = −½ K (ln|C| + tr C⁻¹ S/K),

B a smooth background (a power law, an exponential or a Gaussian correlation), c and s a cosine and a
sine.  Turbulent air, a filter in the sensor or a drift that wanders is a background and no line, and the
white level is measured, not believed.  The likelihood ratio with and without lines is the evidence.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.gap.preprocess.dwells import Dwells

LEAST_RANK = 3
"""Dimensions that a dwell must have left: in two a line is indistinguishable from a smooth spectrum."""
PADDING = 4
"""Frequencies tried in one over the dwell's length."""
LEAST_CYCLES = 1.0
"""Of a line in a dwell; slower shaking is no more than a bend."""
MOST_LINES = 3
WORTH = 3.0
"""Log likelihood that a background must bring before lines are looked for on top of it."""
RATIOS = np.concatenate([[0.0], np.logspace(-2.0, 6.0, 81)])
"""Sizes of the background against the white noise that are tried."""
SIZES = np.logspace(-2.5, 5.5, 33)
"""Powers of a line in one sample against the white noise that are tried."""


@dataclass(frozen=True)
class Vibration:
    """Lines in the dwells' spectrum: ``frequency`` [Hz] of the strongest (as sampled, at ``rate`` [Hz]: it may
    be an alias), its ``amplitude`` and ``sigma`` [m]; ``log_bayes`` of ``lines`` lines against a smooth spectrum;
    ``share`` of them in the dwells' variance; ``powers`` [m²]: variance of each line in one sample; ``coherent``: they
    keep their phase from dwell to dwell; ``log_growth``: log evidence that the strongest grows with the path;
    ``by_dwell`` (K,) [m²]: what single dwells show of the strongest, beyond the noise on average; ``of_few``: the
    quieter dwells do not show them."""

    frequency: float
    amplitude: float
    sigma: float
    log_bayes: float
    share: float
    lines: tuple[float, ...] = ()
    powers: tuple[float, ...] = ()
    coherent: bool = False
    log_growth: float = 0.0
    by_dwell: np.ndarray | None = None
    rate: float = np.inf
    of_few: bool = False

    @property
    def aliases(self) -> tuple[float, float]:
        """The next higher frequencies [Hz] that, sampled so, look the same."""
        return self.rate - self.frequency, self.rate + self.frequency

    def variance(self, length: float) -> float:
        """Variance [m²] that the lines bring into means over ``length`` [s]."""
        return sum(p * np.sinc(f * length) ** 2 for f, p in zip(self.lines, self.powers, strict=True))


@lru_cache(maxsize=8)
def _backgrounds(size: int) -> tuple[np.ndarray, ...]:
    """Covariances (n, n) of smooth noise, of size 1 in a sample."""
    return tuple(_smooth(size))


def _smooth(size: int) -> Iterator[np.ndarray]:
    lag = np.abs(np.subtract.outer(np.arange(size), np.arange(size)))
    # A sensor's neighbouring samples are alike by any share: from one to the next by 0.14 to 0.86 here.
    for width in (0.5, 1.0, 1.5, 2.5, 4.0, 6.5, size / 8.0, size / 2.0):
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
    along, _ = np.linalg.qr(waves[:, k])
    by_dwell = np.sum((dwells.values @ along) ** 2, axis=1) - 2.0 * noise
    share = min(sum(powers) * size / max(float(np.trace(moment)), 1e-300), 1.0)
    return Vibration(float(cycles[k] / dwells.length), amplitude, float(sigma),
                     float(min(best - null, 1e4)), float(share),
                     tuple(float(cycles[i] / dwells.length) for i in lines), powers,
                     by_dwell=by_dwell, rate=1.0 / dwells.period), null - plain


def _background(inner: np.ndarray, moment: np.ndarray, count: int) -> tuple[float, float]:
    """Size of a background against the white noise that suits best, and ln L with it."""
    value, vector = eigen(inner)
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
