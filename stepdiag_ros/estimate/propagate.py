"""GUM propagation of a budget through the enhanced method, contributor by contributor.

At the solution the estimate is a linear map of the readings, ``θ ← θ + G δy`` with
``G = C Jᵀ WᵀW`` (Dahlem et al. eq. 6, with all errors of readings correlated as they are).  A contributor
acts on the readings by a matrix of columns, one for each independent variate of standard deviation 1
(an arrival, a sample mean, a setup, or one for the whole log); ``S = R G B`` with the reporting matrix R
is what it does to the reported errors, ``S Sᵀ`` its covariance.  The sum over the contributors, correlations
and all, is the combined covariance, which goes on to any point of the volume through
:mod:`stepdiag_ros.estimate.prediction`.

What no contributor causes but the data leave open (:mod:`stepdiag_ros.estimate.identifiability`) is a
line of its own, ``held by width``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse, stats

from stepdiag_ros.estimate.conditions import UNREFERRED, Conditions
from stepdiag_ros.estimate.enhanced import Fit, readings_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import NoiseModel, arrivals
from stepdiag_ros.estimate.prediction import sensitivities
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.shared import weigh
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.traceability import REFERENCE_TEMPERATURE
from stepdiag_ros.model.budget import MEASURED, Budget, Contributor
from stepdiag_ros.model.description import Description, Machine
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.path import setup_direction, start_corner

HELD = 'held by width'
STEP_M = 1.0e-4
"""By how much a length of the description is moved to see what it does [m]."""


@dataclass(frozen=True)
class Cause:
    """A contributor on one log.

    ``readings`` (n·c, k) sparse [m]: what each of its k variates of deviation 1 does to the readings;
    ``errors``: curve → (k,) slope [1] that it adds to the positioning error itself (thermal), empty otherwise;
    ``dof``: degrees of freedom of its size.
    """

    contributor: Contributor
    readings: sparse.csr_array
    errors: Mapping[str, np.ndarray]
    dof: float

    @property
    def variates(self) -> int:
        return self.readings.shape[1]


@dataclass(frozen=True)
class Setting:
    """What the causes are computed from: description, stops, arrival derivatives, noise, conditions.

    ``readings`` (n, c) [m] and ``arrival`` (5, n, c) as in the fit; ``model`` and ``theta``: where it ended.
    """

    description: Description
    table: StopTable
    readings: np.ndarray
    arrival: np.ndarray
    noise: NoiseModel
    conditions: Conditions
    model: ForwardModel
    theta: np.ndarray

    @classmethod
    def of_fit(cls, description: Description, table: StopTable, result: Fit,
               conditions: Conditions | None = None) -> 'Setting':
        return cls(description, table, readings_of(table), result.arrival, result.noise,
                   conditions or Conditions(), result.model, result.theta)

    @property
    def paths(self) -> np.ndarray:
        """Distance (n,) [m] from base unit to mirror at each stop, nominally."""
        machine, out = self.description.machine, np.empty(len(self.table))
        for number, name in enumerate(self.table.setup_names):
            rows = self.table.setup == number
            out[rows] = self.description.setups[name].standoff + \
                (self.table.commanded[rows] - start_corner(machine, name)) @ setup_direction(machine, name)
        return out


def with_budget(noise: NoiseModel, budget: Budget, setting_table: StopTable,
                description: Description) -> NoiseModel:
    """The noise model with the budget's own numbers where it gives numbers, so that the fit weighs with them."""
    given = {c.kind: c.standard for c in budget.contributors if c.standard is not None}
    sensor, beams = noise.sensor.copy(), noise.sensor.shape[1] - 2
    for kind, columns, count in (('interferometer_noise', slice(0, beams), setting_table.displacement_count),
                                 ('psd_noise', slice(beams, None), setting_table.spot_count)):
        if given.get(kind):
            sensor[:, columns] = given[kind] / np.sqrt(np.maximum(count, 1))[:, None]
    return replace(noise, position=given.get('position_repeatability') or noise.position,
                   angle=given.get('angle_repeatability') or noise.angle, sensor=sensor)


def causes(budget: Budget, setting: Setting) -> list[Cause]:
    """Every contributor of ``budget`` on the log of ``setting``, and what the conditions add without being asked."""
    named = {c.kind for c in budget.contributors}
    added = [c for c in UNASKED if c.kind not in named and _standard(c, setting.conditions) > 0.0]
    return [_cause(contributor, setting) for contributor in (*budget.contributors, *added)]


def _cause(contributor: Contributor, setting: Setting) -> Cause:
    size, dof = setting.readings.size, contributor.dof
    nothing: dict[str, np.ndarray] = {}
    kind, noise = contributor.kind, setting.noise
    if kind == 'position_repeatability':
        dof = dof if contributor.value is not None else float(noise.dof[0]) or math.inf
        return Cause(contributor, noise.position * _arrival_columns(setting), nothing, dof)
    if kind == 'angle_repeatability':
        dof = dof if contributor.value is not None else float(noise.dof[1]) or math.inf
        return Cause(contributor, noise.angle * _turn_columns(setting), nothing, dof)
    if kind in ('interferometer_noise', 'psd_noise'):
        sigma = noise.sensor.copy()
        beams = sigma.shape[1] - 2
        sigma[:, beams:] *= kind == 'psd_noise'
        sigma[:, :beams] *= kind == 'interferometer_noise'
        keep = np.flatnonzero(sigma.ravel())
        columns = sparse.csr_array((sigma.ravel()[keep], (keep, np.arange(len(keep)))), (size, len(keep)))
        return Cause(contributor, columns, nothing, dof)
    if kind in ('scale_temperature', 'expansion_coefficient'):
        slopes = _thermal_slopes(contributor, setting.conditions)
        effect = {f'E{letter}{letter}': slopes[a] * np.eye(3)[a] for a, letter in enumerate(AXES)}
        return Cause(contributor, sparse.csr_array((size, 3)), effect, dof)
    if kind in STOPWISE:
        return Cause(contributor, contributor.standard * STOPWISE[kind](setting), nothing, dof)
    standard = _standard(contributor, setting.conditions)
    columns = standard * _systematic(kind, contributor, setting)
    return Cause(contributor, sparse.csr_array(columns.reshape(len(columns), size).T), nothing, dof)


UNASKED = (Contributor('air temperature', 'air_temperature', 'B', 'normal', 0.0),
           Contributor('air pressure', 'air_pressure', 'B', 'normal', 0.0),
           Contributor('humidity', 'humidity', 'B', 'normal', 0.0),
           Contributor('index of air', 'index_formula', 'B', 'normal', 0.0),
           Contributor('air variation', 'air_variation', 'B', 'normal', 0.0))
"""Lines without a size of their own, for conditions that leave the air unknown under a budget that is silent on it."""


def _standard(contributor: Contributor, conditions: Conditions) -> float:
    """Standard uncertainty of a contributor with what these conditions add to it: less known, more uncertain."""
    more = {'air_temperature': conditions.doubt[0], 'air_pressure': conditions.doubt[1],
            'humidity': conditions.doubt[2], 'index_formula': conditions.unknown,
            'air_variation': conditions.variation}
    return float(np.hypot(contributor.standard, more.get(contributor.kind, 0.0)))


def index_sigma(budget: Budget, conditions: Conditions) -> float:
    """Standard uncertainty [1] of the unit of length, alike in the whole log: wavelength, sensors, formula, doubt."""
    named = {c.kind for c in budget.contributors}
    slopes = {kind: conditions.index_slope(kind) for kind in ('air_temperature', 'air_pressure', 'humidity')}
    slopes |= {'scale': 1.0, 'index_formula': 1.0}
    lines = (*budget.contributors, *(c for c in UNASKED if c.kind not in named))
    return float(np.linalg.norm([_standard(c, conditions) * slopes[c.kind] for c in lines if c.kind in slopes]))


def _thermal_slopes(contributor: Contributor, conditions: Conditions) -> np.ndarray:
    """Standard uncertainty (3,) [1] of the slopes of EXX, EYY, EZZ by their scales' temperatures or material."""
    own, referred = np.array(conditions.expansion), np.array(conditions.referred)
    if contributor.kind == 'expansion_coefficient':
        given = np.array(conditions.expansion_sigma)
        sigma = np.where(np.isfinite(given), given, contributor.standard)
        return np.where(referred, sigma * np.abs(np.array(conditions.scales) - REFERENCE_TEMPERATURE), 0.0)
    by_sensor = contributor.standard * np.where(np.isfinite(own), own, contributor.coefficient)
    return np.where(referred, by_sensor, np.hypot(by_sensor, UNREFERRED))


def _systematic(kind: str, contributor: Contributor, setting: Setting) -> np.ndarray:
    """Effects (k, n, c) on the readings per unit of the contributor's quantity."""
    readings, table = np.nan_to_num(setting.readings), setting.table
    beams = readings.shape[1] - 2
    length, spot = np.zeros_like(readings), np.zeros_like(readings)
    length[:, :beams], spot[:, beams:] = readings[:, :beams], readings[:, beams:]
    if kind in ('scale', 'index_formula'):
        return length[None]
    if kind in ('air_temperature', 'air_pressure', 'humidity'):
        return length[None] * -setting.conditions.index_slope(kind)
    if kind in ('dead_path', 'air_variation'):
        return _in_runs(kind, setting, length)
    if kind == 'cosine':
        linear = [i for i, n in enumerate(table.setup_names) if setting.description.setups[n].is_linear]
        # L ε² E with E exponential; the value squares, the standard uncertainty is taken off outside.
        effects = [-contributor.standard * np.where((table.setup == i)[:, None], length, 0.0) for i in linear]
        return np.array(effects) if effects else np.zeros((1, *readings.shape))
    if kind == 'psd_gain':
        return np.stack([np.where(np.arange(beams + 2) == beams + k, spot, 0.0) for k in range(2)])
    if kind == 'psd_rotation':
        turned = np.zeros_like(readings)
        turned[:, beams], turned[:, beams + 1] = -spot[:, beams + 1], spot[:, beams]
        return turned[None]
    if kind in ('tool', 'beam_offset', 'standoff'):
        return _of_description(kind, setting)
    zero = [np.where((table.setup == i)[:, None] & (np.arange(beams + 2) == beams + k), 1.0, 0.0)
            for i in np.unique(table.setup) for k in range(2)]
    return np.array(zero)


def _in_runs(kind: str, setting: Setting, length: np.ndarray) -> np.ndarray:
    """Effects (k, n, c) of an index that changes within each run by 1, and (``air_variation``) from run to run."""
    table, beams, effects = setting.table, length.shape[1] - 2, []
    standoff = np.array([setting.description.setups[n].standoff for n in table.setup_names])[table.setup]
    path = standoff if kind == 'dead_path' else setting.paths
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        # The index goes on changing through the run; the reset was at its first stop.
        effect = np.zeros_like(length)
        effect[rows, :beams] = (np.linspace(0.0, 1.0, len(rows)) * path[rows])[:, None]
        effects.append(effect)
        if kind == 'air_variation':
            effects.append(np.where((table.run == run)[:, None], length, 0.0))
    return np.array(effects)


def _of_description(kind: str, setting: Setting) -> np.ndarray:
    """Effects (k, n, c) per metre of an error in the tool vector, the beams' offsets or the standoffs.

    Differences of the full model at the solution; what such an error does to an ideal machine that nobody
    misaligned is a constant, which the resets take out.
    """
    description, table, model = setting.description, setting.table, setting.model
    moved: list[Description] = []
    if kind == 'tool':
        moved = [replace(description, machine=replace(description.machine, tool=tuple(
            np.array(description.machine.tool) + STEP_M * np.eye(3)[k]))) for k in range(3)]
    for number in np.unique(table.setup) if kind != 'tool' else ():
        name = table.setup_names[number]
        setup = description.setups[name]
        if kind == 'standoff':
            changed = [replace(setup, standoff=setup.standoff + STEP_M)]
        else:
            steps = STEP_M * np.eye(2)
            changed = [replace(setup, psd_offset=tuple(np.array(setup.psd_offset) + step)) for step in steps]
            changed += [replace(setup, beams=tuple(
                tuple(np.array(beam) + (step if own == k else 0.0)) for own, beam in enumerate(setup.beams)))
                for k in range(len(setup.beams)) for step in steps]
        moved += [replace(description, setups=description.setups | {name: one}) for one in changed]
    nominal = model.predict(setting.theta)
    return np.array([(ForwardModel(one, table, model.parameters).predict(setting.theta) - nominal) / STEP_M
                     for one in moved])


def _cyclic_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, n) of a unit swing of the lengths at each stop."""
    n, channels = setting.readings.shape
    rows = (np.arange(n)[:, None] * channels + np.arange(channels - 2)).ravel()
    return sparse.csr_array((np.ones(len(rows)), (rows, np.repeat(np.arange(n), channels - 2))), (n * channels, n))


def _places(setting: Setting) -> tuple[np.ndarray, int]:
    """Number of the place where each stop's beams strike (n,): one for each stop of each setup."""
    _, place = np.unique(np.stack([setting.table.setup, setting.table.index], axis=1), axis=0, return_inverse=True)
    return np.ravel(place), int(place.max()) + 1


def _flatness_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, places) of a unit height of the mirror at each place."""
    n, channels = setting.readings.shape
    place, count = _places(setting)
    rows = (np.arange(n)[:, None] * channels + np.arange(channels - 2)).ravel()
    return sparse.csr_array((np.ones(len(rows)), (rows, np.repeat(place, channels - 2))), (n * channels, count))


def _slope_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, 2 places) of a unit slope of the mirror at each place, about u and about v: (−2Lβ, 2Lα)."""
    n, channels = setting.readings.shape
    place, count = _places(setting)
    first, twice = np.arange(n) * channels + channels - 2, 2.0 * setting.paths
    return sparse.csr_array((np.concatenate([twice, -twice]),
                             (np.concatenate([first + 1, first]), np.concatenate([place, count + place]))),
                            (n * channels, 2 * count))


STOPWISE: dict[str, Callable[[Setting], sparse.csr_array]] = {
    'cyclic': _cyclic_columns, 'mirror_flatness': _flatness_columns, 'mirror_slope': _slope_columns}
"""Contributors with a variate for each stop or place."""


def _arrival_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, arrivals) of a unit error at each arrival of each axis."""
    numbers, channels = arrivals(setting.table), setting.readings.shape[1]
    rows, columns, values, first = [], [], [], 0
    flat = np.arange(len(setting.table))[:, None] * channels + np.arange(channels)
    for axis in range(3):
        _, own = np.unique(numbers[:, axis], return_inverse=True)
        rows.append(flat.ravel())
        columns.append(first + np.repeat(np.ravel(own), channels))
        values.append(setting.arrival[2 + axis].ravel())
        first += int(own.max()) + 1
    return sparse.csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                            (setting.readings.size, first))


def _turn_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, 2 n) of a unit turn of the mirror at each stop."""
    n, channels = setting.readings.shape
    flat = (np.arange(n)[:, None] * channels + np.arange(channels)).ravel()
    values = np.concatenate([setting.arrival[k].ravel() for k in range(2)])
    columns = np.concatenate([np.repeat(np.arange(n) + k * n, channels) for k in range(2)])
    return sparse.csr_array((values, (np.tile(flat, 2), columns)), (n * channels, 2 * n))


def gain(result: Fit, rows: np.ndarray | None = None) -> np.ndarray:
    """``G`` (size, n·c), or ``rows @ G``: what a small change of the readings does to the unknowns.

    Columns of readings that are absent are zero.
    """
    left = result.covariance if rows is None else rows @ result.covariance
    out = np.zeros((len(left), result.jacobian.shape[0]))
    for white in result.whiteners:
        block = (result.jacobian[white.rows] @ left.T)
        out[:, white.rows] = linalg.cho_solve((white.factor, True), block, check_finite=False).T
    return out


@dataclass(frozen=True)
class Uncertainty:
    """Combined uncertainty of a solution.

    ``solution`` carries the combined covariance; ``causes`` and ``effects`` go together: effect
    (p, k) of every variate of deviation 1 on the reported errors; ``held`` (p, p) covariance of what is open.
    """

    solution: Solution
    causes: tuple[Cause, ...]
    effects: tuple[np.ndarray, ...]
    held: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        return (*(cause.contributor.name for cause in self.causes), HELD)

    def shares(self) -> np.ndarray:
        """Standard uncertainty (contributors + 1, p) of each reported error by each contributor."""
        own = [np.sqrt(np.sum(effect**2, axis=1)) for effect in self.effects]
        return np.array([*own, np.sqrt(np.maximum(np.diag(self.held), 0.0))])

    def at(self, machine: Machine, points: np.ndarray, tool: np.ndarray | None = None) -> np.ndarray:
        """Standard uncertainty (contributors + 1, n, 3) [m] of the deviation at ``points`` (n, 3) [m]."""
        points = np.atleast_2d(np.asarray(points, float))
        tool = np.asarray(machine.tool if tool is None else tool, float)
        columns, weights = sensitivities(self.solution, machine, points, tool)
        out = np.empty((len(self.names), *points.shape))
        for i, effect in enumerate(self.effects):
            out[i] = np.sqrt(np.sum((weights @ effect[columns])**2, axis=2))
        near = self.held[columns[:, :, None], columns[:, None, :]]
        spread = np.einsum('nik,nkl,nil->ni', weights, near, weights)
        out[-1] = np.sqrt(np.maximum(spread, 0.0))
        return out

    def effective_dof(self, shares: np.ndarray) -> np.ndarray:
        """Welch and Satterthwaite: degrees of freedom (…) from ``shares`` (contributors + 1, …)."""
        dof = np.array([*(cause.dof for cause in self.causes), np.inf])
        weight = np.tensordot(1.0 / dof, shares**4, axes=1)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.where(weight > 0.0, np.sum(shares**2, axis=0)**2 / weight, np.inf)


def coverage_factor(dof: np.ndarray, probability: float = 0.9545) -> np.ndarray:
    """k of a two-sided interval; 2 for infinite degrees of freedom."""
    dof = np.asarray(dof, float)
    finite = np.isfinite(dof)
    return np.where(finite, stats.t.ppf(0.5 + probability / 2.0, np.where(finite, dof, 1e9)),
                    stats.norm.ppf(0.5 + probability / 2.0))


def error_slopes(cause: Cause, solution: Solution) -> np.ndarray:
    """What a cause adds to the reported errors past the readings (p, k)."""
    out = np.zeros((len(solution.names), cause.variates))
    for row, (name, knot) in enumerate(solution.names):
        if name in cause.errors:
            out[row] = np.asarray(solution.positions[name])[knot] * cause.errors[name]
    return out


SHARED = ('psd_zero', 'psd_gain', 'psd_rotation', 'cosine', 'dead_path', 'air_variation', 'tool', 'beam_offset',
          'standoff')
"""Kinds whose variates act on many readings, and not on all lengths alike."""


def _scaled(cause: Cause, misfit: float) -> Cause:
    measured = cause.contributor.kind in MEASURED and misfit != 1.0
    return replace(cause, readings=misfit * cause.readings) if measured else cause


def propagate(budget: Budget, setting: Setting, result: Fit, solution: Solution,
              misfit: float = 1.0, weighed: bool = False) -> Uncertainty:
    """Combined uncertainty of ``solution``, which belongs to ``result``.

    ``misfit``: by what the measured contributors are scaled where the residuals are larger than they say;
    ``weighed``: take the step to the estimate that weighs shared errors too (:mod:`stepdiag_ros.estimate.shared`).
    """
    parameters = result.parameters
    _, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    acting = tuple(_scaled(cause, misfit) for cause in causes(budget, setting))
    shared = [cause.readings.toarray() for cause in acting if cause.contributor.kind in SHARED]
    if weighed and shared:
        found = weigh(result, reporting, np.hstack(shared), misfit)
        sensitivity, half = found.gain, found.half
        solution = replace(solution, value=solution.value + found.shift)
    else:
        sensitivity, half = gain(result, reporting), reporting @ result.covariance
    effects = tuple((cause.readings.T @ sensitivity.T).T + error_slopes(cause, solution) for cause in acting)
    held = half @ result.precision @ half.T
    covariance = held + sum(effect @ effect.T for effect in effects)
    alone = held + sum((effect @ effect.T for cause, effect in zip(acting, effects, strict=True)
                        if cause.contributor.kind in MEASURED), np.zeros_like(held))
    return Uncertainty(replace(solution, covariance=covariance, repeatability=alone), acting, effects, held)


__all__ = ['HELD', 'Cause', 'Conditions', 'Setting', 'Uncertainty', 'causes', 'coverage_factor', 'gain',
           'propagate', 'with_budget']
