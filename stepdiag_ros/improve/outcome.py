"""What the calibration after a change says of it: as predicted, and no stop worse.

Fields are held against their prediction by the largest difference anywhere in the volume.  What noise alone
makes of that maximum follows from drawing both calibrations' errors from their covariances; it is not k σ of
one place, for the largest of many places is looked at (GUM Supplement 1).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from stepdiag_ros.compensate.applied import remaining
from stepdiag_ros.compensate.approach import NONE, Reversal, standing_out
from stepdiag_ros.compensate.largest import largest
from stepdiag_ros.compensate.taken import Taken
from stepdiag_ros.estimate.prediction import Prediction, predict, sensitivities
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.improve.levels import Change
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import setup_direction, stops

DRAWS = 400
PROBABILITY = 0.95
SEED = 1


@dataclass(frozen=True)
class Stops:
    """Length errors (n,) [m] of each stop of each setup along its line of sight, before and after.

    ``name`` (n,) ``setup/index``; ``spread_m`` (n,) U of after less before, for all stops together (95 %).
    """

    name: tuple[str, ...]
    before_m: np.ndarray
    after_m: np.ndarray
    spread_m: np.ndarray

    @property
    def worse(self) -> np.ndarray:
        """By how much each stop is worse beyond U (n,) [m]; negative or zero: it is not."""
        return np.abs(self.after_m) - np.abs(self.before_m) - self.spread_m


@dataclass(frozen=True)
class Outcome:
    """Before, predicted and after at the same places; ``off_m`` the largest difference of after from predicted
    anywhere, ``off_bound_m`` what noise alone stays below in 95 % of all cases; the stops; ``largest``: of each of the
    three fields the largest deviation, its U (95 %) and its place, all [m]."""

    before: Prediction
    predicted: Prediction
    after: Prediction
    off_m: float
    off_bound_m: float
    stops: Stops
    largest: Mapping[str, tuple[float, float, np.ndarray]]

    @property
    def as_predicted(self) -> bool:
        """Whether what was reached agrees with the prediction."""
        return self.off_m <= self.off_bound_m

    @property
    def better(self) -> bool:
        """Whether the largest deviation has fallen beyond what noise does, and no stop is worse beyond U."""
        fallen = self.largest['before'][0] - self.largest['after'][0]
        return fallen > self.off_bound_m and not np.any(self.stops.worse > 0.0)

    @property
    def factor(self) -> float:
        """By what the largest deviation has fallen."""
        return self.largest['before'][0] / max(self.largest['after'][0], 1e-12)

    def to_json_dict(self) -> dict:
        fields = {when: {'largest_m': size, 'U_m': spread, 'coverage': 0.95, 'at_m': at.tolist()}
                  for when, (size, spread, at) in self.largest.items()}
        return {**fields, 'factor': self.factor, 'as_predicted': self.as_predicted, 'better': self.better,
                'off_prediction_m': self.off_m, 'off_prediction_bound_m': self.off_bound_m,
                'stops': {'names': list(self.stops.name), 'before_m': self.stops.before_m.tolist(),
                          'after_m': self.stops.after_m.tolist(), 'U_m': self.stops.spread_m.tolist(),
                          'worse': int(np.sum(self.stops.worse > 0.0))}}


def outcome(change: Change, first: Solution, first_applied: Taken, second: Solution, log: CalibrationLog,
            reversal: Reversal = NONE) -> Outcome:
    """The second calibration against the change's prediction; both solutions are of the machine without the
    volumetric compensation that was in force (``first_applied``, ``change.applied``).  ``reversal``: lost motion that
    the second shows."""
    machine, made = log.description.machine, change.made
    points, predicted = made.before.points, made.as_measured
    first, second = remaining(first, first_applied), remaining(second, change.applied)
    after = predict(second, machine, points)
    off = np.linalg.norm(after.deviation_m - predicted.deviation_m, axis=1)
    figures = {'before': made.worst_before, 'predicted': made.worst(predicted),
               'after': largest(second, machine, made.point.tool, after, standing_out(reversal))}
    return Outcome(made.before, predicted, after, float(off.max()), _largest_of_noise((first, second), machine, points),
                   _stops(first, second, log), figures)


def _largest_of_noise(solutions: tuple[Solution, ...], machine: Machine, points: np.ndarray) -> float:
    """95 % quantile [m] of the largest sum of the solutions' errors anywhere in ``points``."""
    rng = np.random.default_rng(SEED)
    total = np.zeros((DRAWS, len(points), 3))
    for solution in solutions:
        values, vectors = np.linalg.eigh(solution.covariance)
        drawn = rng.standard_normal((DRAWS, len(values))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        columns, weights = sensitivities(solution, machine, points, np.asarray(machine.tool))
        for k in range(columns.shape[1]):
            total += drawn[:, columns[:, k], None] * weights[None, :, :, k]
    return float(np.quantile(np.linalg.norm(total, axis=2).max(axis=1), PROBABILITY))


def _stops(first: Solution, second: Solution, log: CalibrationLog) -> Stops:
    machine = log.description.machine
    names, before, after, variance = [], [], [], []
    for setup in log.description.setups:
        path = stops(log.description, setup)
        along = setup_direction(machine, log.description.setups[setup])
        sides = [_lengths(solution, machine, path.positions, along, setup) for solution in (first, second)]
        if any(side is None for side in sides):
            continue
        (one, one_variance), (two, two_variance) = sides
        names += [f'{setup}/{i}' for i in range(1, len(one))]
        before += list(one[1:])
        after += list(two[1:])
        variance += list((one_variance + two_variance)[1:])
    count = max(1, len(names))
    k = norm.ppf(1.0 - (1.0 - PROBABILITY) / count)
    return Stops(tuple(names), np.array(before), np.array(after), k * np.sqrt(np.array(variance)))


def _lengths(solution: Solution, machine: Machine, positions: np.ndarray, along: np.ndarray, setup: str
             ) -> tuple[np.ndarray, np.ndarray] | None:
    """Length error (n,) [m] at each stop against the first, and its variance; None where the setup was not measured.

    The fitted machine along the beam and the mean of what the fit leaves there: the reading less what laser and
    mirror misalignments make of it.
    """
    if solution.residuals is None or setup not in set(solution.residuals.setup):
        return None
    field = predict(solution, machine, positions)
    error = field.deviation_m @ along
    variance = np.einsum('i,nij,j->n', along, field.covariance_m2, along)
    mine = solution.residuals.setup == setup
    left, visits = np.zeros(len(positions)), np.zeros(len(positions))
    residual = np.nan_to_num(solution.residuals.displacement_m[mine, 0])
    index = solution.residuals.index[mine].astype(int)
    np.add.at(left, index, residual)
    np.add.at(visits, index, 1.0)
    visits = np.maximum(visits, 1.0)
    error = error + left / visits
    scatter = float(solution.noise.get('position_repeatability_m') or 0.0)
    return error - error[0], variance + 2.0 * scatter**2 / visits
