#!/usr/bin/python3
"""HAL component that writes down where a simulated machine's joints are, for the virtual sensors.

Reads ``stepdiagfollow.x y z`` [mm] and ``stepdiagfollow.setup`` (number of the mounted setup, 0: none) some
hundred times a second and appends to a file what changes: a header (count, time of the newest look), then
records (monotonic time [ns], setup − 1, x, y, z [m]).  A record is complete before the count includes it; between two
records the machine moved straight, and the last one holds until the time of the newest look.  Needs
LinuxCNC's Python module and nothing else.

On a busy computer a look may be late.  Where the machine moved at the look before, it came to the place that is seen
now no later than it would have by braking evenly all the way: a straight line to the late look would have it move while
its control has long said that it stands.
"""

import argparse
import math
import mmap
import os
import struct
import time

HEADER = struct.Struct('<qq')
RECORD = struct.Struct('<qqddd')
CAPACITY = 2_000_000
PERIOD_S = 0.002
LATE_NS = 10_000_000
"""A look so long after the one before is late."""


class Track:
    """The file; opened by readers from the moment it has its name."""

    def __init__(self, path: str):
        part = f'{path}.new'
        with open(part, 'wb') as file:
            file.truncate(HEADER.size + CAPACITY * RECORD.size)
        os.chmod(part, 0o644)
        with open(part, 'r+b') as file:
            self._map = mmap.mmap(file.fileno(), 0)
        # Readers look at any moment: each number of the header is stored at once.  struct.pack_into zeroes before it
        # writes, and byte by byte, so that a reader found no record, or a look as old as the clock.
        self._header = memoryview(self._map)[:HEADER.size].cast('q')
        self._count = 0
        self._last = None
        self._speed = 0.0           # at the last look [m/ns]
        self._written_ns = 0
        self._path, self._part = path, part

    def look(self, now_ns: int, setup: int, place: tuple) -> None:
        """Note what was seen at a time [ns]."""
        state = (setup, *place)
        if self._last is None or state != self._last[1]:
            if self._count + 2 > CAPACITY:
                raise OverflowError(f'{self._path} is full')
            if self._last is not None and self._last[0] != self._written_ns:
                self._append(*self._last)    # until then it stood
            self._append(self._arrived(now_ns, state), state)
        if self._last is not None and now_ns > self._last[0]:
            self._speed = math.dist(place, self._last[1][1:]) / (now_ns - self._last[0])
        self._last = (now_ns, state)
        self._header[0] = self._count
        self._header[1] = now_ns
        if self._part:
            os.replace(self._part, self._path)
            self._part = ''

    def _arrived(self, now_ns: int, state: tuple) -> int:
        """When the machine was at the place that is seen now, at the latest [ns]."""
        if self._last is None or now_ns - self._last[0] <= LATE_NS or not self._speed or state[0] != self._last[1][0]:
            return now_ns
        braking = 2.0 * math.dist(state[1:], self._last[1][1:]) / self._speed
        return min(now_ns, self._last[0] + max(1, math.ceil(braking)))

    def _append(self, time_ns: int, state: tuple) -> None:
        RECORD.pack_into(self._map, HEADER.size + self._count * RECORD.size, time_ns, *state)
        self._count += 1
        self._written_ns = time_ns


def main() -> None:
    import hal
    parser = argparse.ArgumentParser(description="A simulated machine's joints, for the virtual sensors.")
    parser.add_argument('--out', required=True, help='file to write')
    given = parser.parse_args()
    component = hal.component('stepdiagfollow')
    for axis in 'xyz':
        component.newpin(axis, hal.HAL_FLOAT, hal.HAL_IN)
    component.newpin('setup', hal.HAL_FLOAT, hal.HAL_IN)
    track = Track(given.out)
    component.ready()
    try:
        while True:
            # To the picometre: what is left of a computation at rest is no motion.
            place = tuple(round(component[axis] * 1e-3, 12) for axis in 'xyz')
            track.look(time.monotonic_ns(), round(component['setup']) - 1, place)
            time.sleep(PERIOD_S)
    except KeyboardInterrupt:
        pass


if __name__ == '__main__':
    main()
