"""The largest deviation in a volume with its expanded uncertainty.

Of many places one is the largest because the errors are large there or because the estimate is off there, so that the
largest of all scatters otherwise than the deviation at one place: of a machine whose errors are all taken off, what is
left is nowhere zero.  The errors are drawn from the solution's covariance and the largest deviation of each draw is
taken (GUM Supplement 1); U covers 95 % of them around the stated value.
"""

import numpy as np

from stepdiag_ros.compensate.approach import NONE, Reversal, half_drawn, sizes
from stepdiag_ros.estimate.prediction import Prediction, largest_deviation, predict, sensitivities
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine

MOST_KNOTS = 21
"""Positions an axis at most at which places are looked at."""
DRAWS, SEED, COVERED = 400, 20, 0.95
BLOCK = 128
"""Points whose draws are formed together: 128 × 39 × 400 numbers, 16 MB."""


def largest(solution: Solution, machine: Machine, tool: np.ndarray, field: Prediction,
            reversal: Reversal = NONE) -> tuple[float, float, np.ndarray]:
    """Largest deviation of ``field``, its U (95 %) and its place, all [m].

    ``field`` has the covariance of ``solution`` for ``tool`` (3,) [m]; ``reversal``: lost motion that the errors of
    ``solution`` do not hold, counted from the worst side.
    """
    columns, weights = sensitivities(solution, machine, field.points, np.asarray(tool, float))
    values, vectors = np.linalg.eigh(solution.covariance)
    random = np.random.default_rng(SEED)
    normals = random.standard_normal((len(values), DRAWS))
    beside = half_drawn(reversal, random.standard_normal((3, DRAWS)))
    # The symmetric root: a covariance that hardly changes gives draws that hardly change, and so does U.
    drawn = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * (vectors.T @ normals))
    found = np.zeros(DRAWS)
    for start in range(0, len(field.points), BLOCK):
        rows = slice(start, start + BLOCK)
        moved = field.deviation_m[rows, :, None] + weights[rows] @ drawn[columns[rows]]
        found = np.maximum(found, np.linalg.norm(np.abs(moved) + beside, axis=1).max(axis=0))
    stated = sizes(field.deviation_m, reversal)
    row = int(np.argmax(stated))
    size = float(stated[row])
    return size, float(np.quantile(np.abs(found - size), COVERED)), field.points[row]


def largest_of_all(solution: Solution, machine: Machine) -> tuple[float, float, np.ndarray]:
    """The same over all knots and corners of the volume, for the machine's own tool."""
    _, _, place = largest_deviation(solution, machine)
    axes = []
    for axis, letter in enumerate('XYZ'):
        knots = [np.asarray(at) for name, at in solution.positions.items() if name[2] == letter]
        own = np.unique(np.clip(np.concatenate([[0.0, machine.volume[axis]], *knots]), 0.0, machine.volume[axis]))
        axes.append(own if len(own) <= MOST_KNOTS else np.linspace(own[0], own[-1], MOST_KNOTS))
    points = np.stack(np.meshgrid(*axes, indexing='ij'), -1).reshape(-1, 3)
    field = predict(solution, machine, np.concatenate([points, place[None]]))
    return largest(solution, machine, np.asarray(machine.tool), field)
