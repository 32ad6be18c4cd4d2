"""Samples that go with those before them: how much less certain means are than the root of their number says.

Samples k apart are alike by ρᵏ (a first-order autoregression).  A dwell's slow contrasts, the polynomials of third and
fourth degree through its samples, scatter by S(ρ) in units of the noise that neighbours' differences tell, its fast
ones, neighbours' differences with signs of no pattern, by A(ρ), and the mean over the dwell by F(ρ), which is larger:
it has all of what is slower.  So F follows from the S/A that a log shows, whatever the size and the tails of its noise.
As ρ goes to one S/A ends while F does not: nearer to that end than S/A is known, contrasts tell no more.

What an instrument rounds off is noise as well, and independent from sample to sample where these differ by more than a
step.  Of the neighbours' differences only a share a is then of what is alike: a log shows 1 + a (S² − 1) for S², the
same for A², and its means have 1 + a (F² − 1).
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

FEWEST = 5
"""Samples of a dwell of which something is left beyond a bend at both ends of the spectrum."""
SLOW, FAST = 2, 6
"""How many of a dwell's contrasts are slow; those after them are fast, of dwells too short for as many some twice."""
LEAST_LOUD = 0.1
"""Least squared scatter of contrasts that is believed of what rounding leaves."""
SURE = 1.0
"""Standard deviations by which contrasts must stay below their end to tell how alike samples are."""
ALIKE = np.append(0.0, 1.0 - np.geomspace(1.0, 1e-4, 80)[1:])
"""Correlations ρ of neighbours that are tried."""
SLOPE_AND_BEND = 2
"""Contrasts that show what creeps; those beyond tell the noise."""


def contrasts(time: np.ndarray) -> np.ndarray:
    """Orthonormal contrasts (n, b − 1, b) of the parts of dwells at their ``time`` (n, b) [s] by rising degree: slope,
    bend, …; what goes on evenly in a dwell has a slope and nothing else."""
    middle, span = time.mean(axis=1, keepdims=True), np.ptp(time, axis=1, keepdims=True)
    powers = ((time - middle) / np.maximum(span, 1e-12))[:, :, None] ** np.arange(time.shape[1])
    basis, _ = np.linalg.qr(powers)
    basis = basis * np.where(basis[:, -1:, :] < 0.0, -1.0, 1.0)   # all dwells count to the same side
    return basis[:, :, 1:].transpose(0, 2, 1)


def fast_ones(count: int) -> int:
    """How many fast contrasts a dwell of ``count`` samples has."""
    return min(max((count - 3) // 2, 1), FAST)


@lru_cache(maxsize=64)
def sample_contrasts(count: int) -> np.ndarray:
    """The slow and the fast contrasts (SLOW + FAST, count) of the samples of a dwell, each of length one; neither what
    drifts nor what bends has a part in them."""
    place, pairs = np.linspace(-1.0, 1.0, count), count // 2
    signs = np.where(np.random.default_rng(0).random((pairs, fast_ones(count))) < 0.5, -1.0, 1.0)
    signs[0] = 1.0   # no two of the patterns of few signs are each other's opposite
    fast = np.zeros((count, fast_ones(count)))
    fast[:2 * pairs:2], fast[1:2 * pairs:2] = signs, -signs
    powers = place[:, None] ** np.arange(min(count - 1, 5))
    smooth = np.linalg.qr(powers)[0]
    fast = np.linalg.qr(np.concatenate([smooth[:, :4], fast], axis=1))[0][:, 4:].T
    # Of five samples a fourth degree has what the fast contrast has.
    return np.concatenate([smooth[:, [3, -1]].T, np.resize(fast, (FAST, count))])


@lru_cache(maxsize=64)
def scatters(count: int) -> tuple[np.ndarray, np.ndarray]:
    """By how much contrasts of the ``count`` samples of a dwell (r, SLOW + FAST), and its mean (r,), scatter more than
    independent samples of the noise that neighbours tell, at the correlations ``ALIKE`` (r,)."""
    functions = np.concatenate([sample_contrasts(count), np.full((1, count), count**-0.5)])
    spectrum = np.abs(np.fft.rfft(functions, 2 * count)) ** 2
    together = np.fft.irfft(spectrum, 2 * count)[:, :count]
    together[:, 1:] *= 2.0
    rho = np.power.outer(ALIKE, np.arange(count))
    scatter = np.sqrt(np.maximum(rho @ together.T, 0.0) / (1.0 - ALIKE)[:, None])
    return scatter[:, :-1], scatter[:, -1]


def _of_all(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares of what :func:`scatters` gives, over dwells of ``counts`` (n,) samples: ten samples are a tenth less
    alike than eleven, and half the dwells of a log may have one less."""
    numbers, often = np.unique(counts, return_counts=True)
    each = [[part**2 for part in scatters(int(number))] for number in numbers]
    return tuple(np.average(np.stack(part), axis=0, weights=often) for part in zip(*each, strict=True))


def _correlation(ratio: float, squares: np.ndarray, sure: float) -> float:
    """The place among ``ALIKE`` at which slow contrasts scatter ``ratio`` times as much as fast ones, ``squares``
    (r, SLOW + FAST) being those of all, where that ratio is known to a share ``sure``."""
    shown = np.sqrt(squares[:, :SLOW].mean(axis=1) / squares[:, SLOW:].mean(axis=1))
    shown = shown[:int(np.argmax(shown >= max(1.0 - sure, 0.0) * shown.max())) + 1]
    return float(np.interp(ratio, shown, np.arange(len(shown))))


def of_mean(slow: float, fast: float, counts: ArrayLike, known: float, share: float = 1.0) -> float:
    """Factor by which the means over dwells of ``counts`` samples scatter more than independent samples of the noise
    that neighbours tell, where ``known`` slow contrasts do by ``slow`` and the fast ones by ``fast``; never less than
    the slow ones.  ``share`` of the neighbours' squared differences that is not of rounding."""
    counts = np.atleast_1d(counts)
    counts = counts[counts >= FEWEST]
    if not len(counts) or share <= 0.0:
        return slow
    squares = [max(1.0 + (loud**2 - 1.0) / share, LEAST_LOUD) for loud in (slow, fast)]
    contrasts_at, means = _of_all(counts)
    sure = SURE * np.sqrt((0.5 + 0.5 * SLOW / fast_ones(int(np.median(counts)))) / max(known * share**2, 1.0))
    alike = _correlation(float(np.sqrt(squares[0] / squares[1])), contrasts_at, sure)
    fast_there, mean = (np.interp(alike, np.arange(len(ALIKE)), squared)
                        for squared in (contrasts_at[:, SLOW:].mean(axis=1), means))
    # Tails make all contrasts, and the means, larger than what the quiet majority of dwells tells of neighbours.
    tails = max(1.0, fast / np.sqrt(1.0 + share * (fast_there - 1.0)))
    return max(slow, float(tails * np.sqrt(1.0 + share * (mean - 1.0))))


@lru_cache(maxsize=1)
def _rounding() -> tuple[np.ndarray, np.ndarray]:
    """Half the squared difference of neighbours, in squared steps, after rounding, and what rounding adds to it.

    Errors of rounding of normal readings of which half the squared difference is D go together by
    (1 / 2π²) Σ exp(−4π² h² D) / h² (B. Widrow and I. Kollár, Quantization Noise, 2008): where D is large they add 1/12,
    and nothing where neighbours are rounded alike.
    """
    before, harmonic = np.append(0.0, np.geomspace(1e-6, 1e2, 400)), np.arange(1, 400)
    together = (np.exp(-4.0 * np.pi**2 * harmonic**2 * before[:, None]) / harmonic**2).sum(axis=1) / (2.0 * np.pi**2)
    return before + together[0] - together, together[0] - together


def not_rounding(scatter: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Share (c,) of neighbours' squared differences, of samples that scatter by ``scatter`` (c,) [m], that is not of
    rounding to multiples of ``step`` (c,) [m]; 1 where there is none."""
    squared = np.maximum((scatter / np.where(step > 0.0, step, 1.0))**2, 1e-300)
    return np.where(step > 0.0, np.clip(1.0 - np.interp(squared, *_rounding()) / squared, 0.0, 1.0), 1.0)
