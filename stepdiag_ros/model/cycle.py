"""A cycle of a setup: forward and back along its stops, run by run, as everybody plans it.

The interferometer is reset at the first stop of a run.  Forward and backward are a run each, unless the ends are
approached from beyond (ISO 230-2): the machine then leaves the last stop to come back to it from the other side, and
a reset there would hide the reversal that the overrun is to show.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import NONE
from stepdiag_ros.model.path import SetupPath, stops


@dataclass(frozen=True)
class Visit:
    """A stop as it is visited: its ``index`` along the path, the ``axis`` that moves to it, position (3,) [m],
    ``direction`` of the traverse; ``beyond`` (3,) [m]: passed on the way without a dwell, None: nothing is.
    """

    index: int
    axis: int
    position: np.ndarray
    direction: int
    beyond: np.ndarray | None = None


@dataclass(frozen=True)
class Traverse:
    """What is measured between two resets; ``name``: ``+``, ``-``, or ``+-`` for both in one."""

    name: str
    visits: tuple[Visit, ...]


def cycle(description: Description, setup: str) -> tuple[Traverse, ...]:
    """The runs of one repeat of a setup."""
    path, way = stops(description, setup), description.setups[setup].way
    forward, backward = (_along(path, direction) for direction in (1, -1))
    if way is None or not way.overrun:
        return Traverse('+', forward), Traverse('-', backward)
    moved = way.axes[0] if len(way.axes) == 1 else NONE
    first = Visit(0, moved, path.positions[0], 1, way.before)
    turn = Visit(len(path) - 1, moved, path.positions[-1], -1, way.beyond)
    return (Traverse('+-', (first, *forward[1:], turn, *backward[1:])),)


def _along(path: SetupPath, direction: int) -> tuple[Visit, ...]:
    return tuple(Visit(int(index), int(axis), position, direction) for index, axis, position in zip(
        np.arange(len(path))[::direction], path.moved(direction), path.positions[::direction], strict=True))
