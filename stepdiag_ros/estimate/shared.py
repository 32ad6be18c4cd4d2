"""The solution when errors of readings that many stops share are weighed as what they are.

The fit weighs with what differs from arrival to arrival and from sample to sample.  Detector zero, gain and rotation,
cosine errors and air that varies are alike over many readings; a fit that does not know it may get more certain by
having less data.  Let the columns B (n·c, k) of independent variates b of standard deviation 1 be those errors, Σ the
covariance that the fit weighs with, J its Jacobian and P the precision of its priors.  With errors Σ + B Bᵀ the best
linear estimate (Aitken; Rao and Toutenburg, Linear Models, 1995) is a step away from the fit.  It is the one in which b
are unknowns beside θ,

    [C D; Dᵀ E] = [JᵀΣ⁻¹J + P, JᵀΣ⁻¹B; BᵀΣ⁻¹J, I + BᵀΣ⁻¹B]⁻¹        G = (C Jᵀ + D Bᵀ) Σ⁻¹        δθ = G r − C P θ

with the gain G.  (To eliminate b beforehand is the same but for rounding: of readings almost without noise it takes the
difference of two large numbers.)  What is best cannot get better by leaving readings out.

What acts on single stops, the mirror's form above all, is part of Σ
(:func:`stepdiag_ros.estimate.columns.stop_columns`).
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.estimate.dense import factored, inverse, normal_equations
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.noise import Whitener


@dataclass(frozen=True)
class Weighed:
    """``gain`` (p, n·c) and ``half`` (p, size) = R C for p reported values; ``shift`` (p,): step from the fit."""

    gain: np.ndarray
    half: np.ndarray
    shift: np.ndarray


def weigh(result: Fit, reporting: np.ndarray, columns: np.ndarray, misfit: float = 1.0,
          stopwise: sparse.csr_array | None = None) -> Weighed:
    """The estimate of ``reporting`` (p, size) with shared errors ``columns`` (n·c, k) [m].

    ``misfit`` scales what the fit weighs with; ``stopwise`` (n·c, m) [m]: variates of one stop each, beside it.
    """
    columns = np.where(result.present.ravel()[:, None], columns, 0.0)
    white = _whiteners(result, misfit, stopwise)
    normal = normal_equations(result.jacobian, white)
    weighted = _over_noise(white, columns)
    across = result.jacobian.T @ weighted
    matrix = np.block([[normal + result.precision, across],
                       [across.T, np.eye(columns.shape[1]) + columns.T @ weighted]])
    found = reporting @ inverse(*factored(0.5 * (matrix + matrix.T)))[:len(normal)]
    half, shared = np.split(found, [len(normal)], axis=1)
    gain = np.zeros((len(half), result.jacobian.shape[0]))
    for one in white:
        block = result.jacobian[one.rows] @ half.T
        gain[:, one.rows] = one.weighted(block).T
    gain += shared @ weighted.T
    residual = np.where(result.present, result.residual, 0.0).ravel()
    return Weighed(gain, half, gain @ residual - half @ (result.precision @ result.theta))


def _whiteners(result: Fit, misfit: float, stopwise: sparse.csr_array | None) -> list[Whitener]:
    """Those of the fit, with its noise ``misfit`` times as large and what is ``stopwise`` added."""
    scaled = [Whitener.of(one.rows, misfit * one.factor) for one in result.whiteners]
    if stopwise is None:
        return scaled
    found = []
    for one in scaled:
        own = stopwise[one.rows]
        factor = one.factor
        covariance = factor @ factor.T + (own @ own.T).toarray()
        found.append(Whitener.of(one.rows, linalg.cholesky(covariance, lower=True, check_finite=False)))
    return found


def _over_noise(white: list[Whitener], columns: np.ndarray) -> np.ndarray:
    """``Σ⁻¹ B`` (n·c, k)."""
    out = np.zeros_like(columns)
    for one in white:
        out[one.rows] = one.weighted(columns[one.rows])
    return out
