"""The way of a setup that no short name tells: from one point of the volume to another, in steps.

One principle holds for every kind of test along a line of sight.  A setup goes ``from`` a point ``to`` a point in equal
steps, and in each step the axes move ``together`` or one after another.  Body and face diagonals in one simultaneous
motion (ISO 230-6), stepped ones, and lines of single axes wherever they lie (ISO 230-2, parallel lines) differ in
nothing else; the beam lies along the way.
"""

from dataclasses import dataclass

import numpy as np

TOGETHER = 'together'
REACH_M = 1e-9
"""A point lies in the volume within this, and two points are one."""


@dataclass(frozen=True)
class Way:
    """``start`` and ``end`` (3,) [m] commanded; ``moves``: letters of the axes in the order of one step, or
    :data:`TOGETHER`; ``steps``, None: as many as the plan's."""

    start: tuple[float, ...]
    end: tuple[float, ...]
    moves: str = TOGETHER
    steps: int | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes that move."""
        return tuple(axis for axis in range(3) if abs(self.end[axis] - self.start[axis]) > REACH_M)

    @property
    def is_straight(self) -> bool:
        """Whether every stop lies on the line from start to end."""
        return self.moves == TOGETHER or len(self.axes) == 1

    def stops(self, steps: int) -> tuple[np.ndarray, list[int]]:
        """Commanded positions (n, 3) [m] in forward order, and the axis (n − 1,) that each move is of; −1: several."""
        start, end = np.array(self.start), np.array(self.end)
        if self.is_straight:
            counts = np.repeat(np.arange(steps + 1)[:, None], 3, axis=1)
            moved = [self.axes[0] if len(self.axes) == 1 else -1] * steps
        else:
            moved = ['XYZ'.index(letter) for letter in self.moves] * steps
            each = np.array(moved)[:, None] == np.arange(3)
            counts = np.concatenate([np.zeros((1, 3), int), np.cumsum(each, axis=0)])
        # The end is reached exactly, whatever the division left over.
        return np.where(counts == steps, end, start + counts / steps * (end - start)), moved


def problem(way: Way, volume: tuple[float, ...]) -> tuple[str, str] | None:
    """The key and what is wrong with it; None where the machine can go this way."""
    for key, point in (('from', way.start), ('to', way.end)):
        if any(not -REACH_M <= p <= v + REACH_M for p, v in zip(point, volume, strict=True)):
            return key, f'is {_point(point)}; give a point of the volume, from (0, 0, 0) to {_point(volume)} m'
    if not way.axes:
        return 'to', f'is {_point(way.end)}, the same as from; give another point'
    letters = ''.join('XYZ'[axis] for axis in way.axes)
    if way.moves != TOGETHER and sorted(way.moves) != sorted(letters):
        return 'moves', (f'is {way.moves!r}; between {_point(way.start)} and {_point(way.end)} move '
                         f'{", ".join(letters)}: write {letters} in the order of one step, or {TOGETHER}')
    return None


def _point(values: tuple[float, ...]) -> str:
    return '(' + ', '.join(f'{value:g}' for value in values) + ')'
