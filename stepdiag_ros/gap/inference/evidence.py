"""The evidence for a form: how much better the log is predicted with it than without.

With white data z of N degrees of freedom and a form's columns Z (N, k) in units of its typical
size, coefficients are normal with variance s² and the scale of the noise is known only as well as
the repeats tell it (ν degrees of freedom).  Integrated over both, the logarithm of the Bayes factor
against no effect is

    −½ ln|I + s² ZᵀZ| − ½ (N + ν) ln(1 − Δ/(ν + zᵀz)),   Δ = zᵀZ (ZᵀZ + s⁻²)⁻¹ Zᵀz.

The size s is not known: the factor is averaged over s from a thirtieth to thirty times the typical.
The determinant is the price of complexity: a form that could have fitted much pays for it.

Columns that are made of the readings hold their noise: a Jacobian correction (:meth:`Parity.own_rows`), Δₒ of what the
coefficients gain.  That is a density of readings, whatever the scale of the noise: it counts as ½ Δₒ, and only
what the data gain, Δ − Δₒ, is held against them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stepdiag_ros.effects.base import Form
from stepdiag_ros.estimate.eigen import eigen

SIZES = np.logspace(-1.5, 1.5, 9)


@dataclass(frozen=True)
class Judged:
    """``log_bayes`` (F,) of forms against nothing; ``size`` (F,), in typical ones, that speaks best for each;
    ``of_sizes`` (F, 9): the probability of each of ``SIZES``.  ``judged[n]`` are those of form n."""

    log_bayes: np.ndarray
    size: np.ndarray
    of_sizes: np.ndarray

    def __getitem__(self, wanted: int) -> 'Judged':
        return Judged(self.log_bayes[wanted], self.size[wanted], self.of_sizes[wanted])


def judge(gram: np.ndarray, along: np.ndarray, total: float, dof: float, noise_dof: float,
          own: tuple[np.ndarray, np.ndarray] | None = None) -> Judged:
    """Evidence for F forms of k columns each, from the products ``ZᵀZ`` (F, k, k), ``Zᵀz`` (F, k) and
    ``zᵀz``, in data with ``dof`` free dimensions; ``own``: what of the first two the Jacobian
    correction takes."""
    value, vector = eigen(gram)
    value = np.maximum(value, 0.0)
    turned = (vector.transpose(0, 2, 1) @ along[:, :, None])[:, :, 0]
    variance = SIZES[:, None, None] ** 2
    gain = np.sum(turned**2 * variance / (1.0 + variance * value), axis=2)
    correction = 0.0
    if own:
        correction = _correction(*own, (variance * turned / (1.0 + variance * value))[:, :, None]
                                 @ vector.transpose(0, 2, 1))
    share = np.minimum((gain - correction) / (noise_dof + total), 1.0 - 1e-12)
    logs = (-0.5 * np.sum(np.log1p(variance * value), axis=2)
            - 0.5 * (dof + noise_dof) * np.log1p(-share) + 0.5 * correction)
    top = logs.max(axis=0)
    mean = top + np.log(np.mean(np.exp(logs - top), axis=0))
    odds = np.exp(logs - top)
    return Judged(mean, SIZES[logs.argmax(axis=0)], (odds / odds.sum(axis=0)).T)


def log_evidence(gram: np.ndarray, along: np.ndarray, total: float, dof: float, noise_dof: float) -> float:
    """Log evidence of columns of known size one, from the products ``DᵀD`` (k, k), ``Dᵀz`` (k,) and ``zᵀz``."""
    value, vector = eigen(gram)
    value = np.maximum(value, 0.0)
    gain = float(np.sum((vector.T @ along) ** 2 / (1.0 + value)))
    return float(-0.5 * np.sum(np.log1p(value))
                 - 0.5 * (dof + noise_dof) * np.log1p(-min(gain / (noise_dof + total), 1.0 - 1e-12)))


def _correction(gram: np.ndarray, along: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """``2aᵀb − aᵀGa`` (S, F) for ``coefficients`` a (S, F, 1, k), ``gram`` G (F, k, k) and ``along`` b (F, k)."""
    return np.sum(coefficients * (2.0 * along[:, None] - coefficients @ gram), axis=(2, 3))


def prior_sigma_of(form: Form) -> float:
    """Standard deviation of a form's coefficients, in its scales, in a fit: wide enough to be free, but
    for a process."""
    return float(SIZES[-1]) if form.held is None else form.held


def log_mean(values: ArrayLike) -> float:
    """Logarithm of the mean of exponentials."""
    return log_sum(values) - float(np.log(np.size(values)))


def log_sum(values: ArrayLike) -> float:
    """Logarithm of the sum of exponentials."""
    numbers = np.asarray(values, float)
    top = numbers.max()
    return float(top + np.log(np.sum(np.exp(numbers - top))))
