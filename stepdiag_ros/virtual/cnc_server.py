"""A virtual three-axis control that speaks linuxcncrsh's protocol.

It knows what the calibration needs: the power-up sequence, homing, MDI with
``G0 G1 G4 G20 G21 G53 G90 G91``, feed, abort, positions and states.  User M-codes from
M101 on mount the mirror for the cell's setups, in the order of the cell file.  Every
move goes into the motion history that the sensors look at.

Nothing moves without a client that lives: the connection that enabled the control (one at a
time, as in linuxcncrsh) has to say something at least every ``watchdog`` seconds of the cell
file while the axes move, or the control brakes; when that connection ends it brakes at once.
"""

import asyncio
import re
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stepdiag_ros.model.way import BEYOND_M
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.faults import Faults
from stepdiag_ros.virtual.history import SharedHistory, now_ns
from stepdiag_ros.virtual.motion import (
    Profile,
    brake,
    evaluate,
    point_to_point,
    settling_time,
    tabulate,
)
from stepdiag_ros.virtual.serving import MOST_LINE, MOTION_FILE, announce, serve

LEAD_NS = 4_000_000
"""A move begins so much later than its command: every reader has it in hand by then."""
FIRST_SETUP_CODE = 101
WATCH_S = 0.01
"""So often the control looks for its client and for moves whose turn it is."""
PASSWORD, ENABLE_PASSWORD, NAME = 'EMC', 'EMCTOO', 'EMCNETSVR'
WORD = re.compile(r'([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))')
STILL = np.zeros(3)


@dataclass(frozen=True)
class _Order:
    """A move, a mounting (``setup``) or a pause (``pause_s``) that waits for its turn."""

    target: np.ndarray
    profile: Profile
    setup: int
    pause_s: float = 0.0


class Machine:
    """Power, homing, mode and motion of the control."""

    def __init__(self, cell: Cell, history: SharedHistory):
        self.cell, self.history = cell, history
        self.estop, self.on, self.mode, self.error = True, False, 'MANUAL', 'OK'
        self.homed = [False] * 3
        self.owner: Session | None = None
        """The connection that may command; the others may look."""
        self._heard_s = 0.0
        self._queue: deque[_Order] = deque()
        self._braking = False
        self._target = np.zeros(3)      # in the volume, where the orders given so far end
        self._place = np.zeros(3)       # where the last move of the history ends
        self._end_ns = now_ns()
        self._origin = np.array(cell.description.machine.origin or (0.0, 0.0, 0.0))
        self._feed = 0.0
        self._unit = 1e-3
        self._setup = -1
        history.append(self._end_ns, self._place, self._place, _rest(), self._setup)

    # -- states

    @property
    def idle(self) -> bool:
        return not self._queue and now_ns() >= self._end_ns

    def position(self, actual: bool = True) -> np.ndarray:
        """(3,) [m] now, of the axes or of the command, in machine coordinates."""
        _, commanded, followed, _ = self.history.locate(np.array([now_ns()]),
                                                        self.cell.motion.settling)
        return (followed if actual else commanded)[0] + self._origin

    # -- who commands

    def attended(self) -> None:
        """The owner said something."""
        self._heard_s = time.monotonic()

    def lost(self, session: 'Session') -> None:
        """A connection has ended."""
        if session is self.owner:
            self.owner = None
            self._unattended('its client is gone')

    def watch(self) -> None:
        """Look for the client, and begin what is next in the queue."""
        silent_s = time.monotonic() - self._heard_s
        if silent_s > self.cell.instruments.watchdog:
            self._unattended(f'nothing was received from its client for {silent_s:.2f} s')
        self._advance()

    def _unattended(self, why: str) -> None:
        if not self.idle and not self._braking:
            self.abort()
            self.error = f'watchdog: {why}; motion aborted'

    # -- motion

    def mdi(self, line: str) -> None:
        """Carry out a line of G-code; what is wrong with it ends up in ``error``."""
        try:
            self._execute(line.upper())
        except ValueError as error:
            self.error = str(error)

    def _execute(self, line: str) -> None:
        words = WORD.findall(line)
        if WORD.sub('', line).strip():
            raise ValueError(f'Bad character or word in {line!r}')
        codes = [(letter, float(value)) for letter, value in words]
        g = {value for letter, value in codes if letter == 'G'}
        values = {letter: value for letter, value in codes if letter not in 'GM'}
        unknown = g - {0, 1, 4, 20, 21, 53, 90, 94}
        if unknown:
            raise ValueError(f'Unknown g code used: G{sorted(unknown)[0]:g}')
        if 20 in g or 21 in g:
            self._unit = 25.4e-3 if 20 in g else 1e-3
        if 'F' in values:
            self._feed = values['F'] * self._unit / 60.0
        for letter, value in codes:
            if letter == 'M':
                self._m_code(int(value))
        if 4 in g:
            self._order(self._target, _rest(), pause_s=values.get('P', 0.0))
        elif any(axis in values for axis in 'XYZ'):
            target = np.array([values[axis] * self._unit - self._origin[i] if axis in values else self._target[i]
                               for i, axis in enumerate('XYZ')])
            self._go(target, self.cell.motion.feed if 0 in g else self._feed)

    def _go(self, target: np.ndarray, feed: float) -> None:
        if not all(self.homed):
            raise ValueError("Can't issue MDI command when not homed")
        if feed <= 0.0:
            raise ValueError('Cannot do a linear move with zero feed rate')
        for i, axis in enumerate('XYZ'):
            if not -BEYOND_M <= target[i] <= self.cell.description.machine.volume[i] + BEYOND_M:
                side = 'negative' if target[i] < 0.0 else 'positive'
                raise ValueError(f"Linear move in MDI would exceed {axis}'s {side} limit")
        limits = self.cell.motion
        profile = point_to_point(float(np.linalg.norm(target - self._target)),
                                 min(feed, limits.feed), limits.acceleration, limits.jerk)
        self._order(target, profile)

    def _order(self, target: np.ndarray, profile: Profile, pause_s: float = 0.0) -> None:
        self._queue.append(_Order(target, profile, self._setup, pause_s))
        self._target = target
        self._advance()

    def _advance(self) -> None:
        """What waits goes into the history, which knows no way back, when its turn has come."""
        while self._queue and now_ns() + LEAD_NS >= self._end_ns:
            order, self._braking = self._queue.popleft(), False
            start = max(now_ns() + LEAD_NS, self._end_ns)
            self.history.append(start, self._place, order.target, order.profile, order.setup)
            self._place = order.target
            self._end_ns = start + self._duration_ns(order.profile) + round(order.pause_s * 1e9)

    def _duration_ns(self, profile: Profile) -> int:
        table = tabulate(profile.duration[None], profile.jerk[None], np.array([profile.speed]),
                         np.array([profile.acceleration]))
        motion = self.cell.motion
        return round(float(settling_time(table, motion.settling, motion.in_position)[0]) * 1e9)

    def _m_code(self, number: int) -> None:
        if number == 2 or number == 30:
            return
        if not FIRST_SETUP_CODE <= number < FIRST_SETUP_CODE + len(self.cell.setup_names):
            raise ValueError(f'Unknown m code used: M{number}')
        self._setup = number - FIRST_SETUP_CODE
        self._order(self._target, _rest())

    def abort(self) -> None:
        """Brake at once, along the path, and forget what waits."""
        self._queue.clear()
        self._target = self._place
        now = now_ns() + LEAD_NS
        # A brake that was begun anew again and again would never end.
        if self._braking or now >= self._end_ns:
            return
        self._braking = True
        segment_number = int(self.history.segment_at(np.array([now]))[0])
        segment = self.history.records[segment_number]
        elapsed = np.array([(now - segment['start_ns']) * 1e-9])
        row = np.array([segment_number])
        travel, speed, acceleration, followed = (
            float(v[0]) for v in evaluate(self.history.table, row, elapsed,
                                          self.cell.motion.settling))
        direction = np.array(segment['direction'])
        place = np.array(segment['origin']) + travel * direction
        profile = brake(speed, acceleration, self.cell.motion.acceleration, self.cell.motion.jerk)
        self.history.append(now, place, place, profile, self._setup,
                            lag=(travel - followed) * direction, direction=direction)
        self._target = self._place = place + profile.length * direction
        self._end_ns = now + self._duration_ns(profile) + round(
            5.0 * self.cell.motion.settling * 1e9)


def _rest() -> Profile:
    return point_to_point(0.0, 1.0, 1.0, 1.0)


class Session(asyncio.Protocol):
    """One client's connection."""

    def __init__(self, machine: Machine, faults: Faults):
        self._machine, self._faults = machine, faults
        self._rest = b''
        self._linked, self._echo, self._verbose = False, True, False

    def connection_made(self, transport) -> None:
        self._transport = transport

    def connection_lost(self, _error: Exception | None) -> None:
        self._machine.lost(self)

    @property
    def _enabled(self) -> bool:
        return self._machine.owner is self

    def data_received(self, data: bytes) -> None:
        fault = self._faults.kind
        if fault == 'stall':
            return
        if fault == 'drop':
            self._transport.abort()
            return
        if fault == 'nonsense':
            self._transport.write(b'%PDF-1.4\r\n' * 60)
            return
        if self._echo and self._linked:
            self._transport.write(data)
        if self._enabled:
            self._machine.attended()
        *lines, self._rest = re.split(rb'[\r\n]', self._rest + data)
        if len(self._rest) > MOST_LINE:
            self._transport.abort()
        for line in lines:
            if self._transport.is_closing():
                return   # it has quit, or has gone
            if line.strip():
                self._command(line.decode('ascii', 'replace').strip())

    def _write(self, text: str, end: str = '\r\n') -> None:
        self._transport.write((text + end).encode())

    def _command(self, line: str) -> None:
        verb, *words = line.split()
        verb = verb.upper()
        if verb == 'HELLO':
            self._linked = len(words) >= 3 and words[0] == PASSWORD
            self._write(f'HELLO ACK {NAME} 1.1' if self._linked else 'HELLO NAK')
        elif verb == 'QUIT':
            self._transport.close()
        elif verb == 'GET':
            self._get([word.upper() for word in words])
        elif verb == 'SET':
            if not self._linked or not words:
                self._write('SET NAK')
                return
            name = words[0].upper()
            accepted = self._set(name, words[1:], line)
            if not accepted:
                self._write(f'SET {name} NAK', '\n\r')
            elif self._verbose:
                self._write(f'SET {name} ACK', '\n\r')

    def _set(self, name: str, words: list[str], line: str) -> bool:
        machine = self._machine
        value = words[0].upper() if words else ''
        if name in ('ECHO', 'VERBOSE') and value in ('ON', 'OFF'):
            setattr(self, f'_{name.lower()}', value == 'ON')
            return True
        if name == 'ENABLE':
            if bool(words) and words[0] == ENABLE_PASSWORD:
                machine.owner = self
                machine.attended()
            elif self._enabled:
                machine.owner = None
            return self._enabled or value == 'OFF'
        if not self._enabled:
            return False
        if name == 'ESTOP' and value in ('ON', 'OFF'):
            machine.estop = value == 'ON'
            if machine.estop:
                machine.on = False
                machine.abort()
            return True
        if name == 'MACHINE' and value in ('ON', 'OFF'):
            machine.on = value == 'ON' and not machine.estop
            if not machine.on:
                machine.abort()
            return True
        if name in ('SET_WAIT', 'WAIT', 'TIMEOUT', 'UPDATE', 'DEBUG'):
            return True
        return machine.on and self._set_running(name, value, line)

    def _set_running(self, name: str, value: str, line: str) -> bool:
        """Commands that need the machine switched on."""
        machine = self._machine
        if name == 'MODE' and value in ('MANUAL', 'AUTO', 'MDI'):
            machine.mode = value
        elif name == 'HOME' and value in ('0', '1', '2'):
            machine.homed[int(value)] = True
        elif name == 'ABORT':
            machine.abort()
        elif name == 'MDI':
            if machine.mode != 'MDI':
                machine.error = 'Must be in MDI mode to issue MDI command'
            else:
                machine.mdi(line.split(None, 2)[2] if len(line.split(None, 2)) > 2 else '')
        else:
            return False
        return True

    def _get(self, words: list[str]) -> None:
        machine, name = self._machine, words[0] if words else ''
        if name in ('ABS_ACT_POS', 'JOINT_POS', 'REL_ACT_POS', 'ABS_CMD_POS', 'REL_CMD_POS'):
            place = machine.position(actual='CMD' not in name) * 1e3
            if len(words) > 1 and words[1] in ('0', '1', '2'):
                self._write(f'{name} {words[1]} {place[int(words[1])]:.6f}')
            else:
                self._write(f'{name} ' + ' '.join(f'{v:.6f}' for v in (*place, *STILL)))
            return
        answers = {
            'ECHO': lambda: 'ON' if self._echo else 'OFF',
            'VERBOSE': lambda: 'ON' if self._verbose else 'OFF',
            'ENABLE': lambda: 'ON' if self._enabled else 'OFF',
            'ESTOP': lambda: 'ON' if machine.estop else 'OFF',
            'MACHINE': lambda: 'ON' if machine.on else 'OFF',
            'MODE': lambda: machine.mode,
            'JOINT_HOMED': lambda: ' '.join('YES' if h else 'NO' for h in (*machine.homed, *[0] * 3)),
            'PROGRAM_STATUS': lambda: 'IDLE' if machine.idle else 'RUNNING',
            'USER_LINEAR_UNITS': lambda: 'MM',
            'PROGRAM_UNITS': lambda: 'MM',
            'PLAT': lambda: 'Linux',
            'TIME': lambda: f'{time.time():.6f}',
            'ERROR': self._take_error,
        }
        self._write(f'{name} {answers[name]()}' if name in answers else f'GET {name} NAK')

    def _take_error(self) -> str:
        text, self._machine.error = self._machine.error, 'OK'
        return text


def setup_codes(cell: Cell) -> dict[str, str]:
    """M-code that mounts the mirror for each setup."""
    return {name: f'M{FIRST_SETUP_CODE + i}' for i, name in enumerate(cell.setup_names)}


async def main(cell: Cell, runtime: Path) -> None:
    machine = Machine(cell, SharedHistory(runtime / MOTION_FILE, create=True))
    faults = Faults(runtime, 'cnc', cell.faults)
    where = cell.instruments.cnc
    server = await asyncio.get_running_loop().create_server(
        lambda: Session(machine, faults), where.host, where.port)
    announce(runtime, 'cnc', {'host': where.host, 'port': server.sockets[0].getsockname()[1],
                              'setup_codes': setup_codes(cell)})
    async with server:
        try:
            while True:
                machine.watch()
                await asyncio.sleep(WATCH_S)
        finally:
            # Switched off itself, its axes brake.
            if not machine.idle:
                machine.abort()


if __name__ == '__main__':
    raise SystemExit(serve('cnc_server', main))
