"""Whether a fit may be called ok, and if not, why.

Three things make it so: something checks the model (degrees of freedom), the lengths and the tilts that it gives
were measured (tilts by spots, or three beams), and the residuals are no larger than noise.

The last is judged by reduced χ².  Its noise is estimated with ν degrees of freedom of its own, so that
normal noise gives F(n − p, ν), with the larger ν of arrivals' position and angle; the limit is passed once in ten
thousand healthy logs.  Noise is winsorised when it is estimated but not when χ² is summed: under arrivals of
Student's t with 3 degrees of freedom χ² comes out 1.25 times as large (median of 37 drawn logs; 1.6 at most), for
which :data:`HEAVY_TAILS` allows.  Noise that is only believed may be wrong by a factor of :data:`BELIEF`.
"""

import numpy as np
from scipy import special

from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.reduce import StopTable

OK = 'ok'
NOT_CONVERGED = 'not converged'
BEYOND_NOISE = 'times as large as the noise'
LEAST_DOF = 10
"""With fewer degrees of freedom a reduced χ² says nothing: 9 of them let one twice too small pass in 4 %."""
FALSE_ALARM = 1e-4
HEAVY_TAILS = 2.0
BELIEF = 2.0
LEAST_MEASURED = 0.5
"""Share of a setup's stops that must have a length, and of a diagonal's that must have a spot."""


def chi2_limit(result: Fit) -> float:
    """Reduced χ² up to which the residuals of ``result`` are noise."""
    if result.dof < 1:
        return np.inf
    known = max(result.noise.dof) if result.noise.source == 'repeats' else 0
    if known < 1:
        return float(HEAVY_TAILS * BELIEF**2 * special.chdtri(result.dof, FALSE_ALARM) / result.dof)
    return float(HEAVY_TAILS * special.fdtri(result.dof, known, 1.0 - FALSE_ALARM))


def reasons(result: Fit, table: StopTable) -> list[str]:
    """What keeps a fit from being ok, one clause each; empty where nothing does."""
    found = []
    if not result.converged:
        found.append(f'{NOT_CONVERGED}: the steps of the estimate came to no end; its errors are those of the last')
    if result.dof < LEAST_DOF:
        found.append(f'{max(result.dof, 0)} degrees of freedom: nothing checks the model; measure repeats or further '
                     'diagonals')
    else:
        reduced, limit = result.chi2 / result.dof, chi2_limit(result)
        if not reduced <= limit:
            found.append(f'the residuals are {np.sqrt(reduced):.3g} {BEYOND_NOISE} (reduced χ² '
                         f'{reduced:.4g}, noise gives up to {limit:.2g})')
    short = without_lengths(result, table)
    if short:
        found.append(f'no lengths in setup {", ".join(short)}: interferometer/displacement is missing or cannot be '
                     'used at most of its stops')
    blind = without_tilts(result, table)
    if blind:
        found.append(f'no tilts in setup {", ".join(blind)}: psd/spot is empty or missing, so that the angles are not '
                     'measured')
    return found


def without_lengths(result: Fit, table: StopTable) -> list[str]:
    """Setups at most of whose stops no beam has a length."""
    measured = result.present[:, :table.displacement.shape[1]].any(axis=1)
    return [name for k, name in enumerate(table.setup_names)
            if np.any(table.setup == k) and np.mean(measured[table.setup == k]) < LEAST_MEASURED]


def without_tilts(result: Fit, table: StopTable) -> list[str]:
    """Step diagonals with a detector or three beams whose stops have neither."""
    beams = table.displacement.shape[1]
    tilted = result.present[:, beams:].all(axis=1)
    if beams >= 3:
        tilted |= result.present[:, :3].all(axis=1)
    return [name for k, name in enumerate(table.setup_names)
            if name in result.parameters.tilted and np.any(table.setup == k)
            and np.mean(tilted[table.setup == k]) < LEAST_MEASURED]


def status_of(found: list[str]) -> str:
    """``ok``, or what keeps a solution from it."""
    return f'not {OK}: {"; ".join(found)}' if found else OK


