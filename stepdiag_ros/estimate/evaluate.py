"""From a log to its solution: the one function behind node, command and replay."""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.closure import closures
from stepdiag_ros.estimate.contributions import contributions
from stepdiag_ros.estimate.enhanced import PRIOR_LASER_RAD, Fit, fit
from stepdiag_ros.estimate.gauge import GAUGE, reporting_matrix
from stepdiag_ros.estimate.held import with_open_held
from stepdiag_ros.estimate.held_beam import held_beams
from stepdiag_ros.estimate.identifiability import unidentifiable
from stepdiag_ros.estimate.index_once import divided_otherwise
from stepdiag_ros.estimate.metres import Metres, in_metres
from stepdiag_ros.estimate.parameters import STATION
from stepdiag_ros.estimate.propagate import Setting, Uncertainty, index_sigma, propagate, with_budget
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.estimate.sanity_fit import check_fit
from stepdiag_ros.estimate.solution import Residuals, Solution
from stepdiag_ros.estimate.status import reasons, status_of
from stepdiag_ros.estimate.traceability import NOBODY
from stepdiag_ros.model.budget import MEASURED, Budget
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.model.standard_budget import standard_budget
from stepdiag_ros.model.surroundings import UNSTATED_TEMPERATURE


@dataclass(frozen=True)
class Evaluation:
    """A log evaluated in full: stops in metres, fit, what the causes were computed from, uncertainty.

    ``source`` names the log; ``lines`` are the budget's, ``budget`` says whose they are.
    """

    metres: Metres
    fit: Fit
    setting: Setting
    uncertainty: Uncertainty
    source: str
    lines: Budget
    budget: str

    @property
    def solution(self) -> Solution:
        return self.uncertainty.solution


def budget_of(description: Description) -> Budget:
    """The budget that a log belongs to: the cell's own lines, the standard ones for what it does not name."""
    standard = standard_budget()
    return standard if description.budget is None else description.budget.over(standard)


def evaluate(log: CalibrationLog) -> Solution:
    """All errors and misalignments of a log by the enhanced step diagonal method, with the whole budget.

    Pure: the same log gives the same bits.  The solution's ``sanity`` names mistakes of commissioning that the log
    shows; with any the status is not ok.  Raises :class:`~stepdiag_ros.errors.StepdiagError` where the log holds
    nothing to solve.
    """
    return evaluate_in_full(log).solution


def evaluate_in_full(log: CalibrationLog, budget: Budget | None = None, stops: StopTable | None = None) -> Evaluation:
    """As :func:`evaluate`, with what led there; ``budget`` replaces the cell's, ``stops`` the log's reduced ones, as
    recorded."""
    metres, own = in_metres(log, stops), budget is None
    budget = budget_of(log.description) if budget is None else budget
    table = metres.table
    # How well the beams of the linear setups are known to lie along their axes is in the budget.
    cosine = max((c.standard for c in budget.contributors if c.kind == 'cosine' and c.standard),
                 default=PRIOR_LASER_RAD)
    insane = check_readings(log.description, table)
    try:
        result = fit(log.description, table, linear_laser=cosine)
    except StepdiagError as error:
        raise StepdiagError(f'{log.source}: {"; ".join(map(str, insane))}') from None if insane else error
    if any(c.kind in MEASURED and c.standard is not None for c in budget.contributors):
        noise = with_budget(result.noise, budget, table, log.description)
        result = fit(log.description, table, noise, linear_laser=cosine)
    result = with_open_held(log.description, table, result, cosine)
    solution = replace(solution_of(result, table, log.warnings + table.warnings),
                       closure=closures(log, table, result.noise),
                       parts=contributions(log.description, table, result))
    solution = _with_beams(solution, log, table)
    insane = insane or check_fit(log.description, table, result)
    if insane:
        status = status_of([*(finding.found for finding in insane), *reasons(result, table)])
        solution = replace(solution, status=status, sanity=tuple(insane))
    setting = Setting.of_fit(log.description, table, result, metres.conditions)
    found = propagate(budget, setting, result, solution, np.sqrt(result.louder), weighed=True)
    whose = 'cell' if own and log.description.budget is not None else 'standard' if own else 'given'
    return Evaluation(metres, result, setting, replace(found, solution=tied(
        found.solution, log.source, metres, budget, whose)), log.source, budget, whose)


def tied(solution: Solution, source: str, metres: Metres, budget: Budget, whose: str) -> Solution:
    """``solution`` with how it is tied to the metre and to 20 °C; what must not be overlooked is in its status."""
    sensor = max((c.standard for c in budget.contributors if c.kind == 'scale_temperature' and c.standard),
                 default=UNSTATED_TEMPERATURE)
    traceability = metres.traceability(solution, index_sigma(budget, metres.conditions), whose, sensor)
    status = traceability.status if solution.status == 'ok' else solution.status
    once = divided_otherwise(solution, metres.index) if metres.air != NOBODY else []
    remarks = (f'{source}: {remark}' for remark in (*traceability.remarks, *once))
    return replace(solution, traceability=traceability, status=status, warnings=(*solution.warnings, *remarks))


def solution_of(result: Fit, table: StopTable, warnings: tuple[str, ...] = ()) -> Solution:
    """Put a fit into reported form: reference lines, names, open directions."""
    parameters = result.parameters
    names, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    information = np.linalg.inv(result.covariance) - result.precision
    open_directions = unidentifiable(parameters, names, reporting, result.covariance,
                                     result.precision, information)
    misalignments, stations = {}, {}
    for setup in parameters.setups:
        first, size = parameters.setup_first[setup], len(parameters.unknowns[setup])
        found = tuple(float(a) for a in result.theta[first:first + size])
        if parameters.unknowns[setup] == STATION:
            moved, sigma = result.model.station(result.theta, result.covariance, setup)
            misalignments[setup] = Misalignment(station=tuple(moved.tolist()))
            stations[setup] = _station(result, table, setup, moved, sigma)
        else:
            misalignments[setup] = Misalignment(found[:2], found[2:])
    noise = {'position_repeatability_m': result.noise.position,
             'angle_repeatability_rad': result.noise.angle, 'source': result.noise.source}
    return Solution(
        'enhanced', parameters.knots, tuple(names), reporting @ result.theta,
        reporting @ result.covariance @ reporting.T,
        status=status_of(reasons(result, table)),
        reduced_chi2=result.chi2 / max(result.dof, 1), dof=result.dof,
        unidentifiable=open_directions, gauge=GAUGE, misalignments=misalignments, noise=noise,
        residuals=_residuals(result, table), warnings=warnings,
        extra={'iterations': result.iterations} | ({'stations': stations} if stations else {}))


def _with_beams(solution: Solution, log: CalibrationLog, table: StopTable) -> Solution:
    """``solution`` with how the beams of regulated stations were held."""
    stations = solution.extra.get('stations', {})
    beams, warnings = held_beams(log, table, stations)
    if not beams:
        return solution
    told = {name: station | ({'beam': beams[name]} if name in beams else {}) for name, station in stations.items()}
    return replace(solution, extra=solution.extra | {'stations': told}, warnings=(*solution.warnings, *warnings))


def _station(result: Fit, table: StopTable, setup: str, moved: np.ndarray, sigma: np.ndarray,
             ) -> dict[str, list[float] | float]:
    """Where a station was found to stand and the dead path of its first run, each with its uncertainty by repeats."""
    parameters, rows = result.parameters, np.flatnonzero(table.setup == table.setup_names.index(setup))
    place = result.model.places[rows[0]] + moved
    offset = parameters.offset_first + int(table.run[rows[0]]) * parameters.beams
    return {'position_m': place.tolist(), 'sigma_m': sigma.tolist(), 'dead_path_m': -float(result.theta[offset]),
            'dead_path_sigma_m': float(np.sqrt(result.covariance[offset, offset]))}


def _residuals(result: Fit, table: StopTable) -> Residuals:
    beams = result.residual.shape[1] - 2
    names = np.array(table.setup_names, dtype=object)
    return Residuals(np.array(table.run_ids, dtype=object)[table.run], names[table.setup],
                     table.repeat, table.direction, table.index, table.axis, table.time_s,
                     result.residual[:, :beams], result.residual[:, beams:])
