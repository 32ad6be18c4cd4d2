"""The enhanced step diagonal method: all errors and all misalignments in one problem.

Minimises, over the unknowns θ of :mod:`stepdiag_ros.estimate.parameters`,

    ½ ‖W (y − f(θ))‖² + ½ ‖θ/s‖²

with the full kinematic model f (:mod:`stepdiag_ros.estimate.forward`), the noise W of the
log itself (:mod:`stepdiag_ros.estimate.noise`), and widths s so wide (a millimetre, a
milliradian and more) that they only decide what the data leave open.  Gauss–Newton steps
solve the normal equations by Cholesky, as a band (:mod:`stepdiag_ros.estimate.banded`): they
lose digits of a step, not of the answer, for each residual is computed from the full model.
The last step and the covariance come from the dense equations.  Steps go on until they no
longer matter against the standard deviations.

A direction that the data do not narrow down against its width is unidentifiable and is
reported by name (:mod:`stepdiag_ros.estimate.identifiability`).
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.banded import BandedNormal
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import GAUGE, slope_weights
from stepdiag_ros.estimate.noise import NoiseModel, Whitener, estimate_noise, whiteners
from stepdiag_ros.estimate.parameters import Parameters, parameters_of
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import LINEAR, Description, path_of
from stepdiag_ros.model.machine import CURVES

WIDTH_SHIFT_M = 1e-3
WIDTH_TURN_RAD = 1e-3
WIDTH_LASER_RAD = 1e-3
WIDTH_MIRROR_RAD = 1e-2
WIDTH_OFFSET_M = 10.0
WIDTH_FRAME_RAD = 1e-4
"""Turning machine and setups together is seen only to second order: it is held to this width."""
LOADING, LOADING_LIMIT = 1e-15, 1e-8
"""What is added to the unit diagonal of normal equations that rounding made indefinite: first, last."""
FRAME_SLOPES = ('EYX', 'EZX', 'EZY')
MAX_ITERATIONS = 50
SETTLED = 1e-8
"""The iteration ends where a step promises less than this fall of the objective (χ² units)."""
STALLED, STALLED_OVER = 1e-3, 6
"""… or where that many steps together made it fall by less than this: a hundredth of a σ is left …"""
SHORTEST = 2.0**-12
"""… or where no part of a step down to this fraction makes it fall: rounding is reached."""


@dataclass(frozen=True)
class Fit:
    """The solved problem, before it is put into reported form.

    ``theta`` (size,), ``covariance`` (size, size); ``jacobian`` (n·c, size) sparse at the solution;
    ``arrival`` (5, n, c) derivatives by arrival errors; ``residual`` (n, c) reading minus
    prediction, NaN where absent; ``present`` (n, c); ``whiteners`` one a run; ``precision`` (size,
    size) of the widths; ``chi2``, ``dof``; ``converged``.
    """

    parameters: Parameters
    model: ForwardModel
    theta: np.ndarray
    covariance: np.ndarray
    jacobian: sparse.csr_array
    arrival: np.ndarray
    residual: np.ndarray
    present: np.ndarray
    whiteners: list[Whitener]
    precision: np.ndarray
    noise: NoiseModel
    chi2: float
    dof: int
    iterations: int
    converged: bool


def readings_of(table: StopTable) -> np.ndarray:
    """All readings (n, beams + 2) [m], NaN where absent."""
    return np.concatenate([table.displacement, table.spot], axis=1)


def prior_precision(parameters: Parameters, linear_laser: float = WIDTH_LASER_RAD) -> np.ndarray:
    """Inverse covariance (size, size) of the widths; ``linear_laser`` [rad] in linear setups."""
    rows = frame_rows(parameters)
    return np.diag(widths(parameters, linear_laser)**-2.0) + rows.T @ rows / WIDTH_FRAME_RAD**2


def widths(parameters: Parameters, linear_laser: float = WIDTH_LASER_RAD) -> np.ndarray:
    """Width (size,) of each unknown on its own."""
    width = np.empty(parameters.size)
    for name in CURVES:
        width[parameters.slice(name)] = WIDTH_SHIFT_M if name[1] in 'XYZ' else WIDTH_TURN_RAD
    for setup in parameters.setups:
        first = parameters.setup_first[setup]
        laser = linear_laser if path_of(setup) in LINEAR else WIDTH_LASER_RAD
        width[first:first + 2], width[first + 2:first + 4] = laser, WIDTH_MIRROR_RAD
    width[parameters.offset_first:] = WIDTH_OFFSET_M
    return width


def frame_rows(parameters: Parameters) -> np.ndarray:
    """The slopes (3, size) that turn machine and setups together."""
    rows = np.zeros((len(FRAME_SLOPES), parameters.size))
    for row, name in zip(rows, FRAME_SLOPES, strict=True):
        row[parameters.slice(name)] = slope_weights(parameters.knots[name])[1:]
    return rows


def start(parameters: Parameters, model: ForwardModel, table: StopTable,
          readings: np.ndarray) -> np.ndarray:
    """First guess: an ideal machine, offsets from the first reading of each run."""
    theta = np.zeros(parameters.size)
    predicted = model.predict(theta)
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        for beam in range(parameters.beams):
            good = rows[np.isfinite(readings[rows, beam])]
            if len(good):
                column = parameters.offset_first + run * parameters.beams + beam
                theta[column] = readings[good[0], beam] - predicted[good[0], beam]
    return theta


def fit(description: Description, table: StopTable, noise: NoiseModel | None = None,
        readings: np.ndarray | None = None, theta: np.ndarray | None = None,
        parameters: Parameters | None = None, settled: float = SETTLED,
        linear_laser: float = WIDTH_LASER_RAD) -> Fit:
    """Solve for all unknowns of the stops in ``table``.

    ``noise`` is estimated from the table when not given; ``readings`` replaces the table's own
    (n, beams + 2); ``theta`` starts the iteration, ``settled`` [χ²] ends it.  ``linear_laser`` [rad]: how
    well the beams of the linear setups are known to lie along their axes (their cosine error).
    """
    parameters = parameters or parameters_of(description, table)
    model = ForwardModel(description, table, parameters)
    readings = readings_of(table) if readings is None else readings
    present = np.isfinite(readings)
    flat = present.ravel()
    if not flat.any():
        raise StepdiagError('no readings at all; nothing to solve')
    if theta is None:
        theta = start(parameters, model, table, readings)
    precision = prior_precision(parameters, linear_laser)
    predicted, jacobian, arrival = model.jacobian(theta)
    if noise is None:
        noise = estimate_noise(table, description.noise, arrival)
    white = whiteners(table, noise, arrival, present)

    def objective(theta: np.ndarray, predicted: np.ndarray) -> float:
        residual = np.where(present, readings - predicted, 0.0).ravel()
        return sum(np.sum(w(residual)**2) for w in white) + theta @ precision @ theta

    banded: BandedNormal | None = BandedNormal(
        table, noise, arrival, present, widths(parameters, linear_laser), frame_rows(parameters),
        WIDTH_FRAME_RAD, min(parameters.setup_first.values()))
    value = objective(theta, predicted)
    converged, iterations, course = False, 0, [value]
    while iterations < MAX_ITERATIONS:
        iterations += 1
        residual = np.where(present, readings - predicted, 0.0).ravel()
        pull = precision @ theta
        right = jacobian.T @ weighted(residual, white) - pull
        if banded is not None:
            try:
                step = banded.solve(jacobian, residual, pull)
            except linalg.LinAlgError:
                banded = None
        if banded is None:
            normal = normal_equations(jacobian, white)
            factor, scale = factored(normal + precision)
            step = solved(factor, scale, right)
        promised = float(step @ right)
        # Misalignments act to second order along flat valleys: a whole step may overshoot.
        part = 1.0
        while part >= SHORTEST:
            trial = theta + part * step
            trial_predicted = model.predict(trial)
            trial_value = objective(trial, trial_predicted)
            if trial_value <= value:
                theta, value, predicted = trial, trial_value, trial_predicted
                break
            part /= 2.0
        course.append(value)
        unit = max(1.0, 1e-6 * value)
        stalled = len(course) > STALLED_OVER and course[-1 - STALLED_OVER] - value < STALLED * unit
        if promised < settled * unit or part < SHORTEST or stalled:
            if banded is None:
                converged = True
                break
            # The band loses more digits on nearly noise-free data: the dense equations have the last word.
            banded = None
        predicted, jacobian, arrival = model.jacobian(theta)
    predicted, jacobian, arrival = model.jacobian(theta)
    residual = readings - predicted
    if not converged:
        normal = normal_equations(jacobian, white)
        factor, scale = factored(normal + precision)
    covariance = _inverse(factor, scale)
    filled = np.where(present, residual, 0.0).ravel()
    chi2 = float(sum(np.sum(w(filled)**2) for w in white))
    # Each direction counts as fitted by the share in which data and not the width decide it.
    dof = int(round(flat.sum() - np.sum(covariance * normal)))
    return Fit(parameters, model, theta, covariance, jacobian, arrival, residual, present, white,
               precision, noise, chi2, dof, iterations, converged)


def weighted(residual: np.ndarray, white: list[Whitener]) -> np.ndarray:
    """``WᵀW r`` (n·c,)."""
    out = np.zeros_like(residual)
    for whitener in white:
        out[whitener.rows] = linalg.cho_solve((whitener.factor, True), residual[whitener.rows],
                                              check_finite=False)
    return out


def normal_equations(jacobian: sparse.csr_array, white: list[Whitener]) -> np.ndarray:
    """``JᵀWᵀWJ`` (size, size), one run after the other, only on the columns a run meets."""
    size = jacobian.shape[1]
    normal = np.zeros((size, size))
    for whitener in white:
        block = jacobian[whitener.rows]
        columns = np.unique(block.indices)
        dense = np.asfortranarray(block[:, columns].toarray())
        part = linalg.solve_triangular(whitener.factor, dense, lower=True, overwrite_b=True,
                                       check_finite=False)
        normal[np.ix_(columns, columns)] += part.T @ part
    return normal


def factored(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cholesky factor of the matrix scaled to a unit diagonal (units differ by many decades)."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * scale[:, None] * scale
    loading = 0.0
    while True:
        try:
            return linalg.cholesky(scaled, lower=True, check_finite=False), scale
        except linalg.LinAlgError:
            # Nearly noise-free data narrow some directions 1e16 times more than others are left
            # open: rounding may hide the open ones' width.  The steps only get shorter by this.
            if loading > LOADING_LIMIT:
                raise StepdiagError('the normal equations cannot be solved; check the cell '
                                    'description against the readings') from None
            loading = 16.0 * loading or LOADING
            scaled[np.diag_indices(len(scaled))] = 1.0 + loading


def solved(factor: np.ndarray, scale: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Unknowns (size,) of the equations that :func:`factored` took, for a right side (size,)."""
    return scale * linalg.cho_solve((factor, True), scale * right, check_finite=False)


def _inverse(factor: np.ndarray, scale: np.ndarray) -> np.ndarray:
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    return inverse * scale[:, None] * scale


__all__ = ['GAUGE', 'Fit', 'factored', 'fit', 'normal_equations', 'prior_precision', 'readings_of', 'solved',
           'weighted']
