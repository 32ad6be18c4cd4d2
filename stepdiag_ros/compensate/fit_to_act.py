"""Whether a solution may be acted on: nothing is compensated or verified with lengths that are no metres, with a
mistake of commissioning in the log, or with residuals that neither noise nor a cause explains."""

import numpy as np

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.status import BEYOND_NOISE, NOT_CONVERGED
from stepdiag_ros.model.log import CalibrationLog

NOT_METRES = ('the lengths are not corrected for air: neither the instrument nor the environment topics nor the cell '
              'tell its index, which is worth some 270 µm a metre; log the environment, give air: in the cell, or '
              'import with --corrected a table that was')


def not_metres(solution: Solution, log: CalibrationLog) -> str:
    """Why the solution's lengths are not metres, '' where they are.

    Asked is the solution; one that carries nothing about it counts as corrected only where the instrument divided an
    index of air out.
    """
    if solution.traceability is not None:
        return '' if solution.traceable else NOT_METRES
    vacuum = len(log.displacement) > 0 and bool(np.all(log.displacement.refractive_index == 1.0))
    return NOT_METRES if vacuum else ''


def unfit(solution: Solution) -> tuple[str, ...]:
    """Why the solution does not describe a machine: mistakes of commissioning, steps that came to no end, residuals
    beyond the noise.  Empty where it does."""
    if solution.sanity:
        return tuple(f'the log shows a mistake of commissioning, {finding}' for finding in solution.sanity)
    if any(word in solution.status for word in (NOT_CONVERGED, BEYOND_NOISE)):
        return (f'the evaluation is {solution.status}; read `stepdiag gap` of the log',)
    return ()
