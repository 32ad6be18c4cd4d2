"""Tables by single axes held back so far that no place of the volume becomes worse.

A table of one axis acts alike at every position of the others.  Where rotations are at work, the error that it
takes off on its line is not there elsewhere, and taking it off makes such places worse.  Of all tables g the one is
taken that is nearest to that of the line, g₀, and leaves each place p with at most what it had, and some room r for
what is not known:

    min ‖g − g₀‖²   subject to   |d_p − A_p g| ≤ |d_p| + r_p   at all places p

with d the deviation and A the interpolation.  It is convex and g = 0 always fits.  Solved by the alternating direction
method of multipliers (Boyd et al. 2011, sections 3 and 5): each step solves one linear system and projects on balls.
What the iteration leaves over is taken away by shrinking the result towards 0 until all places hold.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.compensate.taken import Trim
from stepdiag_ros.model.machine import AXES

STEPS = 1500
SETTLED, STILL = 1e-10, 1e-12
"""Iteration ends where places hold to this and a step moves the tables by less than this [m]."""
PENALTY = 5.0
HALVINGS = 40


def held_back(tables: Mapping[str, Trim], points: np.ndarray, deviation: np.ndarray, room: np.ndarray
              ) -> dict[str, Trim]:
    """Tables nearest to ``tables`` by which no place ``points`` (n, 3) [m] with ``deviation`` (n, 3) becomes worse
    by more than ``room`` (n,) [m].

    Values at the first position stay zero.  The mean of both directions is held back, their difference kept.
    """
    names = [name for name in tables if len(tables[name].position) > 1]
    if not names:
        return dict(tables)
    design = _design(names, tables, points)
    wanted = np.concatenate([tables[name].mean[1:] for name in names])
    size = np.linalg.norm(deviation, axis=1)
    # The largest of all gets no room: it must not grow.
    return _with_values(tables, names, _nearest(design, deviation, np.minimum(size + room, size.max()), wanted))


def best_of_volume(tables: Mapping[str, Trim], points: np.ndarray, deviation: np.ndarray) -> dict[str, Trim]:
    """Tables at the positions of ``tables`` that leave the least mean square over ``points`` (n, 3) [m]."""
    names = [name for name in tables if len(tables[name].position) > 1]
    if not names:
        return dict(tables)
    design = _design(names, tables, points)
    found, *_ = np.linalg.lstsq(design.reshape(-1, design.shape[2]), deviation.ravel(), rcond=None)
    return _with_values(tables, names, found)


def _with_values(tables: Mapping[str, Trim], names: list[str], found: np.ndarray) -> dict[str, Trim]:
    """The tables with other means: ``found`` holds the values after the first of all ``names``."""
    result, first = dict(tables), 0
    for name in names:
        trim = tables[name]
        count = len(trim.position) - 1
        change = np.concatenate([[0.0], found[first:first + count]]) - trim.mean
        result[name] = Trim(trim.position, trim.forward + change, trim.reverse + change)
        first += count
    return result


def _design(names: list[str], tables: Mapping[str, Trim], points: np.ndarray) -> np.ndarray:
    """What all values of the tables after their first do at the points (n, 3, k)."""
    return np.concatenate([_columns(name, tables[name].position, points) for name in names], axis=2)


def _columns(name: str, position: np.ndarray, points: np.ndarray) -> np.ndarray:
    """What the values of a table after its first do at the points (n, 3, k)."""
    moved, axis = AXES.index(name[1]), AXES.index(name[2])
    columns = np.zeros((len(points), 3, len(position) - 1))
    for k in range(1, len(position)):
        columns[:, moved, k - 1] = np.interp(points[:, axis], position, np.eye(len(position))[k])
    return columns


def _nearest(design: np.ndarray, deviation: np.ndarray, limit: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    flat = design.reshape(-1, design.shape[2])

    def over(values: np.ndarray) -> float:
        return float(np.max(np.linalg.norm(deviation - design @ values, axis=1) - limit))

    values = wanted
    if over(values) > SETTLED:
        weight = PENALTY * design.shape[2] / np.sum(flat**2)
        system = np.linalg.inv(np.eye(design.shape[2]) + weight * flat.T @ flat)
        split, dual, last = design @ wanted, np.zeros_like(deviation), wanted
        for _ in range(STEPS):
            values = system @ (wanted + weight * flat.T @ (split - dual).ravel())
            reached = design @ values
            off = reached + dual - deviation
            length = np.linalg.norm(off, axis=1)
            split = deviation + off * np.minimum(1.0, limit / np.maximum(length, 1e-30))[:, None]
            dual = dual + reached - split
            moved = np.max(np.abs(values - last))
            last = values
            if moved < STILL and over(values) <= SETTLED:
                break
    if over(values) <= SETTLED:
        return values
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if over(middle * values) <= 0.0 else (low, middle)
    return low * values
