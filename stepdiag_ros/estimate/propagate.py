"""GUM propagation of a budget through the enhanced method, contributor by contributor.

At the solution the estimate is a linear map of the readings, ``θ ← θ + G δy`` with
``G = C Jᵀ WᵀW`` (Dahlem et al. eq. 6, with all errors of readings correlated as they are).  A contributor
acts on the readings by a matrix of columns, one for each independent variate of standard deviation 1
(an arrival, a sample mean, a setup, or one for the whole log); ``S = R G B`` with the reporting matrix R
is what it does to the reported errors, ``S Sᵀ`` its covariance.  The sum over the contributors, correlations
and all, is the combined covariance, which goes on to any point of the volume through
:mod:`stepdiag_ros.estimate.prediction`.

What no contributor causes but the data leave open (:mod:`stepdiag_ros.estimate.identifiability`) is a
line of its own, ``held by prior``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse, special

from stepdiag_ros.estimate.columns import STOPWISE, Setting, arrival_columns, stop_columns, systematic, turn_columns
from stepdiag_ros.estimate.conditions import ANY_SCALE, MOST_SCALE, UNREFERRED, Conditions
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.parameters import Parameters
from stepdiag_ros.estimate.prediction import sensitivities
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.shared import Weighed, weigh
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.traceability import REFERENCE_TEMPERATURE
from stepdiag_ros.model.budget import MEASURED, Budget, Contributor
from stepdiag_ros.model.description import Description, Machine
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.sensor import Misalignment

HELD = 'held by prior'


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
        return Cause(contributor, noise.position * arrival_columns(setting), nothing, dof)
    if kind == 'angle_repeatability':
        dof = dof if contributor.value is not None else float(noise.dof[1]) or math.inf
        return Cause(contributor, noise.angle * turn_columns(setting), nothing, dof)
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
    columns = standard * systematic(kind, contributor, setting)
    return Cause(contributor, sparse.csr_array(columns.reshape(len(columns), size).T), nothing, dof)


UNASKED = (Contributor('air temperature', 'air_temperature', 'B', 'normal', 0.0),
           Contributor('air pressure', 'air_pressure', 'B', 'normal', 0.0),
           Contributor('humidity', 'humidity', 'B', 'normal', 0.0),
           Contributor('index of air', 'index_formula', 'B', 'normal', 0.0),
           Contributor('air variation', 'air_variation', 'B', 'normal', 0.0))
"""Lines without a size of their own, for conditions that leave the air unknown under a budget that is silent on it."""


def _standard(contributor: Contributor, conditions: Conditions) -> float:
    """Standard uncertainty of a contributor with what these conditions add to it: less known, more uncertain."""
    more = {'air_temperature': conditions.air_sigma[0], 'air_pressure': conditions.air_sigma[1],
            'humidity': conditions.air_sigma[2], 'index_formula': conditions.unknown,
            'air_variation': conditions.variation}
    return float(np.hypot(contributor.standard, more.get(contributor.kind, 0.0)))


def index_sigma(budget: Budget, conditions: Conditions) -> float:
    """Standard uncertainty [1] of the unit of length, alike in the whole log: wavelength, sensors, formula, air."""
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
    sensor = np.maximum(contributor.standard, np.array(conditions.scale_sigma))
    by_sensor = sensor * np.where(np.isfinite(own), own, contributor.coefficient)
    shown = ANY_SCALE * np.hypot(np.array(conditions.away), sensor)
    # A scale of which nothing is stated may be one that expands most.
    unstated = sensor * np.where(np.isfinite(own), own, max(MOST_SCALE, contributor.coefficient))
    return np.where(referred, by_sensor, np.maximum(unstated, np.fmin(shown, UNREFERRED)))


def gain(result: Fit, rows: np.ndarray | None = None) -> np.ndarray:
    """``G`` (size, n·c), or ``rows @ G``: what a small change of the readings does to the unknowns.

    Columns of readings that are absent are zero.
    """
    left = result.covariance if rows is None else rows @ result.covariance
    out = np.zeros((len(left), result.jacobian.shape[0]))
    for white in result.whiteners:
        block = (result.jacobian[white.rows] @ left.T)
        out[:, white.rows] = white.weighted(block).T
    return out


@dataclass(frozen=True)
class Uncertainty:
    """Combined uncertainty of a solution.

    ``solution`` carries the combined covariance; ``causes`` and ``effects`` go together: effect
    (p, k) of every variate of deviation 1 on the reported errors; ``held`` (p, p) covariance of what is open;
    ``step`` from the fit to the estimate that weighs shared errors, None where it is not taken.
    """

    solution: Solution
    causes: tuple[Cause, ...]
    effects: tuple[np.ndarray, ...]
    held: np.ndarray
    step: Weighed | None = None

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
    return np.where(finite, special.stdtrit(np.where(finite, dof, 1e9), 0.5 + probability / 2.0),
                    special.ndtri(0.5 + probability / 2.0))


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
    setups, columns = _aligned(parameters)
    count, rows = len(reporting), np.vstack([reporting, np.eye(parameters.size)[columns]])
    acting = tuple(_scaled(cause, misfit) for cause in causes(budget, setting))
    if weighed:
        shared = [cause.readings.toarray() for cause in acting if cause.contributor.kind in SHARED]
        stopwise = [cause.contributor.standard * stop_columns(cause.contributor.kind, setting)
                    for cause in acting if cause.contributor.kind in STOPWISE and cause.contributor.standard]
        found = weigh(result, rows, np.hstack([np.zeros((setting.readings.size, 0)), *shared]), misfit,
                      sparse.hstack(stopwise, format='csr') if stopwise else None)
        sensitivity, half, shift = found.gain, found.half, found.shift
        found = Weighed(sensitivity[:count], half[:count], shift[:count])
    else:
        found, shift = None, np.zeros(len(rows))
        sensitivity, half = gain(result, rows), rows @ result.covariance
    angles = _misalignments(setups, result.theta[columns] + shift[count:])
    effects = tuple((cause.readings.T @ sensitivity.T).T for cause in acting)
    variance = np.sum((half[count:] @ result.precision) * half[count:], axis=1) + \
        sum(np.sum(effect[count:]**2, axis=1) for effect in effects)
    half = half[:count]
    solution = replace(solution, value=solution.value + shift[:count],
                       misalignments={**solution.misalignments, **angles},
                       misalignment_sigma=_misalignments(setups, np.sqrt(np.maximum(variance, 0.0))))
    effects = tuple(effect[:count] + error_slopes(cause, solution)
                    for cause, effect in zip(acting, effects, strict=True))
    held = half @ result.precision @ half.T
    covariance = held + sum(effect @ effect.T for effect in effects)
    alone = held + sum((effect @ effect.T for cause, effect in zip(acting, effects, strict=True)
                        if cause.contributor.kind in MEASURED), np.zeros_like(held))
    return Uncertainty(replace(solution, covariance=covariance, repeatability=alone), acting, effects, held, found)


def _aligned(parameters: Parameters) -> tuple[list[str], np.ndarray]:
    """The setups whose angles a log finds, and the columns (4 a setup) of these: not lines along one axis, whose spots
    show the difference of mirror and beam alone, and whose beam is where it is believed to be."""
    setups = [setup for setup in parameters.setups if setup not in parameters.straight]
    return setups, np.array([parameters.setup_first[setup] + k for setup in setups for k in range(4)], int)


def _misalignments(setups: list[str], values: np.ndarray) -> dict[str, Misalignment]:
    """``values`` (4·setups,) by setup."""
    return {setup: Misalignment((float(v[0]), float(v[1])), (float(v[2]), float(v[3])))
            for setup, v in zip(setups, values.reshape(-1, 4), strict=True)}


__all__ = ['HELD', 'Cause', 'Conditions', 'Setting', 'Uncertainty', 'causes', 'coverage_factor', 'gain',
           'propagate', 'with_budget']
