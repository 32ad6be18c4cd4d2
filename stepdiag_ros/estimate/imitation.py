"""What of a change of the readings a fit takes for itself, and what it leaves.

Let the readings be f(θ₀) + δ, without noise.  The fit leaves

    δ + f(θ₀) − f(θ)     at the θ that minimises     |W(f(θ₀) + δ − f(θ))|² + (θ − θ₀)ᵀP(θ − θ₀).

Where f is straight one step finds it.  Turns of beams and mirror act to second order, along flat valleys: some
microradians of them may imitate what they could not at θ₀, a few of a large change nearly all.
"""

import numpy as np

from stepdiag_ros.estimate.enhanced import fit, readings_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description

SETTLED = 0.1
"""To this the least value is sought [χ²]: a percent of what counts as seen."""


def what_is_left(description: Description, table: StopTable, noise: NoiseModel, theta: np.ndarray,
                 change: np.ndarray) -> tuple[np.ndarray, float]:
    """What of ``change`` (n, c) [m] a fit leaves (n, c) [m], 0 where there is no reading, and the least value of what
    it minimises.

    ``theta`` (size,): θ₀, the unknowns without the change.
    """
    parameters = parameters_of(description, table)
    whole = np.where(np.isfinite(readings_of(table)),
                     ForwardModel(description, table, parameters).predict(theta) + change, np.nan)
    result = fit(description, table, noise, whole, theta, parameters, SETTLED, centre=theta)
    gone = result.theta - theta
    return np.where(result.present, result.residual, 0.0), result.chi2 + float(gone @ result.precision @ gone)
