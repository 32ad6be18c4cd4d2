"""What the machine did: a growing list of straight moves, shared between processes.

The control appends a segment for each move (and for each brake when a move is
aborted); whoever wants to know where the machine was at some time evaluates them.
A segment begins a few milliseconds after it is written, so that a reader never
looks at a time whose segment is not there yet.  The file is a count followed by
fixed-size records: a record is complete before the count includes it.
"""

import time
from pathlib import Path

import numpy as np

from stepdiag_ros.virtual.motion import PHASES, Profile, Table, evaluate, tabulate

SEGMENT = np.dtype([('start_ns', '<i8'), ('setup', '<i8'), ('origin', '<f8', 3),
                    ('direction', '<f8', 3), ('duration', '<f8', PHASES), ('jerk', '<f8', PHASES),
                    ('speed', '<f8'), ('acceleration', '<f8'), ('lag', '<f8', 3)])
"""One move: begin [ns of :func:`now_ns`], setup that is mounted (number, −1: none), commanded start [m],
unit vector, phases [s, m/s³], speed and acceleration at the start, and the servo's
following error [m] that it inherited."""

CAPACITY = 200_000
FOR_EVER_NS = 2**62


def now_ns() -> int:
    """Time of the virtual world [ns]: the same in all processes, and no step of the system's clock moves an axis."""
    return time.monotonic_ns()


class History:
    """Segments in rising order of time; segment number = number of the arrival it ends in."""

    def __init__(self) -> None:
        self._records = np.zeros(64, SEGMENT)
        self._count = 0
        self._table: Table | None = None

    def __len__(self) -> int:
        return self._count

    @property
    def records(self) -> np.ndarray:
        """The segments so far, a view (m,) of :data:`SEGMENT`."""
        return self._records[:self._count]

    @property
    def known_until_ns(self) -> int:
        """Until when what was not announced by now does not happen [ns]."""
        return FOR_EVER_NS

    def append(self, start_ns: int, origin: np.ndarray, target: np.ndarray, profile: Profile,
               setup: int, lag: np.ndarray | None = None,
               direction: np.ndarray | None = None) -> np.void:
        """Add a move; ``direction`` is only needed for a brake, whose target is not known yet."""
        record = np.zeros((), SEGMENT)
        record['start_ns'], record['setup'], record['origin'] = start_ns, setup, origin
        if direction is None:
            travel = np.asarray(target, float) - origin
            length = np.linalg.norm(travel)
            direction = travel / length if length > 0.0 else np.zeros(3)
        record['direction'] = direction
        record['duration'], record['jerk'] = profile.duration, profile.jerk
        record['speed'], record['acceleration'] = profile.speed, profile.acceleration
        record['lag'] = 0.0 if lag is None else lag
        self._store(record)
        return record

    def _store(self, records: np.ndarray) -> None:
        records = np.atleast_1d(records)
        need = self._count + len(records)
        if need > len(self._records):
            grown = np.zeros(max(need, 2 * len(self._records)), SEGMENT)
            grown[:self._count] = self.records
            self._records = grown
        self._records[self._count:need] = records
        self._count = need
        self._table = None

    @property
    def table(self) -> Table:
        """The profiles of all segments."""
        if self._table is None:
            r = self.records
            self._table = tabulate(r['duration'], r['jerk'], r['speed'], r['acceleration'])
        return self._table

    def segment_at(self, time_ns: np.ndarray) -> np.ndarray:
        """(n,) number of the segment that governs each time; 0 before the first."""
        return np.maximum(np.searchsorted(self.records['start_ns'], time_ns, side='right') - 1, 0)

    def locate(self, time_ns: np.ndarray, lag: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where the machine is: segment (n,), commanded and actual axes (n, 3) [m], share done (n,).

        ``lag`` [s] is the servo's time constant.
        """
        number = self.segment_at(time_ns)
        segment = self.records[number]
        time = (time_ns - segment['start_ns']) * 1e-9
        travel, _, _, followed = evaluate(self.table, number, time, lag)
        total = self.table.position[number, -1]
        share = np.where(total > 0.0, followed / np.where(total > 0.0, total, 1.0), 1.0)
        commanded = segment['origin'] + travel[:, None] * segment['direction']
        actual = segment['origin'] + followed[:, None] * segment['direction']
        if lag > 0.0:
            actual = actual - segment['lag'] * np.exp(-np.maximum(time, 0.0) / lag)[:, None]
        return number, commanded, actual, np.clip(share, 0.0, 1.0)


class SharedHistory(History):
    """A history in a file that one process writes and others follow."""

    def __init__(self, path: Path, create: bool = False) -> None:
        super().__init__()
        size = 8 + CAPACITY * SEGMENT.itemsize
        if create:
            # Others open the file as soon as it is there: it appears with its full size.
            made = path.with_name(f'{path.name}.new')
            with open(made, 'wb') as file:
                file.truncate(size)   # sparse: only what is written takes room
            made.replace(path)
        mode = 'r+' if create else 'r'
        self._shared_count = np.memmap(path, '<i8', mode, 0, 1)
        self._shared = np.memmap(path, SEGMENT, mode, 8, CAPACITY)

    def append(self, *args, **named) -> np.void:
        if self._count >= CAPACITY:
            raise OverflowError(f'the motion history holds {CAPACITY} moves and is full')
        record = super().append(*args, **named)
        self._shared[self._count - 1] = record
        self._shared_count[0] = self._count
        return record

    def follow(self) -> int:
        """Take in what the writer added; returns how many segments there are."""
        count = int(self._shared_count[0])
        if count > self._count:
            self._store(np.array(self._shared[self._count:count]))
        return count
