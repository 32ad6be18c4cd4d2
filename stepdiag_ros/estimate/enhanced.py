"""The enhanced step diagonal method: all errors and all misalignments in one problem.

Minimises, over the unknowns θ of :mod:`stepdiag_ros.estimate.parameters`,

    ½ ‖W (y − f(θ))‖² + ½ ‖θ/s‖²

with the full kinematic model f (:mod:`stepdiag_ros.estimate.forward`), the noise W of the
log itself (:mod:`stepdiag_ros.estimate.noise`), and prior standard deviations s so wide (a millimetre, a
milliradian and more) that they only decide what the data leave open.  Gauss–Newton steps
solve the normal equations by Cholesky, as a band (:mod:`stepdiag_ros.estimate.banded`) where that is cheaper than
one dense matrix, as for many steps but not for many repeats: they
lose digits of a step, not of the answer, for each residual is computed from the full model.
The last step and the covariance come from the dense equations.  Steps go on until they no
longer matter against the standard deviations.

Turns of beams and mirror act to second order along flat valleys, where a whole step overshoots a hundredfold and
its parts go astray.  There the priors are narrowed, (1 + λ)P, until what a step brings is what it promises
(Levenberg and Marquardt with the priors as their scale, λ as of Moré 1978); elsewhere λ is 0.

A direction that the data do not narrow down against its prior is unidentifiable and is
reported by name (:mod:`stepdiag_ros.estimate.identifiability`).
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.banded import BandedNormal
from stepdiag_ros.estimate.dense import dense_operations, factored, inverse, normal_equations, solved, weighted
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import slope_weights
from stepdiag_ros.estimate.level import PRIOR_STATION_M
from stepdiag_ros.estimate.noise import NoiseModel, Whitener, estimate_noise, whiteners
from stepdiag_ros.estimate.parameters import STATION, Parameters, parameters_of
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import CURVES

PRIOR_SHIFT_M = 1e-3
PRIOR_TURN_RAD = 1e-3
PRIOR_LASER_RAD = 1e-3
PRIOR_MIRROR_RAD = 1e-2
PRIOR_OFFSET_M = 10.0
BESIDE_M = 1e-3
PRIOR_FRAME_RAD = 1e-4
"""Turning machine and setups together is seen only to second order: it is held to this prior."""
LEVEL_ROUNDS, LEVEL_M = 4, 1e-13
"""Most fits beyond the first in which level stations take from the fit before what the machine is off across their
planes, and by how much [m] readings must differ by it for another."""
FRAME_SLOPES = ('EYX', 'EZX', 'EZY')
HELD = 1e-3
"""Share of its prior that a combination of unknowns which is held may move by."""
MAX_ITERATIONS = 100
SETTLED = 1e-8
"""The iteration ends where a step promises less than this fall of the objective (χ² units)."""
SHARE = 1e-6
"""… times this share of the objective, where that is more than one …"""
STALLED, STALLED_OVER = 1e-3, 6
"""… or where that many steps together made it fall by less than this: a hundredth of a σ is left …"""
MOST_DAMPING = 1e12
"""… or where no step narrowed down to this makes it fall: rounding is reached."""
GOOD, POOR = 0.75, 0.25
"""Share of the promised fall above which priors are widened again, and below which they are narrowed …"""
BLOCKED = 2.0
"""How many times as many operations a second the dense equations do as the band, whose columns come one by one."""
NARROWER, WIDER = 4.0, 5.0
"""… by these factors."""


@dataclass(frozen=True)
class Fit:
    """The solved problem, before it is put into reported form.

    ``theta`` (size,), ``covariance`` (size, size); ``jacobian`` (n·c, size) sparse at the solution;
    ``arrival`` (5, n, c) derivatives by arrival errors; ``residual`` (n, c) reading minus
    prediction, NaN where absent; ``present`` (n, c); ``whiteners`` one a run; ``precision`` (size,
    size) of the priors; ``chi2``, ``dof``; ``converged``.
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

    @property
    def louder(self) -> float:
        """By how much the residuals' variance is larger than the noise says, at least 1: whatever it is, repeats alone
        do not show how uncertain the errors are."""
        return max(self.chi2 / max(self.dof, 1), 1.0)


def readings_of(table: StopTable) -> np.ndarray:
    """All readings (n, beams + 2) [m], NaN where absent."""
    return np.concatenate([table.displacement, table.spot], axis=1)


def prior_precision(parameters: Parameters, linear_laser: float = PRIOR_LASER_RAD) -> np.ndarray:
    """Inverse covariance (size, size) of the priors; ``linear_laser`` [rad] in straight setups."""
    rows = frame_rows(parameters)
    return np.diag(prior_sigmas(parameters, linear_laser)**-2.0) + rows.T @ rows / PRIOR_FRAME_RAD**2


def prior_sigmas(parameters: Parameters, linear_laser: float = PRIOR_LASER_RAD) -> np.ndarray:
    """Prior standard deviation (size,) of each unknown on its own."""
    sigma = np.empty(parameters.size)
    for name in CURVES:
        sigma[parameters.slice(name)] = PRIOR_SHIFT_M if name[1] in 'XYZ' else PRIOR_TURN_RAD
    for setup in parameters.setups:
        first = parameters.setup_first[setup]
        if parameters.unknowns[setup] == STATION:
            sigma[first:first + len(STATION)] = PRIOR_STATION_M
            continue
        laser = linear_laser if setup in parameters.straight else PRIOR_LASER_RAD
        sigma[first:first + 2], sigma[first + 2:first + 4] = laser, PRIOR_MIRROR_RAD
    sigma[parameters.offset_first:] = PRIOR_OFFSET_M
    return sigma


def frame_rows(parameters: Parameters) -> np.ndarray:
    """The slopes (3, size) that turn machine and setups together."""
    rows = np.zeros((len(FRAME_SLOPES), parameters.size))
    for row, name in zip(rows, FRAME_SLOPES, strict=True):
        row[parameters.slice(name)] = slope_weights(parameters.knots[name])[1:]
    return rows


def start(parameters: Parameters, model: ForwardModel, table: StopTable,
          readings: np.ndarray) -> np.ndarray:
    """First guess: an ideal machine, offsets from the first reading of each run, stations a little beside their places.

    On a line that holds the station no reading depends to first order on how far it is off: no step would find it.
    """
    theta = np.zeros(parameters.size)
    for setup in parameters.setups:
        if parameters.unknowns[setup] == STATION:
            first = parameters.setup_first[setup]
            theta[first:first + len(STATION)] = BESIDE_M
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
        parameters: Parameters | None = None, settled: float = SETTLED, share: float = SHARE,
        linear_laser: float = PRIOR_LASER_RAD, centre: np.ndarray | None = None,
        held: np.ndarray | None = None) -> Fit:
    """Solve for all unknowns of the stops in ``table``.

    ``noise`` is estimated from the table when not given; ``readings`` replaces the table's own
    (n, beams + 2); ``theta`` starts the iteration, ``settled`` [χ²] ends it, in units of
    a ``share`` of χ² where that is more than one.  ``linear_laser`` [rad]: how
    well the beams of the linear setups are known to lie along their axes (their cosine error).  ``centre``
    (size,): what the priors hold to, an ideal machine when not given.  ``held`` (k, size): combinations of unknowns,
    in units of their priors, that stay at the centre while the others are sought; the covariance knows nothing of it.
    """
    parameters = parameters or parameters_of(description, table)
    readings = readings_of(table) if readings is None else readings
    solve = partial(_fit, description, table, noise, readings, settled, share, linear_laser,
                    np.zeros(parameters.size) if centre is None else centre, held)
    model = ForwardModel(description, table, parameters, np.zeros(parameters.size) if theta is None else theta)
    result = solve(model, theta)
    for _ in range(LEVEL_ROUNDS if model.has_level_stations else 0):
        before, model = model, ForwardModel(description, table, parameters, result.theta)
        if np.abs(model.predict(result.theta) - before.predict(result.theta)).max() < LEVEL_M:
            break
        result = solve(model, result.theta)
    return result


def _fit(description: Description, table: StopTable, noise: NoiseModel | None, readings: np.ndarray, settled: float,
         share: float, linear_laser: float, centre: np.ndarray, held: np.ndarray | None, model: ForwardModel,
         theta: np.ndarray | None) -> Fit:
    """As :func:`fit`, with what ``model`` believes the machine to be off across the planes of level stations."""
    parameters = model.parameters
    present = np.isfinite(readings)
    flat = present.ravel()
    if not flat.any():
        raise StepdiagError('no readings at all; nothing to solve')
    if theta is None:
        theta = start(parameters, model, table, readings)
    precision = prior = prior_precision(parameters, linear_laser)
    if held is not None:
        precision = prior + held.T @ held / HELD**2
    predicted, jacobian, arrival = model.jacobian(theta)
    if noise is None:
        noise = estimate_noise(table, description.noise, arrival)
    white = whiteners(table, noise, arrival, present)

    def objective(theta: np.ndarray, predicted: np.ndarray) -> float:
        residual = np.where(present, readings - predicted, 0.0).ravel()
        return sum(np.sum(w(residual)**2) for w in white) + (theta - centre) @ precision @ (theta - centre)

    banded = BandedNormal(table, noise, arrival, present, prior_sigmas(parameters, linear_laser),
                          frame_rows(parameters), PRIOR_FRAME_RAD, min(parameters.setup_first.values()))
    steps = _Steps(banded, white, precision)
    if held is not None or dense_operations(jacobian, white) < BLOCKED * banded.operations:
        steps.without_band()
    value = objective(theta, predicted)
    converged, iterations, values, damping = False, 0, [value], 0.0
    while iterations < MAX_ITERATIONS:
        iterations += 1
        steps.at(jacobian, np.where(present, readings - predicted, 0.0).ravel(), precision @ (theta - centre))
        unit = max(1.0, share * value)
        while True:
            step, promised = steps.step(damping)
            trial = theta + step
            trial_predicted = model.predict(trial)
            trial_value = objective(trial, trial_predicted)
            fell = value - trial_value
            if fell >= 0.0 or promised < settled * unit or damping > MOST_DAMPING:
                break
            damping = max(1.0, NARROWER * damping)
        whole, moved = damping == 0.0, fell >= 0.0
        if moved:
            theta, value, predicted = trial, trial_value, trial_predicted
        if fell > GOOD * promised:
            damping = damping / WIDER if damping > 1.0 else 0.0
        elif fell < POOR * promised:
            damping = max(1.0, NARROWER * damping)
        values.append(value)
        stalled = len(values) > STALLED_OVER and values[-1 - STALLED_OVER] - value < max(STALLED, settled) * unit
        if (whole and promised < settled * unit) or not moved or stalled:
            if steps.dense:
                converged = True
                break
            # The band loses more digits on nearly noise-free data: the dense equations have the last word.
            steps.without_band()
            damping = damping if stalled else 0.0
        predicted, jacobian, arrival = model.jacobian(theta)
    predicted, jacobian, arrival = model.jacobian(theta)
    residual = readings - predicted
    normal, covariance = steps.solution(jacobian, converged and whole)
    if held is not None:
        covariance = inverse(*factored(normal + prior))
    filled = np.where(present, residual, 0.0).ravel()
    chi2 = float(sum(np.sum(w(filled)**2) for w in white))
    # Each direction counts as fitted by the share in which data and not the prior decide it.
    dof = int(round(flat.sum() - np.sum(covariance * normal)))
    return Fit(parameters, model, theta, covariance, jacobian, arrival, residual, present, white,
               prior, noise, chi2, dof, iterations, converged)


class _Steps:
    """Steps of one fit: by the band until it has served or rounding breaks it, then by the dense equations."""

    def __init__(self, banded: BandedNormal, white: list[Whitener], precision: np.ndarray):
        self._banded: BandedNormal | None = banded
        self._white, self._precision = white, precision
        self._normal, self._factored = None, None

    @property
    def dense(self) -> bool:
        return self._banded is None

    def without_band(self) -> None:
        self._banded = None

    def at(self, jacobian: sparse.csr_array, residual: np.ndarray, pull: np.ndarray) -> None:
        """Where the next steps start; ``residual`` (n·c,) with zeros where absent, ``pull`` (size,) of the priors."""
        self._place = jacobian, residual, pull
        self._right = jacobian.T @ weighted(residual, self._white) - pull
        self._normal = normal_equations(jacobian, self._white) if self.dense else None

    def step(self, damping: float) -> tuple[np.ndarray, float]:
        """Step (size,) with priors narrowed by ``damping``, and the fall of the objective that it promises."""
        if self._banded is not None:
            try:
                step = self._banded.solve(*self._place, damping)
            except linalg.LinAlgError:
                self.without_band()
                self._normal = normal_equations(self._place[0], self._white)
        if self.dense:
            self._factored = factored(self._normal + (1.0 + damping) * self._precision)
            step = solved(*self._factored, self._right)
        # Of the objective, whose priors are not narrowed.
        return step, float(step @ self._right + damping * (step @ self._precision @ step))

    def solution(self, jacobian: sparse.csr_array, solved_last: bool) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of the data and covariance, two (size, size): those that the last step solved, dense and
        with plain priors, or new ones at ``jacobian``."""
        if not solved_last:
            self._normal = normal_equations(jacobian, self._white)
            self._factored = factored(self._normal + self._precision)
        return self._normal, inverse(*self._factored)
