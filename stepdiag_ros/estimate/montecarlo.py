"""GUM Supplement 1: a budget drawn many times and carried through an estimator.

Three roads, one result (:class:`Drawn`):

* :func:`linear`: all draws in one matrix product through the gain of the enhanced method.  Costs
  little more than its random numbers.
* :func:`chords`: the full model of the enhanced method, every draw by Gauss–Newton with the fixed matrix of
  the solution.  Each pass is one evaluation of the model a draw and one matrix product for all.
* :func:`each`: any estimator that takes a table of stops, draw by draw.

:func:`draw_readings` makes the readings.  The noise of arrival moves the mirror and goes through the sensor
(the contract's closed form, or a traced scene); what instruments add is linear in the readings.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import arrivals
from stepdiag_ros.estimate.planned import Sensor, filled, observe
from stepdiag_ros.estimate.propagate import Cause, Setting, Uncertainty, error_slopes, gain
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.shared import Weighed
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.budget import Contributor
from stepdiag_ros.model.machine import GeometricErrors
from stepdiag_ros.model.path import local_triad, setup_direction
from stepdiag_ros.model.sensor import Misalignment

BLOCK = 500
"""Draws worked on together."""
PASSES = 12
STANDARD_NORMAL = Contributor('normal contributors together', 'scale', 'B', 'normal', 1.0)


@dataclass(frozen=True)
class Drawn:
    """``values`` (draws, p): reported errors, in the order of ``names``; NaN rows where a draw failed.

    ``left`` [σ]: the largest last step of the iteration against the standard uncertainty (0: none needed).
    """

    names: tuple[tuple[str, int], ...]
    values: np.ndarray
    left: float = 0.0

    @property
    def covariance(self) -> np.ndarray:
        return np.cov(self.values, rowvar=False)

    @property
    def sigma(self) -> np.ndarray:
        return self.values.std(axis=0, ddof=1)

    def interval(self, probability: float = 0.9545) -> tuple[np.ndarray, np.ndarray]:
        """Probabilistically symmetric coverage interval of each error: lower, upper (p,)."""
        rest = 0.5 - probability / 2.0
        lower, upper = np.quantile(self.values, [rest, 1.0 - rest], axis=0)
        return lower, upper

    def coverage(self, truth: np.ndarray, sigma: np.ndarray, k: np.ndarray | float = 2.0) -> np.ndarray:
        """Share (p,) of draws whose interval ``value ± k sigma`` holds ``truth`` (p,); NaN where σ is zero."""
        sigma = np.asarray(sigma, float)
        inside = np.mean(np.abs(self.values - truth) <= k * sigma, axis=0)
        return np.where(sigma > 0.0, inside, np.nan)


def blocks(draws: int, size: int = BLOCK) -> Iterator[slice]:
    """Slices over ``draws``."""
    if draws < 2:
        raise StepdiagError(f'{draws} draws; Monte Carlo needs at least 2')
    for first in range(0, draws, size):
        yield slice(first, min(first + size, draws))


def linear(uncertainty: Uncertainty, draws: int, rng: np.random.Generator) -> Drawn:
    """Draws through the linear map of :func:`~stepdiag_ros.estimate.propagate.propagate`.

    Normal contributors with one common size need no variate for each cause: a square root of their
    covariance gives the same distribution from fewer (:func:`_roots`).  The open directions
    (``held by prior``) are no contributor and are not drawn.
    """
    solution = uncertainty.solution
    values = np.empty((draws, len(solution.value)))
    roots = _roots(uncertainty)
    for rows in blocks(draws):
        values[rows] = solution.value
        for contributor, effect in roots:
            values[rows] += contributor.draw(rng, (rows.stop - rows.start, effect.shape[1])) @ effect.T
    return Drawn(solution.names, values)


def _roots(uncertainty: Uncertainty) -> list[tuple[Contributor, np.ndarray]]:
    """Contributors with effects (p, k) to draw from: normals of one size put together, k at most p."""
    out, merged = [], []
    for cause, effect in zip(uncertainty.causes, uncertainty.effects, strict=True):
        c = cause.contributor
        if c.distribution != 'normal' or c.kind == 'cosine':
            out.append((c, effect))
        elif np.isinf(c.dof):
            merged.append(effect)
        else:
            # Finite degrees of freedom scale all variates of this contributor together in a trial.
            out.append((c, _root(effect)))
    if merged:
        out.append((STANDARD_NORMAL, _root(np.hstack(merged))))
    return out


def _root(effect: np.ndarray) -> np.ndarray:
    """A root (p, k') with ``root rootᵀ = effect effectᵀ`` and k' no greater than p or k."""
    if effect.shape[1] <= effect.shape[0]:
        return effect
    scale = np.sqrt(np.sum(effect**2, axis=1))
    scale[scale == 0.0] = 1.0
    triangle = np.linalg.qr((effect / scale[:, None]).T, mode='r')
    return scale[:, None] * triangle.T


@dataclass(frozen=True)
class Trial:
    """Some draws: ``readings`` (d, n, c) [m], and what acts past them, ``added`` (d, p) of the errors."""

    readings: np.ndarray
    added: np.ndarray


def draw_readings(acting: Sequence[Cause], setting: Setting, solution: Solution, errors: GeometricErrors,
                  misalignments: Mapping[str, Misalignment], draws: int, rng: np.random.Generator,
                  sensor: Sensor | None = None) -> Trial:
    """Readings of the machine ``errors`` in its setups, everything in the budget drawn.

    ``solution`` gives the layout of ``added``; ``sensor``: the contract's unless given.
    """
    table, description = setting.table, setting.description
    n, channels = setting.readings.shape
    shift, turn = np.zeros((draws, n, 3)), np.zeros((draws, n, 3))
    effect = np.zeros((draws, n * channels))
    added = np.zeros((draws, len(solution.names)))
    for cause in acting:
        unit = cause.contributor.draw(rng, (draws, cause.variates))
        if cause.contributor.kind == 'position_repeatability':
            first, numbers = 0, arrivals(table)
            for axis in range(3):
                _, own = np.unique(numbers[:, axis], return_inverse=True)
                own = np.ravel(own)
                shift[..., axis] += setting.noise.position * unit[:, first + own]
                first += int(own.max()) + 1
        elif cause.contributor.kind == 'angle_repeatability':
            triads = np.array([local_triad(setup_direction(description.machine, description.setups[name]))
                               for name in table.setup_names])[table.setup]
            for k in range(2):
                turn += setting.noise.angle * unit[:, k * n:(k + 1) * n, None] * triads[:, k]
        else:
            effect += (cause.readings @ unit.T).T
            added += unit @ error_slopes(cause, solution).T
    clean = observe(description, table, errors, misalignments, sensor, shift, turn)
    return Trial(clean + effect.reshape(clean.shape), added)


def chords(result: Fit, readings: np.ndarray, passes: int = PASSES,
           tolerance: float = 1e-3) -> tuple[np.ndarray, float]:
    """Unknowns (d, size) for readings (d, n, c) by the full model with the matrix of ``result``.

    Passes end when the largest step falls below ``tolerance`` standard deviations.  Returns also that
    largest last step [σ].
    """
    matrix = gain(result)
    pull = result.covariance @ result.precision
    sigma = np.sqrt(np.diag(result.covariance))
    theta = np.broadcast_to(result.theta, (len(readings), result.theta.size)).copy()
    flat = readings.reshape(len(readings), -1)
    left = np.inf
    for _ in range(passes):
        rest = flat - np.array([result.model.predict(t).ravel() for t in theta])
        rest[:, ~result.present.ravel()] = 0.0
        step = rest @ matrix.T - theta @ pull.T
        theta += step
        left = float(np.max(np.abs(step) / sigma))
        if left < tolerance:
            break
    return theta, left


def nonlinear(result: Fit, solution: Solution, acting: Sequence[Cause], setting: Setting,
              errors: GeometricErrors, misalignments: Mapping[str, Misalignment], draws: int,
              rng: np.random.Generator, sensor: Sensor | None = None, passes: int = PASSES,
              step: Weighed | None = None) -> Drawn:
    """Draws of everything, each evaluated by the full model of the enhanced method; with ``step`` on to the estimate
    that weighs shared errors, as an evaluation takes it."""
    parameters = result.parameters
    names, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    values, left = np.empty((draws, len(names))), 0.0
    for rows in blocks(draws, 200):
        trial = draw_readings(acting, setting, solution, errors, misalignments, rows.stop - rows.start, rng,
                              sensor)
        theta, last = chords(result, trial.readings, passes)
        values[rows] = theta @ reporting.T + trial.added
        if step is not None:
            rest = trial.readings.reshape(len(theta), -1) - np.array([result.model.predict(t).ravel() for t in theta])
            rest[:, ~result.present.ravel()] = 0.0
            values[rows] += rest @ step.gain.T - theta @ (step.half @ result.precision).T
        left = max(left, last)
    return Drawn(tuple(names), values, left)


def each(run: Callable[[StopTable], Solution], acting: Sequence[Cause], setting: Setting, solution: Solution,
         errors: GeometricErrors, misalignments: Mapping[str, Misalignment], draws: int,
         rng: np.random.Generator, sensor: Sensor | None = None) -> Drawn:
    """Draws through any estimator ``run(table) -> Solution``; ``solution`` is its answer to the log itself."""
    values = np.empty((draws, len(solution.names)))
    for rows in blocks(draws, 100):
        trial = draw_readings(acting, setting, solution, errors, misalignments, rows.stop - rows.start, rng,
                              sensor)
        for place, readings, added in zip(range(rows.start, rows.stop), trial.readings, trial.added,
                                          strict=True):
            values[place] = run(filled(setting.table, readings)).value + added
    return Drawn(solution.names, values)


def agreement(drawn: Drawn, sigma: np.ndarray) -> tuple[float, float]:
    """Least and greatest ratio of the drawn standard deviation to ``sigma`` (p,), where that is not zero."""
    live = sigma > 1e-9 * sigma.max()
    ratio = drawn.sigma[live] / sigma[live]
    return float(ratio.min()), float(ratio.max())
