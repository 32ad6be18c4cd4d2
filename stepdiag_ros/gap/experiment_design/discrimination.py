"""How well two forecasts are distinguished: probability of error, expected evidence; mixtures of forecasts too.

Each set of effects predicts new readings as a normal distribution N(m, V).  The probability that they speak for the
wrong one of two sets is at most ½ρ, with

    −ln ρ = ⅛ (m_A − m_B)ᵀ V⁻¹ (m_A − m_B) + ½ ln |V| − ¼ ln |V_A| − ¼ ln |V_B|,   V = ½ (V_A + V_B)

(Kailath 1967).  A set may act in several ways, forms of its effects that the log does not tell apart; then
ρ ≤ Σ √(w_a w_b) ρ_ab over these.  If A acts, the expected log evidence is

    KL(A‖B) = ½ [tr(V_B⁻¹V_A) − n + ln |V_B|/|V_A| + (m_A − m_B)ᵀ V_B⁻¹ (m_A − m_B)],

between mixtures that of Hershey and Olsen 2007.  All is computed in the few directions in which the
readings are not known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg


@dataclass(frozen=True)
class Forecast:
    """White new readings (n,) as a set predicts them: ``mean`` and ``spread`` (n, p) of their covariance
    ``1 + SSᵀ``; ``certain`` (p, n) is L⁻¹Sᵀ with ``LLᵀ = 1 + SᵀS``, ``volume`` ½ ln |1 + SSᵀ|, ``own`` the trace of
    ``(1 + SSᵀ)⁻¹ − 1``."""

    mean: np.ndarray
    spread: np.ndarray
    certain: np.ndarray
    volume: float
    own: float


Mixture = Sequence[tuple[float, Forecast]]
"""Forecasts of a set that may act in several ways, with the share of each."""


def predicted(mean: np.ndarray, spread: np.ndarray) -> Forecast:
    """The forecast of white readings with ``mean`` (n,) and covariance ``1 + SSᵀ``, S the ``spread`` (n, p)."""
    root = linalg.cholesky(np.eye(spread.shape[1]) + spread.T @ spread, lower=True)
    certain = linalg.solve_triangular(root, spread.T, lower=True, check_finite=False)
    return Forecast(mean, spread, certain, float(np.sum(np.log(np.diag(root)))), -float(np.sum(certain**2)))


def evidence_of(true: Forecast, other: Forecast) -> float:
    """Expected log evidence of the new readings for ``true`` against ``other``; all in the few directions in
    which they are not known."""
    shift = true.mean - other.mean
    trace = other.own + np.sum(true.spread**2) - np.sum((other.certain @ true.spread) ** 2)
    return float(0.5 * (trace + shift @ shift - np.sum((other.certain @ shift) ** 2)) + other.volume - true.volume)


def expected_evidence(true: Mixture, other: Mixture) -> float:
    """Expected log evidence for one mixture of forecasts against another."""
    def near(forecast: Forecast, mixture: Mixture) -> float:
        return float(np.logaddexp.reduce([
            np.log(share) - (0.0 if one is forecast else evidence_of(forecast, one)) for share, one in mixture]))
    return sum(share * (near(one, true) - near(one, other)) for share, one in true)


def apart(some: Mixture, other: Mixture) -> float:
    """−ln ρ between two mixtures of forecasts, at least."""
    return -float(np.logaddexp.reduce([0.5 * np.log(share * weight) - distance(a, b)
                                       for share, a in some for weight, b in other]))


def distance(a: Forecast, b: Forecast) -> float:
    """−ln ρ between two forecasts."""
    spread, shift = np.concatenate([a.spread, b.spread], axis=1) / np.sqrt(2.0), 0.5 * (a.mean - b.mean)
    root = linalg.cholesky(np.eye(spread.shape[1]) + spread.T @ spread, lower=True)
    taken = linalg.solve_triangular(root, spread.T @ shift, lower=True)
    volume = np.sum(np.log(np.diag(root)))
    return float(0.5 * (shift @ shift - taken @ taken) + volume - 0.5 * (a.volume + b.volume))
