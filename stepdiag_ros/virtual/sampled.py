"""What a real control did: positions that were looked up while it moved, as a history of moves.

A HAL component beside LinuxCNC (``stepdiag_ros/linuxcnc/follow.py``) writes down where the joints' drives
are; the virtual sensors follow that file.  Between two records the machine moved straight; the last one
holds until the time of the newest look.  A move is what lies between two rests.
"""

import time
from pathlib import Path

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.history import SEGMENT, History, now_ns

RECORD = np.dtype([('time_ns', '<i8'), ('setup', '<i8'), ('place', '<f8', 3)])
HEADER_BYTES = 16
REST_NS = 15_000_000
"""Standing so long ends a move."""
LEAST_SHARE = 0.01
"""Share of a move below which an axis does not count as moved: a compensation moves all a little."""
FRESH_NS = 2_500_000
"""A look this young, one period of looks, is waited for no longer: a move is over some milliseconds before its control
says so."""
PATIENCE_S = 0.5
DEAD_S = 5.0


class SampledHistory(History):
    """The history in a file that ``follow.py`` writes; moves are identified by their beginning alone.

    Effects that count from a move's arrival count from its beginning here.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._header = np.memmap(path, '<i8', 'r', 0, 2)
        count = (path.stat().st_size - HEADER_BYTES) // RECORD.itemsize
        self._seen = np.memmap(path, RECORD, 'r', HEADER_BYTES, count)
        self._taken = 0

    def follow(self) -> int:
        """Take in what was looked up until now; waits for the look that is due.  Returns the moves."""
        now, began = now_ns(), time.monotonic()
        while int(self._header[1]) < now - FRESH_NS and time.monotonic() - began < PATIENCE_S:
            time.sleep(0.0005)
        if now - int(self._header[1]) > DEAD_S * 1e9:
            raise StepdiagError(f'{self._path}: nobody has looked at the machine for {DEAD_S:g} s; '
                                'LinuxCNC or its component stepdiagfollow has ended')
        count = int(self._header[0])
        if count > self._taken:
            self._split(count)
        return len(self)

    @property
    def known_until_ns(self) -> int:
        """The newest look: where the control goes next it tells nobody."""
        return int(self._header[1])

    def _split(self, count: int) -> None:
        """Moves that begin in the records from those known up to ``count``."""
        # One record back tells what the first new one changed, two whether the machine stood before.
        first = self._taken
        for i in range(first, count):
            record = self._seen[i]
            if i == 0:
                self._begin(record['time_ns'], record['setup'], record['place'], np.zeros(3))
                continue
            before = self._seen[i - 1]
            step = record['place'] - before['place']
            if record['setup'] != before['setup']:
                self._begin(record['time_ns'], record['setup'], record['place'], np.zeros(3))
            elif step.any() and self._stood(i - 1):
                direction = step / np.linalg.norm(step)
                self._begin(before['time_ns'], record['setup'], before['place'],
                            np.where(np.abs(direction) < LEAST_SHARE, 0.0, direction))
        self._taken = count

    def _stood(self, i: int) -> bool:
        """Whether the machine stood up to record ``i``."""
        if i == 0:
            return True
        before = self._seen[i - 1]
        return bool(np.array_equal(before['place'], self._seen[i]['place'])
                    and self._seen[i]['time_ns'] - before['time_ns'] >= REST_NS)

    def _begin(self, start_ns: int, setup: int, place: np.ndarray, direction: np.ndarray) -> None:
        record = np.zeros((), SEGMENT)
        record['start_ns'], record['setup'] = start_ns, setup
        record['origin'], record['direction'] = place, direction
        self._store(record)

    def locate(self, time_ns: np.ndarray, lag: float
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """As :meth:`History.locate`; commanded and actual are the same, and ``share`` is 1."""
        seen = self._seen[:self._taken]
        after = np.clip(np.searchsorted(seen['time_ns'], time_ns, side='right'), 1, self._taken)
        low, high = seen[after - 1], seen[np.minimum(after, self._taken - 1)]
        span = (high['time_ns'] - low['time_ns']).astype(float)
        share = np.clip((time_ns - low['time_ns']) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)
        place = low['place'] + share[:, None] * (high['place'] - low['place'])
        return self.segment_at(time_ns), place, place.copy(), np.ones(len(place))
