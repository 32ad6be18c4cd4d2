"""What the readings leave open stays in the middle of its prior, where uncertainties are propagated from.

Rotations that no tilts measured reach lengths by products of small quantities only.  Within priors of a milliradian
such products come to as much as the noise, so that the solution wanders along its flat valleys by hundreds of
microradians.  That is no finding; but it is where the model is made linear, and there open rotations take part in what
beams, tool and other errors do.  A second log that leaves as much open may then seem more certain only because it
wandered less.  So the combinations of unknowns that the data leave open are held, and all others found again beside
them; what the readings say of the held ones to first order the step of :mod:`stepdiag_ros.estimate.shared` takes up.
"""

import numpy as np
from scipy import linalg

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.enhanced import Fit, fit, prior_sigmas
from stepdiag_ros.estimate.identifiability import LOOSE, OPEN
from stepdiag_ros.estimate.parameters import STATION
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import CURVES

ROUNDS = 4
"""Most fits: near the middle more is open than where the first one wandered to."""


def with_open_held(description: Description, table: StopTable, result: Fit, linear_laser: float) -> Fit:
    """``result`` where all errors are found; else the fit with what is open held.

    Where a fit has wandered to, the model shows to first order what it shows to second order only in the middle: so
    single unknowns are held first, and from there the combinations that are open.  Stations are left alone: what shows
    to second order only is what holds them above the plane of their targets.
    """
    if STATION in result.parameters.unknowns.values() or not _errors_open(result):
        return result
    rows, held = _single(result, linear_laser), 0
    for _ in range(ROUNDS):
        middle = result.theta - linalg.lstsq(rows, rows @ result.theta)[0]
        result = fit(description, table, result.noise, theta=middle, linear_laser=linear_laser, held=rows)
        rows = _open(result)
        if len(rows) <= held:
            break
        held = len(rows)
    return result


def _single(result: Fit, linear_laser: float) -> np.ndarray:
    """Unknowns (k, size) that the data narrow by less than half, in units of their priors."""
    prior = prior_sigmas(result.parameters, linear_laser)
    return np.diag(1.0 / prior)[np.diag(result.covariance) > OPEN * prior**2]


def _errors_open(result: Fit) -> bool:
    """Whether some error of the machine is known no better than :data:`LOOSE`."""
    sigma = np.sqrt(np.diag(result.covariance))
    return any(np.any(sigma[result.parameters.slice(name)] > LOOSE) for name in CURVES)


def _open(result: Fit) -> np.ndarray:
    """Combinations (k, size) of unknowns that the data narrow by less than half, in units of their priors."""
    root = linalg.cholesky(result.precision, lower=True)
    share, vectors = eigen(root.T @ result.covariance @ root)
    return vectors[:, share > OPEN].T @ root.T
