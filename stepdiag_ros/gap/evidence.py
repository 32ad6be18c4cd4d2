"""The evidence for a form: how much better the log is foretold with it than without.

With white data z of N degrees of freedom and a form's columns Z (N, k) in units of its typical
size, coefficients are normal with variance s² and the scale of the noise is known only as well as
the repeats tell it (ν degrees of freedom).  Integrated over both, the logarithm of the Bayes factor
against no effect is

    −½ ln|I + s² ZᵀZ| − ½ (N + ν) ln(1 − Δ/(ν + zᵀz)),   Δ = zᵀZ (ZᵀZ + s⁻²)⁻¹ Zᵀz.

The size s is not known: the factor is averaged over s from a thirtieth to thirty times the typical.
The determinant is the price of complexity: a form that could have fitted much pays for it.
"""

from dataclasses import dataclass

import numpy as np

SIZES = np.logspace(-1.5, 1.5, 9)


@dataclass(frozen=True)
class Judged:
    """``log_bayes`` of a form; ``fall``: what of zᵀz its best fit takes away; ``coefficients`` (k,) and
    ``covariance`` (k, k) in units of the form's scale; ``strength``: root of zᵀPz along its columns."""

    log_bayes: float
    fall: float
    coefficients: np.ndarray
    covariance: np.ndarray


def judge(columns: np.ndarray, data: np.ndarray, dof: float, noise_dof: float) -> Judged:
    """Evidence for ``columns`` (N, k) in ``data`` (N,) with ``dof`` free dimensions."""
    gram = columns.T @ columns
    along = columns.T @ data
    return judge_gram(gram, along, float(data @ data), dof, noise_dof)


def judge_gram(gram: np.ndarray, along: np.ndarray, total: float, dof: float,
               noise_dof: float) -> Judged:
    """As :func:`judge` from the products ``ZᵀZ`` (k, k), ``Zᵀz`` (k,) and ``zᵀz``."""
    value, vector = np.linalg.eigh(gram)
    value = np.maximum(value, 0.0)
    turned = vector.T @ along
    variance = SIZES[:, None] ** 2
    gain = np.sum(turned**2 * variance / (1.0 + variance * value), axis=1)
    share = np.minimum(gain / (noise_dof + total), 1.0 - 1e-12)
    logs = (-0.5 * np.sum(np.log1p(variance * value), axis=1)
            - 0.5 * (dof + noise_dof) * np.log1p(-share))
    best = int(np.argmax(logs))
    shrink = 1.0 / (value + SIZES[-1] ** -2.0)
    coefficients = vector @ (turned * shrink)
    covariance = (vector * shrink) @ vector.T
    fall = float(2.0 * coefficients @ along - coefficients @ gram @ coefficients)
    return Judged(float(_log_mean(logs)), max(fall, 0.0), coefficients, covariance)


def _log_mean(values: np.ndarray) -> float:
    top = values.max()
    return top + np.log(np.mean(np.exp(values - top)))


def log_mean(values: list[float]) -> float:
    """Logarithm of the mean of exponentials."""
    return float(_log_mean(np.asarray(values, float)))
