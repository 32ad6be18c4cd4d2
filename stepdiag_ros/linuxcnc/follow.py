#!/usr/bin/python3
"""HAL component that writes down where a simulated machine's joints are, for the virtual sensors.

Reads ``stepdiagfollow.x y z`` [mm] and ``stepdiagfollow.setup`` (number of the mounted setup, 0: none) some
hundred times a second and appends to a file what changes: a header (count, time of the newest look), then
records (time [ns], setup − 1, x, y, z [m]).  A record is complete before the count includes it; between two
records the machine moved straight, and the last one holds until the time of the newest look.  Needs
LinuxCNC's Python module and nothing else.
"""

import argparse
import mmap
import os
import struct
import time

HEADER = struct.Struct('<qq')
RECORD = struct.Struct('<qqddd')
CAPACITY = 2_000_000
PERIOD_S = 0.002


class Track:
    """The file; opened by readers from the moment it has its name."""

    def __init__(self, path: str):
        part = f'{path}.new'
        with open(part, 'wb') as file:
            file.truncate(HEADER.size + CAPACITY * RECORD.size)
        os.chmod(part, 0o644)
        self._file = open(part, 'r+b')
        self._map = mmap.mmap(self._file.fileno(), 0)
        self._count = 0
        self._last = None
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
            self._append(now_ns, state)
        self._last = (now_ns, state)
        HEADER.pack_into(self._map, 0, self._count, now_ns)
        if self._part:
            os.replace(self._part, self._path)
            self._part = ''

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
            track.look(time.time_ns(), round(component['setup']) - 1, place)
            time.sleep(PERIOD_S)
    except KeyboardInterrupt:
        pass


if __name__ == '__main__':
    main()
