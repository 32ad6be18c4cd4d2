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
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse, stats

from stepdiag_ros.model.budget import Budget, Contributor
from stepdiag_ros.estimate.enhanced import Fit, readings_of
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import NoiseModel, arrivals
from stepdiag_ros.estimate.prediction import sensitivities
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.description import Description, Machine
from stepdiag_ros.model.machine import AXES

REFERENCE_TEMPERATURE = 20.0
HELD = 'held by width'


@dataclass(frozen=True)
class Conditions:
    """Where the log was taken: air [°C, Pa, 0..1] and scale temperatures X, Y, Z [°C]."""

    temperature: float = 20.0
    pressure: float = 101325.0
    humidity: float = 0.5
    scales: tuple[float, float, float] = (20.0, 20.0, 20.0)

    @classmethod
    def of_environment(cls, environment: Mapping[str, object]) -> 'Conditions':
        """Means of what was logged; standard values for the rest."""
        def mean(key: str, otherwise: float) -> float:
            series = environment.get(key)
            values = np.zeros(0) if series is None else series.value
            values = values[np.isfinite(values)]
            return float(values.mean()) if len(values) else otherwise

        return cls(mean('air_temperature', 20.0), mean('air_pressure', 101325.0), mean('humidity', 0.5),
                   tuple(mean(f'scale_temperature/{axis}', 20.0) for axis in 'xyz'))

    def index_slope(self, kind: str) -> float:
        """Derivative of the index of air by temperature [1/K], pressure [1/Pa] or humidity [1]."""
        place = ('air_temperature', 'air_pressure', 'humidity').index(kind)
        step, point = (0.1, 10.0, 0.01)[place], [self.temperature, self.pressure, self.humidity]
        ends = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[place] += sign * step
            ends.append(float(refractive_index(*moved)))
        return (ends[0] - ends[1]) / (2.0 * step)


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

    ``readings`` (n, c) [m] and ``arrival`` (5, n, c) as in the fit.
    """

    description: Description
    table: StopTable
    readings: np.ndarray
    arrival: np.ndarray
    noise: NoiseModel
    conditions: Conditions

    @classmethod
    def of_fit(cls, description: Description, table: StopTable, result: Fit,
               conditions: Conditions | None = None) -> 'Setting':
        return cls(description, table, readings_of(table), result.arrival, result.noise,
                   conditions or Conditions())


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
    """Every contributor of ``budget`` on the log of ``setting``."""
    return [_cause(contributor, setting) for contributor in budget.contributors]


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
        if kind == 'scale_temperature':
            slopes = np.full(3, contributor.standard * contributor.coefficient)
        else:
            slopes = contributor.standard * (np.array(setting.conditions.scales) - REFERENCE_TEMPERATURE)
        effect = {f'E{letter}{letter}': slopes[a] * np.eye(3)[a] for a, letter in enumerate(AXES)}
        return Cause(contributor, sparse.csr_array((size, 3)), effect, dof)
    columns = contributor.standard * _systematic(kind, contributor, setting)
    return Cause(contributor, sparse.csr_array(columns.reshape(len(columns), size).T), nothing, dof)


def _systematic(kind: str, contributor: Contributor, setting: Setting) -> np.ndarray:
    """Effects (k, n, c) on the readings per unit of the contributor's quantity."""
    readings, table = np.nan_to_num(setting.readings), setting.table
    beams = readings.shape[1] - 2
    length, spot = np.zeros_like(readings), np.zeros_like(readings)
    length[:, :beams], spot[:, beams:] = readings[:, :beams], readings[:, beams:]
    if kind == 'scale':
        return length[None]
    if kind in ('air_temperature', 'air_pressure', 'humidity'):
        return length[None] * -setting.conditions.index_slope(kind)
    if kind == 'dead_path':
        # The index goes on changing through the run; the reset was at its first stop.
        standoff = np.array([setting.description.setups[n].standoff for n in table.setup_names])
        effects = []
        for run in np.unique(table.run):
            rows = np.flatnonzero(table.run == run)
            share = np.linspace(0.0, 1.0, len(rows))
            effect = np.zeros_like(readings)
            effect[rows, :beams] = (share * standoff[table.setup[rows]])[:, None]
            effects.append(effect)
        return np.array(effects)
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
    zero = [np.where((table.setup == i)[:, None] & (np.arange(beams + 2) == beams + k), 1.0, 0.0)
            for i in np.unique(table.setup) for k in range(2)]
    return np.array(zero)


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


def propagate(budget: Budget, setting: Setting, result: Fit, solution: Solution) -> Uncertainty:
    """Combined uncertainty of ``solution``, which belongs to ``result``."""
    parameters = result.parameters
    _, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    sensitivity = gain(result, reporting)
    acting = tuple(causes(budget, setting))
    effects = tuple((cause.readings.T @ sensitivity.T).T + error_slopes(cause, solution) for cause in acting)
    half = reporting @ result.covariance
    held = half @ result.precision @ half.T
    covariance = held + sum(effect @ effect.T for effect in effects)
    return Uncertainty(replace(solution, covariance=covariance), acting, effects, held)


__all__ = ['HELD', 'Cause', 'Conditions', 'Setting', 'Uncertainty', 'causes', 'coverage_factor', 'gain',
           'propagate', 'with_budget']
