"""What a sensor will see in the next milliseconds, worked out in one go and looked up request by request.

Tracing rays for one sample costs as much as for a hundred.  A server that did so for each request at 1 kHz would need
more than half a processor, and on a busy computer answer late.  The history of a virtual control tells the moves some
milliseconds before they begin, so what is to come is known; a new move ends what was worked out.  Of a control that
was only watched nothing is known ahead.
"""

import numpy as np

from stepdiag_ros.virtual.world import Reading, World

WINDOW_NS = 50_000_000
STEP_NS = 100_000
"""Time between two nodes: between them readings are straight to a ten-millionth of a metre at 8 m/s²."""
STILL_WINDOW_NS, STILL_STEP_NS = 100_000_000, 1_000_000
"""The same while the axes stand and nothing acts but the air: the servo's last nanometres decay in milliseconds."""


class Ahead:
    """Readings of ``world`` at any times, its stamps ``late_ns`` late; as :meth:`World.read`, but quick."""

    def __init__(self, world: World, late_ns: int):
        self._world, self._late_ns = world, late_ns
        self._known = -1
        self._commands = 0
        self._setup = ''
        self._time = np.zeros(0, np.int64)
        self._end = 0
        self._table = np.zeros((0, 0))

    def read(self, time_ns: np.ndarray, setup: str) -> Reading:
        """What the sensor shows at ``time_ns`` (n,)."""
        first, last = int(time_ns.min()), int(time_ns.max())
        self._notice()
        if setup != self._setup or not len(self._time) or first < self._time[0] or last >= self._end:
            self._look(first, last, setup)
        since = (time_ns - self._time[0]) * 1e-9
        node = (self._time - self._time[0]) * 1e-9
        columns = [np.interp(since, node, column) for column in self._table]
        beams = len(columns) - 5
        nearest = np.clip(np.searchsorted(self._time, time_ns), 0, len(self._time) - 1)
        return Reading(np.stack(columns[:beams], axis=1), np.stack(columns[beams:beams + 2], axis=1),
                       self._table[beams + 2, nearest], columns[beams + 3], columns[beams + 4])

    def _notice(self) -> None:
        """A move or a turn of the beam that was announced meanwhile: from then on nothing is known any more."""
        count = self._world.history.follow()
        if count != self._known:
            starts = self._world.history.records['start_ns'][max(self._known, 0):] + self._late_ns
            self._end = min(self._end, int(starts.min())) if self._known >= 0 and len(starts) else self._end
            self._known = count
        steering = self._world.steering
        if steering is not None and (commands := steering.follow()) != self._commands:
            self._end = min(self._end, int(steering.records['time_ns'][self._commands]) + self._late_ns)
            self._commands = commands

    def _look(self, first: int, last: int, setup: str) -> None:
        known_until = self._world.history.known_until_ns + self._late_ns
        still = known_until > last + STILL_WINDOW_NS + STILL_STEP_NS and self._world.stands_from(first - self._late_ns)
        window, step = (STILL_WINDOW_NS, STILL_STEP_NS) if still else (WINDOW_NS, STEP_NS)
        self._end = min(last + window, max(last, known_until))
        self._time, self._setup = np.arange(first, self._end + step, step), setup
        seen = self._world.read(self._time - self._late_ns, setup)
        self._table = np.vstack([seen.length.T, seen.spot.T, seen.quality, seen.intensity, seen.index])
