"""Samples that go with those before them: how much less certain means are than the root of their number says.

Samples k apart are alike by ρᵏ (a first-order autoregression).  Their noise, as neighbours' differences tell it, is
σ² (1 − ρ).  In units of that contrasts of the means over the fifths of a dwell scatter by L(ρ), and the mean over the
whole dwell by F(ρ), which is larger: it has all of what is slower than a fifth.  So F follows from the L that a log
shows.  As ρ goes to one L ends while F does not: nearer to that end than L is known, fifths tell no more.

What an instrument rounds off is noise as well, and independent from sample to sample where these differ by more than a
step.  Of the neighbours' differences only a share a is then of what is alike: a log shows 1 + a (L² − 1), and its means
have 1 + a (F² − 1).
"""

from functools import lru_cache

import numpy as np

FIFTHS = 5
LEAST_LOUD = 0.1
"""Least squared scatter of contrasts that is believed of what rounding leaves."""
SURE = 1.0
"""Standard deviations by which contrasts of fifths must stay below their end to tell how alike samples are."""
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


def fifths_contrasts() -> np.ndarray:
    """The same (4, 5) of the means over the fifths of a dwell."""
    return contrasts(np.arange(FIFTHS, dtype=float)[None])[0]


def fifth_of(count: np.ndarray) -> int:
    """Samples in a fifth of a typical dwell; ``count`` (n,): in each dwell."""
    return int(np.median(count)) // FIFTHS


@lru_cache(maxsize=64)
def scatters(each: int) -> tuple[np.ndarray, np.ndarray]:
    """By how much contrasts of fifths of ``each`` samples by degree (r, 4), and the dwell's mean (r,), scatter more
    than independent samples of the noise that neighbours tell, at the correlations ``ALIKE`` (r,)."""
    rho = ALIKE[:, None, None]
    apart = np.abs(np.subtract.outer(np.arange(FIFTHS), np.arange(FIFTHS)))
    total = (1.0 - rho**each) / (1.0 - rho)
    within = each * (1.0 + rho) / (1.0 - rho) - 2.0 * rho * total / (1.0 - rho)
    between = rho ** np.maximum(apart * each - (each - 1), 0) * total**2
    covariance = np.where(apart == 0, within, between) / each**2
    contrasts = fifths_contrasts()
    by_degree = each * np.einsum('hi,rij,hj->rh', contrasts, covariance, contrasts)
    mean = each * FIFTHS * covariance.mean(axis=(1, 2))
    return np.sqrt(by_degree / (1.0 - ALIKE[:, None])), np.sqrt(mean / (1.0 - ALIKE))


def _correlation(loud: float, each: int, known: float) -> float:
    """The place among ``ALIKE`` at which the contrasts beyond slope and bend, of which ``known`` were seen, scatter by
    ``loud``."""
    shown = np.sqrt(np.mean(scatters(each)[0][:, SLOPE_AND_BEND:]**2, axis=1))
    if shown[-1] < shown[0]:   # fifths of one sample: what goes on slowly is not in the fast contrasts of neighbours
        shown, loud = 1.0 / shown, 1.0 / loud
    told = max(1.0 - SURE / np.sqrt(2.0 * max(known, 1.0)), 0.0)
    shown = shown[:int(np.argmax(shown >= told * shown.max())) + 1]
    return float(np.interp(loud, shown, np.arange(len(shown))))


def of_mean(loud: float, each: int, known: float, share: float = 1.0) -> float:
    """Factor by which the mean over a dwell of fifths of ``each`` samples scatters more than independent samples of the
    noise that neighbours tell, where ``known`` contrasts of fifths do by ``loud``; never less than that.  ``share`` of
    the neighbours' squared differences that is not of rounding."""
    if each < 1 or share <= 0.0:
        return loud
    own = np.sqrt(max(1.0 + (loud**2 - 1.0) / share, LEAST_LOUD))
    alike = _correlation(own, each, known * share**2)
    mean = float(np.interp(alike, np.arange(len(ALIKE)), scatters(each)[1]))
    return max(loud, np.sqrt(1.0 + share * (mean**2 - 1.0)))


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
