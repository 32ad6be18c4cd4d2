"""What axes that stand from one run to the next add to the uncertainty.

An axis keeps the error of its arrival until it moves again.  A run backwards begins where the run forwards
ended, and the next repeat where that one ended: the two runs share the arrival errors of that place.  The
fit weighs runs as independent, which costs it next to nothing; its covariance, however, counts one
arrival as two.  Of two repeats forwards and backwards the start is seen four times with three arrivals, and
every straightness is counted from there.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.dense import block_of
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
    parameters = result.parameters
    _, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    # The unknowns follow the readings by (JᵀWJ + P)⁻¹ JᵀW.
    follow, together, alone = reporting @ result.covariance, [], []
    for axis in range(3):
        effect = np.where(result.present, np.reshape(result.arrival[2 + axis], result.present.shape), 0.0).ravel()
        moved: dict[int, list[np.ndarray]] = {}
        for white in result.whiteners:
            own = numbers[white.rows // channels, axis]
            shared = np.unique(own)
            columns, jacobian = block_of(result.jacobian, white.rows)
            weight = white.weighted((own[:, None] == shared) * effect[white.rows, None])
            for number, change in zip(shared, (follow[:, columns] @ (jacobian.T @ weight)).T, strict=True):
                moved.setdefault(number, []).append(change)
        of_several = [parts for parts in moved.values() if len(parts) > 1]
        together += [sum(parts) for parts in of_several]
        alone += [part for parts in of_several for part in parts]
    if not together:
        return solution
    one, each = np.array(together), np.array(alone)
    more = result.noise.position**2 * (one.T @ one - each.T @ each)
    return replace(solution, covariance=solution.covariance + more)
