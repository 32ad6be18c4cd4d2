"""Samples that go with those before them: how much less certain means are than the root of their number says.

Samples k apart are alike by ρᵏ (a first-order autoregression).  Their noise, as neighbours' differences tell it, is
σ² (1 − ρ).  In units of that contrasts of the means over the fifths of a dwell scatter by L(ρ), and the mean over the
whole dwell by F(ρ), which is larger: it has all of what is slower than a fifth.  So F follows from the L that a log
shows.  As ρ goes to one L ends while F does not: beyond ``TOLD`` of that end fifths tell no more.
"""

from functools import lru_cache

import numpy as np

FIFTHS = 5
TOLD = 0.9
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


def _correlation(loud: float, each: int) -> float:
    """The place among ``ALIKE`` at which the contrasts beyond slope and bend scatter by ``loud``."""
    shown = np.sqrt(np.mean(scatters(each)[0][:, SLOPE_AND_BEND:]**2, axis=1))
    shown = shown[:int(np.argmax(shown >= TOLD * shown.max())) + 1]
    return float(np.interp(loud, shown, np.arange(len(shown))))


def of_mean(loud: float, each: int) -> float:
    """Factor by which the mean over a dwell of fifths of ``each`` samples scatters more than independent samples of the
    noise that neighbours tell, where contrasts of its fifths do by ``loud``; never less than that."""
    if each < 1:
        return loud
    return max(loud, float(np.interp(_correlation(loud, each), np.arange(len(ALIKE)), scatters(each)[1])))


def of_bend(loud: float, each: int) -> float:
    """Factor by which the bend over a dwell scatters more than the contrasts beyond it, which scatter by ``loud``."""
    if each < 1:
        return 1.0
    by_degree = scatters(each)[0]
    bend = by_degree[:, SLOPE_AND_BEND - 1] / np.sqrt(np.mean(by_degree[:, SLOPE_AND_BEND:]**2, axis=1))
    return float(np.interp(_correlation(loud, each), np.arange(len(ALIKE)), bend))
