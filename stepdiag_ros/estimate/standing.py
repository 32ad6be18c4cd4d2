"""What axes that stand from one run to the next add to the uncertainty.

An axis keeps the error of its arrival until it moves again.  A run backwards begins where the run forwards
ended, and the next repeat where that one ended: the two runs share the arrival errors of that place.  The
fit weighs runs as independent, which costs it next to nothing; its covariance, however, counts one
arrival as two.  Of two repeats forwards and backwards the start is seen four times with three arrivals, and
every straightness is counted from there.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.dense import weighted
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.noise import arrivals
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.solution import Solution

SAME_M = 1e-9
"""An axis stands if it is commanded to the same place within this."""


def standing_arrivals(table: StopTable) -> np.ndarray:
    """Number of the arrival that each axis still rests on at each stop (n, 3), across runs."""
    numbers = arrivals(table)
    order = sorted((np.flatnonzero(table.run == run) for run in np.unique(table.run)),
                   key=lambda rows: table.time_s[rows[0]])
    for before, after in zip(order[:-1], order[1:], strict=True):
        for axis in range(3):
            if abs(table.commanded[after[0], axis] - table.commanded[before[-1], axis]) < SAME_M:
                same = after[numbers[after, axis] == numbers[after[0], axis]]
                numbers[same, axis] = numbers[before[-1], axis]
    return numbers


def with_standing(solution: Solution, result: Fit, table: StopTable) -> Solution:
    """The solution with what arrivals shared by several runs add to its covariance."""
    numbers, channels = standing_arrivals(table), result.present.shape[1]
    shape, total = (len(table), channels), np.zeros_like(result.covariance)
    present = result.present
    for axis in range(3):
        effect = np.where(present, np.reshape(result.arrival[2 + axis], shape), 0.0)
        for number in np.unique(numbers[:, axis]):
            rows = np.flatnonzero(numbers[:, axis] == number)
            runs = np.unique(table.run[rows])
            if len(runs) < 2:
                continue
            # The unknowns follow the readings by (JᵀWJ + P)⁻¹ JᵀW.
            readings = np.zeros((len(runs), *shape))
            for k, run in enumerate(runs):
                mine = rows[table.run[rows] == run]
                readings[k, mine] = effect[mine]
            weight = np.stack([weighted(r.ravel(), result.whiteners) for r in readings], axis=1)
            moved = result.covariance @ (result.jacobian.T @ weight)
            whole = moved.sum(axis=1)
            total += np.outer(whole, whole) - moved @ moved.T
    parameters = result.parameters
    _, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    more = result.noise.position**2 * reporting @ total @ reporting.T
    return replace(solution, covariance=solution.covariance + more)
