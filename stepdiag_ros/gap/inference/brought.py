"""Forms brought into parity space, in blocks: what is zero is not kept.

A log of n stops has ten thousand columns.  Many live in one run or one setup, most do nothing inside the dwells but
tilt them; written out they would take a hundred times the memory of the log.  So forms are brought over some at a time,
and of their columns only the runs, and the degrees of contrast inside the dwells, are kept in which they do something.
They are kept in single precision: a form that is right to some per cent may be rounded to 10⁻⁷.  It is rounded before
anything is worked out from it, so that all products are those of the rounded form.  Of what drifts, half of all
columns and full ones, nothing is kept but the factors (:mod:`~stepdiag_ros.gap.inference.factored`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from stepdiag_ros.effects.base import Form
from stepdiag_ros.effects.made import Split
from stepdiag_ros.gap.inference.factored import AT_A_TIME, Factored, is_factored
from stepdiag_ros.gap.inference.parity import ROUNDING, Parity

KEPT = np.float32
COLUMNS_AT_A_TIME = 128
"""Columns that are written out at a time, if they are more than ``AT_A_TIME`` numbers: of a long log each run is gone
through for every lot of columns."""


@dataclass(frozen=True)
class Block:
    """``rows`` (m,) of the data that only some columns reach: ``places`` (k,) of these among all, rising, and
    ``columns`` (m, k) there."""

    rows: np.ndarray
    places: np.ndarray
    columns: np.ndarray

    def within(self, wanted: slice) -> slice:
        """Which of its columns are among the ``wanted`` ones of all."""
        return slice(*np.searchsorted(self.places, [wanted.start, wanted.stop]))

    def and_then(self, other: 'Block', width: int) -> 'Block':
        """With the columns of ``other`` behind ``width`` of these."""
        return replace(self, places=np.concatenate([self.places, other.places + width]),
                       columns=np.concatenate([self.columns, other.columns], axis=1))


@dataclass(frozen=True)
class Brought:
    """The columns of some forms, in units of their scales: white, not yet projected, at the stops; contrasts inside the
    dwells; rows of the Jacobian correction (``own``).

    ``slices``: where each form's columns lie among all ``width``.  Projected: products ``grams`` (k, k) of each form's
    columns with each other and ``along`` (K,) of all with the data, those of the correction in the latter alone and, by
    form, in ``corrections`` (k, k).  ``factored``: the forms that stand in no block.
    """

    blocks: tuple[Block, ...]
    own: tuple[Block, ...]
    factored: Factored
    slices: Sequence[slice]
    grams: Sequence[np.ndarray]
    along: np.ndarray
    corrections: Mapping[int, np.ndarray]

    @classmethod
    def into(cls, space: Parity, forms: Sequence[Form], data: np.ndarray) -> 'Brought':
        """Bring ``forms`` over; ``data`` (M,): those of the space, and below them those of the correction."""
        work, grams = _Bringing(space, forms, data), []
        ways = [work.factors if is_factored(f) else work.split if _is_split(f) else work.written for f in forms]
        for some in _some_at_a_time(work.slices, len(data), ways):
            grams += ways[some[0]](some)
        return cls(tuple(g.block() for g in (*work.stops, *work.inside)), tuple(g.block() for g in work.own),
                   work.factored, work.slices, grams, work.along, work.corrections)

    @property
    def width(self) -> int:
        return len(self.along)

    def and_then(self, other: 'Brought') -> 'Brought':
        """With the columns of ``other`` behind."""
        def both(mine: Sequence[Block], theirs: Sequence[Block]) -> tuple[Block, ...]:
            return tuple(a.and_then(b, self.width) for a, b in zip(mine, theirs, strict=True))

        return replace(self, blocks=both(self.blocks, other.blocks), own=both(self.own, other.own),
                       factored=self.factored.and_then(other.factored, self.width),
                       along=np.concatenate([self.along, other.along]))

    def columns(self, part: slice, size: int) -> np.ndarray:
        """Some columns (size, k), written out."""
        full = np.zeros((size, part.stop - part.start))
        for block in (*self.blocks, *self.own):
            some = block.within(part)
            if some.stop > some.start:
                full[np.ix_(block.rows, block.places[some] - part.start)] = block.columns[:, some]
        self.factored.put(part, full)
        return full

    def times(self, directions: np.ndarray, wanted: slice) -> np.ndarray:
        """Products (K, r) of the ``wanted`` ones of all columns with ``directions`` (M, r); zero of the others."""
        result = np.zeros((self.width, directions.shape[1]))
        for block in (*self.blocks, *self.own):
            some = block.within(wanted)
            if some.stop > some.start:
                result[block.places[some]] += block.columns[:, some].T @ directions[block.rows]
        places = self.factored.within(wanted)
        if places:
            for place, product in self.factored.times(self.factored.back(directions), places):
                result[place:place + len(product)] = product
        return result


class _Gathering:
    """A block in the making."""

    def __init__(self, rows: np.ndarray):
        self.rows, self._count = rows, 0
        self._places, self._columns = np.empty(64, np.intp), np.empty((len(rows), 64), KEPT, order='F')

    def put(self, columns: np.ndarray, places: np.ndarray) -> None:
        """Columns (m, k) at ``places`` (k,)."""
        begin, self._count = self._count, self._count + len(places)
        if self._count > len(self._places):
            room = max(self._count, len(self._places) * 9 // 8)
            self._places, places_before = np.empty(room, np.intp), self._places[:begin]
            self._columns, before = np.empty((len(self.rows), room), KEPT, order='F'), self._columns[:, :begin]
            self._places[:begin], self._columns[:, :begin] = places_before, before
        self._places[begin:self._count], self._columns[:, begin:self._count] = places, columns

    def block(self) -> Block:
        """What was gathered; the room that is left over is given back."""
        places, columns = self._places[:self._count].copy(), self._columns[:, :self._count].copy(order='F')
        self._places, self._columns = places, columns
        return Block(self.rows, places, columns)


class _Bringing:
    """Forms on their way into parity space, some neighbouring ones at a time."""

    def __init__(self, space: Parity, forms: Sequence[Form], data: np.ndarray):
        self._space, self._forms, self._data = space, forms, data
        edges = np.cumsum([0, *(len(form.columns) for form in forms)]).tolist()
        self.slices = [slice(begin, end) for begin, end in pairwise(edges)]
        self.along, self.corrections = np.zeros(edges[-1]), {}
        self.stops = [_Gathering(np.arange(rows.start, rows.stop)) for rows in space.projection.runs]
        self.inside = [_Gathering(space.stops + rows) for rows in space.inside_runs]
        self.own = [_Gathering(space.size + rows) for rows in space.own_runs if len(rows)]
        self.factored = Factored(space, {self.slices[i].start: f for i, f in enumerate(forms) if is_factored(f)})
        self._data_back = self.factored.back(data[:, None])

    def written(self, some: Sequence[int]) -> list[np.ndarray]:
        """Gather the columns of some forms; products (k, k) of each one's with each other, the fit's share taken off.

        The data are projected, so are products with them: the columns need not be, which would be the dearest step.
        Their own products are put right by what the fit absorbs.
        """
        space, forms, part = self._space, self._forms, self._part(some)
        columns = np.concatenate([_at_stops(forms[i]) for i in some])
        white = np.zeros((space.stops, len(columns)), order='F')
        for gathering, (rows, there, values) in zip(self.stops, space.white_runs(columns), strict=True):
            values = _rounded(values)
            white[rows, there] = values
            gathering.put(values, there + part.start)
        self.along[part] = white.T @ self._data[:space.stops]
        grams = self._grams(some, white)
        bent = [i for i in some if forms[i].inside is not None]
        for i, gram in self._below(space.stops, self.inside, bent, lambda form: space.bin_part(
                np.asarray(form.inside)) * form.scale).items():
            grams[i] += gram
        read = [i for i in some if forms[i].by_reading is not None]
        self.corrections |= self._below(space.size, self.own, read, space.own_rows)
        return list(grams.values())

    def factors(self, some: Sequence[int]) -> list[np.ndarray]:
        """The same products of some factored forms, of which nothing is gathered."""
        space, places = self._space, [self.slices[i].start for i in some]
        white = space.white_part(np.concatenate([_at_stops(self._forms[i]) for i in some]))
        for place, product in self.factored.times(self._data_back, places):
            self.along[place:place + len(product)] = product[:, 0]
        grams = self._grams(some, white)
        return [gram + self.factored.grams_inside(self.slices[i].start) for i, gram in grams.items()]

    def split(self, some: Sequence[int]) -> list[np.ndarray]:
        """Gather the columns of some forms of which few do anything in a run, run by run; the same products."""
        space, grams = self._space, []
        for number in some:
            form, first = self._forms[number], self.slices[number].start
            gram, correction = np.zeros((len(form.columns),) * 2), np.zeros((len(form.columns),) * 2)
            along = np.zeros((space.stops - space.projection.readings, len(gram)))
            runs = enumerate(zip(self.stops, space.white_runs(form.columns), strict=True))
            for run, (gathering, (rows, there, values)) in runs:
                values = _rounded(values * form.scale[there])
                along[:, there] += space.projection.along(values, run)
                self._put(gathering, self._data[rows], first + there, values)
                gram[np.ix_(there, there)] += values.T @ values
            for gathering in self.own if form.by_reading is not None else ():
                there, values = space.own_rows_at(form, gathering.rows - space.size)
                values = _rounded(values)
                self._put(gathering, self._data[gathering.rows], first + there, values)
                correction[np.ix_(there, there)] += values.T @ values
            if form.by_reading is not None:
                self.corrections[number] = correction
            absorbed = space.projection.coordinates(along)
            grams.append(gram - absorbed.T @ absorbed)
        return grams

    def _put(self, gathering: _Gathering, data: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
        self.along[places] += values.T @ data
        gathering.put(values, places)

    def _part(self, some: Sequence[int]) -> slice:
        return slice(self.slices[some[0]].start, self.slices[some[-1]].stop)

    def _grams(self, some: Sequence[int], white: np.ndarray) -> dict[int, np.ndarray]:
        first, absorbed = self._part(some).start, self._space.projection.absorbed(white)
        at = {i: slice(self.slices[i].start - first, self.slices[i].stop - first) for i in some}
        return {i: white[:, own].T @ white[:, own] - absorbed[:, own].T @ absorbed[:, own] for i, own in at.items()}

    def _below(self, above: int, blocks: Sequence[_Gathering], numbers: Sequence[int],
               part_of: Callable[[Form], np.ndarray]) -> dict[int, np.ndarray]:
        """Gather what some forms, by their ``numbers``, do in rows below ``above`` others, (m, k) by ``part_of``, and
        add their products with the data there; by number the products (k, k) of each part with itself."""
        parts = [part_of(self._forms[i]) for i in numbers]
        if not parts or not len(parts[0]):
            return {}
        columns = _rounded(np.concatenate(parts, axis=1))
        places = np.concatenate([np.arange(self.slices[i].start, self.slices[i].stop) for i in numbers])
        self.along[places] += columns.T @ self._data[above:above + len(columns)]
        _gather(blocks, columns, above, places)
        each = np.split(columns, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
        return {i: mine.T @ mine for i, mine in zip(numbers, each, strict=True)}


def _is_split(form: Form) -> bool:
    return isinstance(form.columns, Split) and form.inside is None


def _at_stops(form: Form) -> np.ndarray:
    """Columns (k, n, c) of a form at the stops, in units of its scales."""
    return np.asarray(form.columns) * form.scale[:, None, None]


def _rounded(columns: np.ndarray) -> np.ndarray:
    """Columns as they will be kept."""
    return columns.astype(KEPT).astype(float)


def _gather(blocks: Sequence[_Gathering], columns: np.ndarray, above: int, places: np.ndarray) -> None:
    """Columns (m, k) at ``places`` (k,), whose rows lie below ``above`` others, to those blocks of some rows in which
    they are more than rounding."""
    large = np.abs(columns)
    least = ROUNDING * large.max(axis=0, initial=0.0)
    order = np.concatenate([block.rows for block in blocks]) - above
    starts = np.cumsum([0, *(len(block.rows) for block in blocks[:-1])])
    for block, there in zip(blocks, np.maximum.reduceat(large[order], starts, axis=0) > least, strict=True):
        mine = np.flatnonzero(there)
        if len(mine):
            block.put(columns[np.ix_(block.rows - above, mine)], places[mine])


def _some_at_a_time(slices: Sequence[slice], size: int, ways: Sequence[Callable]) -> Iterator[list[int]]:
    """Numbers of neighbouring forms brought in one of the ``ways``, together with no more columns of ``size`` than are
    written out at a time."""
    some: list[int] = []
    most = max(AT_A_TIME // size, COLUMNS_AT_A_TIME)
    for number, part in enumerate(slices):
        if some and (part.stop - slices[some[0]].start > most or ways[number] != ways[some[0]]):
            yield some
            some = []
        some.append(number)
    if some:
        yield some
