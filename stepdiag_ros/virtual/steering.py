"""Where the mirrors that turn a beam stood at any time: a growing list of commands, shared between processes.

The instrument that commands them appends, those that look along the beam follow.  Between two commands a mirror goes to
what was commanded as ``exp(−t/response)``.  A command takes effect some milliseconds after it was written, so that a
reader never looks at a time whose command is not there yet.
"""

from pathlib import Path

import numpy as np

from stepdiag_ros.virtual.history import now_ns

RESPONSE_S = 0.001
DEAD_NS = 2_000_000
"""From a command to its effect."""
COMMAND = np.dtype([('time_ns', '<i8'), ('begin', '<f8', 2), ('end', '<f8', 2)])
"""When it takes effect, the angles [rad] then and those commanded."""
CAPACITY = 4_000_000
"""At a hundred commands a second eleven hours of motion; a beam that rests is not commanded."""


class SteeringHistory:
    """Commands in rising order of time; at first both angles are 0."""

    def __init__(self) -> None:
        self._records = np.zeros(256, COMMAND)
        self._count = 0

    @property
    def records(self) -> np.ndarray:
        """The commands so far, a view (m,) of :data:`COMMAND`."""
        return self._records[:self._count]

    def command(self, time_ns: int, angles: np.ndarray) -> None:
        """From ``time_ns`` on the mirrors go to ``angles`` (2,) [rad]."""
        record = np.zeros((), COMMAND)
        record['time_ns'], record['end'] = time_ns, angles
        record['begin'] = self.angles(np.array([time_ns]))[0]
        self._append(record)

    def _append(self, records: np.ndarray) -> None:
        records = np.atleast_1d(records)
        need = self._count + len(records)
        if need > len(self._records):
            grown = np.zeros(max(need, 2 * len(self._records)), COMMAND)
            grown[:self._count] = self.records
            self._records = grown
        self._records[self._count:need] = records
        self._count = need

    def angles(self, time_ns: np.ndarray) -> np.ndarray:
        """Azimuth and elevation (n, 2) [rad] at ``time_ns`` (n,)."""
        if not self._count:
            return np.zeros((len(time_ns), 2))
        number = np.searchsorted(self.records['time_ns'], time_ns, side='right') - 1
        record = self.records[np.maximum(number, 0)]
        since = np.where(number < 0, 0.0, (time_ns - record['time_ns']) * 1e-9)
        return record['end'] + (record['begin'] - record['end']) * np.exp(-since / RESPONSE_S)[:, None]

    def follow(self) -> int:
        """Take in what was commanded elsewhere; returns how many commands there are."""
        return self._count


class SharedSteering(SteeringHistory):
    """Commands in a file that one process writes and others follow; until it is there, there are none."""

    def __init__(self, path: Path, create: bool = False) -> None:
        super().__init__()
        self._path, self._mode = path, 'r+' if create else 'r'
        self._shared: np.memmap | None = None
        if create:
            made = path.with_name(f'{path.name}.new')
            with open(made, 'wb') as file:
                file.truncate(8 + CAPACITY * COMMAND.itemsize)   # sparse: only what is written takes room
            made.replace(path)
            self._open()

    def _open(self) -> None:
        self._shared_count = np.memmap(self._path, '<i8', self._mode, 0, 1)
        self._shared = np.memmap(self._path, COMMAND, self._mode, 8, CAPACITY)

    def _append(self, records: np.ndarray) -> None:
        super()._append(records)
        if self._mode == 'r+':
            if self._count > CAPACITY:
                raise OverflowError(f'the steering history holds {CAPACITY} commands and is full')
            self._shared[self._count - 1] = records
            self._shared_count[0] = self._count

    def steer(self, angles: np.ndarray) -> None:
        """The mirrors are commanded now."""
        self.command(now_ns() + DEAD_NS, angles)

    def follow(self) -> int:
        if self._shared is None and self._path.exists():
            self._open()
        if self._shared is not None and self._mode == 'r' and (count := int(self._shared_count[0])) > self._count:
            self._append(np.array(self._shared[self._count:count]))
        return self._count
