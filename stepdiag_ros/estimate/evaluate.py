"""From a log to its solution: the one function behind node, command and replay."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit, fit
from stepdiag_ros.estimate.gauge import GAUGE, reporting_matrix
from stepdiag_ros.estimate.identifiability import unidentifiable
from stepdiag_ros.estimate.reduce import StopTable, reduce_log
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.estimate.sanity_fit import check_fit
from stepdiag_ros.estimate.solution import Residuals, Solution
from stepdiag_ros.estimate.status import reasons, status_of
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.sensor import Misalignment


def evaluate(log: CalibrationLog) -> Solution:
    """All errors and misalignments of a log by the enhanced step diagonal method.

    Pure: the same log gives the same bits.  The solution's ``sanity`` names mistakes of commissioning that the log
    shows; with any the status is not ok.  Raises :class:`~stepdiag_ros.errors.StepdiagError` where the log holds
    nothing to solve.
    """
    table = reduce_log(log)
    found = check_readings(log.description, table)
    try:
        result = fit(log.description, table)
    except (StepdiagError, FloatingPointError) as error:
        if found:
            raise StepdiagError(f'{log.source}: {"; ".join(map(str, found))}') from None
        raise error
    solution = solution_of(result, table, log.warnings + table.warnings)
    found = found or check_fit(log.description, table, result)
    if not found:
        return solution
    status = status_of([*(finding.found for finding in found), *reasons(result, table)])
    return replace(solution, status=status, sanity=tuple(found))


def solution_of(result: Fit, table: StopTable, warnings: tuple[str, ...] = ()) -> Solution:
    """Put a fit into reported form: reference lines, names, open directions."""
    parameters = result.parameters
    names, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    information = np.linalg.inv(result.covariance) - result.precision
    open_directions = unidentifiable(parameters, names, reporting, result.covariance,
                                     result.precision, information)
    misalignments = {}
    for setup in parameters.setups:
        first = parameters.setup_first[setup]
        angles = [float(a) for a in result.theta[first:first + 4]]
        misalignments[setup] = Misalignment((angles[0], angles[1]), (angles[2], angles[3]))
    noise = {'position_repeatability_m': result.noise.position,
             'angle_repeatability_rad': result.noise.angle, 'source': result.noise.source}
    return Solution(
        'enhanced', parameters.knots, tuple(names), reporting @ result.theta,
        reporting @ result.covariance @ reporting.T,
        status=status_of(reasons(result, table)),
        reduced_chi2=result.chi2 / max(result.dof, 1), dof=result.dof,
        unidentifiable=open_directions, gauge=GAUGE, misalignments=misalignments, noise=noise,
        residuals=_residuals(result, table), warnings=warnings,
        extra={'iterations': result.iterations})


def _residuals(result: Fit, table: StopTable) -> Residuals:
    beams = result.residual.shape[1] - 2
    names = np.array(table.setup_names, dtype=object)
    return Residuals(np.array(table.run_ids, dtype=object)[table.run], names[table.setup],
                     table.repeat, table.direction, table.index, table.axis, table.time_s,
                     result.residual[:, :beams], result.residual[:, beams:])
