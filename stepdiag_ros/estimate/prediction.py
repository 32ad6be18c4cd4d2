"""What a solution says of any point of the volume: deviation, covariance, and the command that cancels it.

The deviation is the full kinematic chain with the estimated errors, minus where the tool should be.
Its covariance is first order: at a point, an axis's translation enters with the unit matrix and its
rotation ``ω`` as ``ω × lever``, the lever being what the axis carries there (with its own travel, where
it carries the workpiece); each error motion is a curve between two knots.  So at most 39 parameters
act on a point, and only their 39 × 39 part of the solution's covariance is touched: a thousand
points cost milliseconds where the full product would cost seconds.

Two machines that differ by a rigid turn of the frame against the setups look the same to the
method; a predicted field is to be compared with another one after :func:`without_rigid_motion`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import (
    AXES,
    CURVES,
    SQUARENESS,
    SQUARENESS_SHIFT,
    GeometricErrors,
    chain_from_tool,
    tool_pose,
)

BLOCK = 512
"""Points whose 39 × 39 covariances are gathered together: some 6 MB."""
COMMAND_STEPS = 20
COMMAND_TOLERANCE_M = 1e-15


@dataclass(frozen=True)
class Prediction:
    """Deviations at ``points`` (n, 3) [m]: ``deviation_m`` (n, 3), ``covariance_m2`` (n, 3, 3), machine frame."""

    points: np.ndarray
    deviation_m: np.ndarray
    covariance_m2: np.ndarray

    @property
    def sigma_m(self) -> np.ndarray:
        """One standard deviation along x, y, z (n, 3) [m]."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance_m2, axis1=1, axis2=2), 0.0))

    @property
    def size_m(self) -> np.ndarray:
        """Length of the deviation (n,) [m]."""
        return np.linalg.norm(self.deviation_m, axis=1)

    @property
    def size_sigma_m(self) -> np.ndarray:
        """One standard deviation (n,) [m] of the length; where the length vanishes, of the worst direction."""
        size = self.size_m
        unit = self.deviation_m / np.where(size > 0.0, size, 1.0)[:, None]
        along = np.einsum('ni,nij,nj->n', unit, self.covariance_m2, unit)
        worst = np.linalg.eigvalsh(self.covariance_m2)[:, -1]
        return np.sqrt(np.maximum(np.where(size > 0.0, along, worst), 0.0))


def deviation(errors: GeometricErrors, machine: Machine, points: np.ndarray,
              tool: np.ndarray | None = None) -> np.ndarray:
    """Where the tool is minus where it should be, (n, 3) [m], at commanded ``points`` (n, 3) [m].

    ``tool`` (3,) [m] replaces the machine's own tool vector.
    """
    points = np.atleast_2d(np.asarray(points, float))
    tool = np.asarray(machine.tool if tool is None else tool, float)
    actual, _ = tool_pose(errors, points, tool, machine.chain)
    return actual - (points + tool)


def predict(solution: Solution, machine: Machine, points: np.ndarray,
            tool: np.ndarray | None = None) -> Prediction:
    """Deviation with covariance at commanded ``points`` (n, 3) [m], for the machine's tool or another one."""
    points = np.atleast_2d(np.asarray(points, float))
    tool = np.asarray(machine.tool if tool is None else tool, float)
    columns, weights = sensitivities(solution, machine, points, tool)
    covariance = np.empty((len(points), 3, 3))
    for start in range(0, len(points), BLOCK):
        rows = slice(start, start + BLOCK)
        near = solution.covariance[columns[rows, :, None], columns[rows, None, :]]
        covariance[rows] = weights[rows] @ near @ np.swapaxes(weights[rows], 1, 2)
    return Prediction(points, deviation(solution.errors, machine, points, tool), covariance)


def levers(machine: Machine, points: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """What each axis's rotation turns: (3 axes, n, 3) [m]."""
    carried = np.broadcast_to(np.asarray(tool, float), points.shape)
    out = np.empty((3, *points.shape))
    for axis, carries_workpiece in chain_from_tool(machine.chain):
        beyond = carried.copy()
        beyond[:, axis] += points[:, axis]
        out[axis] = beyond if carries_workpiece else carried
        carried = beyond
    return out


def sensitivities(solution: Solution, machine: Machine, points: np.ndarray,
                  tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which parameters act at each point, and how: columns (n, k) and weights (n, 3, k) [m per unit]."""
    row = {name: i for i, name in enumerate(solution.names)}
    arms = levers(machine, points, tool)
    columns, weights = [], []
    for name in CURVES:
        if not solution.has(name):
            continue
        axis, motion = AXES.index(name[2]), 'XYZABC'.index(name[1])
        unit = np.broadcast_to(np.eye(3)[motion % 3], points.shape)
        effect = unit if motion < 3 else np.cross(unit, arms[axis])
        knots, share = _between(np.asarray(solution.positions[name]), points[:, axis])
        first = row[name, 0]
        for side, part in ((0, 1.0 - share), (1, share)):
            columns.append(first + np.minimum(knots + side, len(solution.positions[name]) - 1))
            weights.append(effect * part[:, None])
    for name in SQUARENESS:
        if solution.has(name):
            axis, per_metre = SQUARENESS_SHIFT[name]
            columns.append(np.full(len(points), row[name, -1]))
            weights.append(points[:, axis, None] * per_metre)
    if not columns:
        return np.zeros((len(points), 0), np.intp), np.zeros((len(points), 3, 0))
    return np.stack(columns, 1), np.stack(weights, 2)


def _between(knots: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the knot before each position and the share of the next one; constant outside."""
    if len(knots) < 2:
        return np.zeros(len(position), np.intp), np.zeros(len(position))
    before = np.clip(np.searchsorted(knots, position, side='right') - 1, 0, len(knots) - 2)
    share = (position - knots[before]) / (knots[before + 1] - knots[before])
    return before, np.clip(share, 0.0, 1.0)


@dataclass(frozen=True)
class VolumetricMap:
    """A grid over the working volume: ``axes`` three (k,) [m]; ``prediction`` in C order of the grid."""

    axes: tuple[np.ndarray, np.ndarray, np.ndarray]
    prediction: Prediction

    @property
    def shape(self) -> tuple[int, int, int]:
        x, y, z = (len(axis) for axis in self.axes)
        return x, y, z

    @property
    def worst(self) -> int:
        """Row of the point with the longest deviation."""
        return int(np.argmax(self.prediction.size_m))

    @property
    def ranges_m(self) -> np.ndarray:
        """Largest minus smallest deviation along x, y, z (3,) [m]."""
        return np.ptp(self.prediction.deviation_m, axis=0)

    def to_json_dict(self) -> Mapping[str, object]:
        p, worst = self.prediction, self.worst
        return {'grid': list(self.shape), 'position_m': p.points.tolist(),
                'deviation_m': p.deviation_m.tolist(), 'sigma_m': p.sigma_m.tolist(),
                'largest_m': float(p.size_m[worst]), 'largest_sigma_m': float(p.size_sigma_m[worst]),
                'largest_at_m': p.points[worst].tolist(), 'range_m': self.ranges_m.tolist()}


def volumetric_map(solution: Solution, machine: Machine, per_axis: int = 11,
                   tool: np.ndarray | None = None) -> VolumetricMap:
    """The predicted deviation on ``per_axis`` positions of every axis."""
    x, y, z = (np.linspace(0.0, length, per_axis) for length in machine.volume)
    grid = np.stack(np.meshgrid(x, y, z, indexing='ij'), -1).reshape(-1, 3)
    return VolumetricMap((x, y, z), predict(solution, machine, grid, tool))


def largest_deviation(solution: Solution, machine: Machine) -> tuple[float, float, np.ndarray]:
    """The largest deviation [m] over all knots and corners of the volume, its standard uncertainty [m], and where."""
    axes = []
    for axis, letter in enumerate('XYZ'):
        knots = [np.asarray(place) for name, place in solution.positions.items() if name[2] == letter]
        axes.append(np.unique(np.clip(np.concatenate([[0.0, machine.volume[axis]], *knots]), 0.0,
                                      machine.volume[axis]).round(9)))
    points = np.stack(np.meshgrid(*axes, indexing='ij'), -1).reshape(-1, 3)
    size = np.linalg.norm(deviation(solution.errors, machine, points), axis=1)
    worst = points[[int(np.argmax(size))]]
    prediction = predict(solution, machine, worst)
    return float(prediction.size_m[0]), float(prediction.size_sigma_m[0]), worst[0]


def compensated_command(errors: GeometricErrors, machine: Machine, points: np.ndarray,
                        tool: np.ndarray | None = None) -> np.ndarray:
    """What to command (n, 3) [m] so that the tool gets where it should be for ``points`` (n, 3) [m].

    Solves ``c + deviation(c) = point`` by repetition: each pass shrinks what is left by the errors'
    slope, 1e-4 and less, so three passes reach rounding.  ``ValueError`` where they do not, for errors
    so steep that the map folds.
    """
    points = np.atleast_2d(np.asarray(points, float))
    command = points
    for _ in range(COMMAND_STEPS):
        following = points - deviation(errors, machine, command, tool)
        step = np.max(np.abs(following - command), initial=0.0)
        command = following
        if step <= COMMAND_TOLERANCE_M + 4e-16 * np.max(np.abs(points), initial=0.0):
            return command
    raise ValueError(f'compensation does not settle (last step {step:.1e} m); '
                     'the errors change faster than the axis moves')


def without_rigid_motion(points: np.ndarray, field: np.ndarray) -> np.ndarray:
    """A field of deviations (n, 3) [m] less its least-squares shift and turn of the whole volume."""
    centred = points - points.mean(axis=0)
    design = np.zeros((len(points), 3, 6))
    design[:, :, :3] = np.eye(3)
    for motion in range(3):
        design[:, :, 3 + motion] = np.cross(np.eye(3)[motion], centred)
    flat = design.reshape(-1, 6)
    motion, *_ = np.linalg.lstsq(flat, field.reshape(-1), rcond=None)
    return field - (flat @ motion).reshape(-1, 3)
