"""The way of a setup that no short name tells: from one point of the volume to another, in steps.

One principle holds for every kind of test.  A setup goes ``from`` a point ``to`` a point in steps, equal ones or to a
list of ``targets``.  In each step the axes move ``together`` or one after another; or the machine goes over the whole
``grid`` between both points, or ``around`` the rectangle that they span.  Body and face diagonals in one simultaneous
motion (ISO 230-6), stepped ones, lines of single axes wherever they lie (ISO 230-2, parallel lines), and the targets of
multilateration differ in nothing else.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.guard import limits

TOGETHER, GRID, AROUND = 'together', 'grid', 'around'
REACH_M = 1e-9
"""A point lies in the volume within this, and two points are one."""
BEYOND_M = 1e-3
"""The axes can go this far beyond the volume, as far as is known of any machine: for an overrun, not to measure."""
SAME_M = 1e-6
"""A target that is so near to an end of the way is that end."""


@dataclass(frozen=True)
class Way:
    """``start`` and ``end`` (3,) [m] commanded; ``moves``: letters of the axes in the order of one step,
    :data:`TOGETHER`, :data:`GRID` or :data:`AROUND`; ``steps``, None: as many as the plan's.

    ``targets`` [m], rising: distances from the start of the steps between both ends, where steps are not equal.
    ``overrun`` [m]: each end is approached from so far beyond it, and a cycle goes forward and back without a reset.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    moves: str = TOGETHER
    steps: int | None = None
    targets: tuple[float, ...] = ()
    overrun: float = 0.0

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes that move."""
        return tuple(axis for axis in range(3) if abs(self.end[axis] - self.start[axis]) > REACH_M)

    @property
    def length(self) -> float:
        """[m] from start to end."""
        return float(np.linalg.norm(np.array(self.end) - self.start))

    @property
    def is_straight(self) -> bool:
        """Whether every stop lies on the line from start to end."""
        return self.moves == TOGETHER or len(self.axes) == 1

    @property
    def before(self) -> np.ndarray:
        """The point (3,) [m] an overrun before the start."""
        start, end = np.array(self.start), np.array(self.end)
        return start - self.overrun * (end - start) / self.length

    @property
    def beyond(self) -> np.ndarray:
        """The point (3,) [m] an overrun beyond the end."""
        return np.array(self.end) + np.array(self.start) - self.before

    def shares(self, steps: int) -> np.ndarray:
        """Part (k + 1,) of the way at each step, 0 to 1; ``steps``: the plan's."""
        if not self.targets:
            count = self.steps or steps
            return np.arange(count + 1) / count
        inner = [t for t in self.targets if SAME_M < t < self.length - SAME_M]
        return np.array([0.0, *(t / self.length for t in inner), 1.0])

    def stops(self, steps: int) -> tuple[np.ndarray, list[int]]:
        """Commanded positions (n, 3) [m] in forward order, and the axis (n − 1,) that each move is of; −1: several."""
        start, end, shares = np.array(self.start), np.array(self.end), self.shares(steps)
        counts = self._counts(len(shares) - 1)
        # The end is reached exactly, whatever the division left over.
        positions = np.where(counts == len(shares) - 1, end, start + shares[counts] * (end - start))
        changed = np.abs(np.diff(counts, axis=0)).astype(bool)
        changed[:, [axis for axis in range(3) if axis not in self.axes]] = False
        return positions, [int(row.argmax()) if row.sum() == 1 else -1 for row in changed]

    def _counts(self, steps: int) -> np.ndarray:
        """Number of the step (n, 3) that each axis stands at, at each stop."""
        if self.is_straight:
            return np.repeat(np.arange(steps + 1)[:, None], 3, axis=1)
        if self.moves == GRID:
            return self._grid(steps)
        if self.moves == AROUND:
            return self._around(steps)
        moved = np.array(['XYZ'.index(letter) for letter in self.moves] * steps)
        return np.concatenate([np.zeros((1, 3), int), np.cumsum(moved[:, None] == np.arange(3), axis=0)])

    def _grid(self, steps: int) -> np.ndarray:
        """Every target of the grid, one axis a move: there and back along the first, then on along the next."""
        counts = np.zeros((1, 3), int)
        for axis in self.axes:
            layers = [counts if layer % 2 == 0 else counts[::-1] for layer in range(steps + 1)]
            counts = np.concatenate([part + layer * np.eye(3, dtype=int)[axis] for layer, part in enumerate(layers)])
        return counts

    def _around(self, steps: int) -> np.ndarray:
        """The outline of the rectangle, from the start along the first axis and round to the start again."""
        first, second = np.eye(3, dtype=int)[list(self.axes)]
        moves = np.repeat([first, second, -first, -second], steps, axis=0)
        return np.concatenate([np.zeros((1, 3), int), np.cumsum(moves, axis=0)])

    def count(self, steps: int) -> int:
        """Number of stops; ``steps``: the plan's."""
        each = len(self.shares(steps)) - 1
        if self.is_straight:
            return each + 1
        return {GRID: (each + 1) ** len(self.axes), AROUND: 4 * each + 1}.get(self.moves, len(self.axes) * each + 1)


def problem(way: Way, volume: tuple[float, ...], steps: int = 1) -> tuple[str, str] | None:
    """The key and what is wrong with it; None where the machine can go this way.  ``steps``: the plan's."""
    for key, point in (('from', way.start), ('to', way.end)):
        if any(not -REACH_M <= p <= v + REACH_M for p, v in zip(point, volume, strict=True)):
            return key, f'is {_point(point)}; give a point of the volume, from (0, 0, 0) to {_point(volume)} m'
    if not way.axes:
        return 'to', f'is {_point(way.end)}, the same as from; give another point'
    letters = ''.join('XYZ'[axis] for axis in way.axes)
    between = f'between {_point(way.start)} and {_point(way.end)} move {", ".join(letters)}'
    if way.moves == AROUND and len(letters) != 2:
        return 'moves', f'is {AROUND}; {between}, and a rectangle has two axes: from and to differ in two coordinates'
    if way.moves not in (TOGETHER, GRID, AROUND) and sorted(way.moves) != sorted(letters):
        return 'moves', (f'is {way.moves!r}; {between}: write {letters} in the order of one step, or {TOGETHER}')
    return _of_targets(way) or _of_overrun(way, volume) or _of_count(way, steps)


def _of_targets(way: Way) -> tuple[str, str] | None:
    if not way.targets:
        return None
    if way.steps is not None:
        return 'steps', 'is given besides targets, which are the steps; leave one of them out'
    if any(b - a <= SAME_M for a, b in zip(way.targets, way.targets[1:], strict=False)):
        return 'targets', 'must rise; give distances [m] along the way from its start'
    if way.targets[0] < -SAME_M or way.targets[-1] > way.length + SAME_M:
        return 'targets', f'must lie between 0 and the way\'s length of {way.length:.6g} m'
    return None


def _of_overrun(way: Way, volume: tuple[float, ...]) -> tuple[str, str] | None:
    if not way.overrun:
        return None
    if not way.is_straight:
        return 'overrun', f'needs axes that move {TOGETHER}: an end is approached along the way'
    for point in (way.before, way.beyond):
        if any(not -BEYOND_M <= p <= v + BEYOND_M for p, v in zip(point, volume, strict=True)):
            return 'overrun', (f'is {way.overrun:g} m and would go to {_point(point)} m; the axes go '
                               f'{1e3 * BEYOND_M:g} mm beyond the volume at most: let the way begin and end within it, '
                               'or give less')
    return None


def _of_count(way: Way, steps: int) -> tuple[str, str] | None:
    if way.count(steps) <= limits.STOPS:
        return None
    return 'moves', (f'is {way.moves} and comes to {way.count(steps)} stops; at most {limits.STOPS} are measured: '
                     'give fewer steps')


def _point(values: tuple[float, ...] | np.ndarray) -> str:
    return '(' + ', '.join(f'{value:g}' for value in values) + ')'
