"""A machine control behind linuxcncrsh, LinuxCNC's line protocol over TCP.

``hello`` opens, ``set …`` commands are acknowledged once ``set verbose on`` was sent,
``get …`` answers with the name and the value.  Commands of motion go as G-code by
``set mdi``, in machine coordinates (G53), so that no work offset can interfere.
"""

import re
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.devices.heartbeat import Heartbeat
from stepdiag_ros.devices.link import Link

PORT = 5007
AXES = 'XYZ'
STILL_S = 1.0
"""After so long at rest away from its target a move is taken to have failed."""
STOP_S = 10.0
"""So long a stop is tried, over one connection after the other."""
STOP_ANSWER_S = 1.0
"""A connection that says nothing for so long while the machine must stop is given up for a fresh one."""
STOP_PAUSE_S = 0.05
ASKED = 3
"""So often a position is asked for that comes garbled: of two clients that ask at once the control may answer one with
what the other asked for (one axis instead of all)."""
MOST_LINE = 1 << 16
"""Bytes without an end of line that are no answer of a control."""


class LinuxCncRsh:
    """Client of one control.

    ``origin_m``: machine coordinates of the volume's lower corner.  ``setup_codes`` maps a setup to
    the M-code that has its mirror mounted; setups that it does not name need none.
    ``window_m``: distance from the target at which a move counts as arrived.  ``watch_port``: where the
    control's watchdog takes signs of life, 0: it has none.
    """

    def __init__(self, host: str, port: int = PORT, origin_m: tuple[float, float, float] = (0, 0, 0),
                 setup_codes: dict[str, str] | None = None, window_m: float = 1.0e-6,
                 timeout_s: float = 5.0, ready_timeout_s: float = 60.0,
                 password: str = 'EMC', enable_password: str = 'EMCTOO', stop_timeout_s: float = STOP_S,
                 watch_port: int = 0):
        self._link = Link('machine control', host, port, timeout_s)
        self._heart = Heartbeat(host, watch_port, timeout_s) if watch_port else None
        self._timeout_s = timeout_s
        self._stop_timeout_s = stop_timeout_s
        self._ready_timeout_s = ready_timeout_s
        self._passwords = (password, enable_password)
        self._origin = np.array(origin_m, float)
        self._codes = dict(setup_codes or {})
        self._window = window_m
        self._lines: list[str] = []
        self._rest = b''
        self._unit_m = 1e-3
        self._target: np.ndarray | None = None
        self._last: np.ndarray | None = None
        self._still_since = 0.0

    def connect(self) -> None:
        self._greet()
        if self._heart is not None:
            self._heart.open()

    def _greet(self) -> None:
        """The connection that commands, without the one that gives signs of life."""
        self._link.open()
        self._lines, self._rest = [], b''
        password, enable = self._passwords
        self._send(f'hello {password} stepdiag 1.1')
        answer = self._await(r'HELLO (ACK|NAK).*')
        if ' ACK' not in answer:
            raise self._link.fail('refuses the connection password; set it to the one that '
                                  'linuxcncrsh was started with')
        self._send('set echo off')
        self._set('verbose on')
        self._set(f'enable {enable}')
        unit = self._get('user_linear_units')
        units = {'MM': 1e-3, 'INCH': 25.4e-3, 'CM': 1e-2}
        if unit not in units:
            raise self._link.fail(f'counts lengths in {unit!r}; set it up in MM or INCH')
        self._unit_m = units[unit]
        self._forget_errors()

    def close(self) -> None:
        if self._link.is_open:
            try:
                self._send('quit')
            except DeviceError:
                pass   # it went first
        self._link.close()
        if self._heart is not None:
            self._heart.close()

    def make_ready(self) -> None:
        self._set('estop off')
        self._wait_for(lambda: self._get('estop') == 'OFF', 'stays in emergency stop; release it')
        self._set('machine on')
        self._wait_for(lambda: self._get('machine') == 'ON', 'does not switch on; see its screen')
        if not self._homed():
            self._set('mode manual')
            for joint in range(3):
                self._set(f'home {joint}')
                self._wait_for(lambda j=joint: self._homed()[j],
                               f'does not home joint {joint}; see its screen')
        self._set('mode mdi')
        self._wait_for(lambda: self._get('mode') == 'MDI' and self._idle(),
                       'does not get idle in MDI mode; abort its program')
        self._mdi('G21 G90 G94')
        self._wait_for(self._idle, 'does not take commands; see its screen')
        self._target = None

    def _homed(self, count: int = 3):
        """Truthy when all of the first joints are homed; indexing gives one joint's word."""
        words = self._get('joint_homed').split()[:count]
        return _All(word == 'YES' for word in words)

    def select_setup(self, name: str) -> None:
        if name in self._codes:
            self._mdi(self._codes[name])
            self._wait_for(self._idle, f'does not finish {self._codes[name]} for setup {name}')

    def move(self, position_m: np.ndarray, feed_m_s: float) -> None:
        target = np.asarray(position_m, float)
        # A feed or a place that is not finite must not reach a machine.
        if target.shape != (3,) or not np.all(np.isfinite(target)) or not 0.0 < feed_m_s < 100.0:
            raise DeviceError(f'{self._link.where}: cannot move to {position_m} with '
                              f'{feed_m_s} m/s; give three coordinates [m] and a feed above zero')
        place = (target + self._origin) * 1e3
        words = ' '.join(f'{axis}{value:.6f}' for axis, value in zip(AXES, place, strict=True))
        self._target, self._last, self._still_since = target, None, time.monotonic()
        self._beat()
        self._mdi(f'G53 G1 {words} F{feed_m_s * 6e4:.3f}')

    def in_position(self) -> bool:
        """Idle, and twice at the same place within the window of the target."""
        self._beat()
        return self._rests()

    def _rests(self) -> bool:
        """:meth:`in_position` without a sign of life."""
        idle, place = self._idle(), self.position()
        same = self._last is not None and np.max(np.abs(place - self._last)) <= self._window
        self._last = place
        if self._target is None:
            return bool(idle and same)
        arrived = np.max(np.abs(place - self._target)) <= self._window
        if idle and same and not arrived:
            if time.monotonic() - self._still_since > STILL_S:
                error = self._get('error')
                raise self._link.fail(f'stopped at {place} m on the way to {self._target} m: '
                                      + (error if error != 'OK' else 'it names no error; its watchdog, or a hand, has '
                                                                     'aborted the move'))
        else:
            self._still_since = time.monotonic()
        return bool(idle and same and arrived)

    def position(self) -> np.ndarray:
        for _ in range(ASKED):
            words = self._get('abs_act_pos').split()
            try:
                place = np.array([float(word) for word in words[:3]])
            except ValueError:
                place = np.zeros(0)
            if place.shape == (3,) and np.all(np.isfinite(place)):
                return place * self._unit_m - self._origin
        raise self._link.fail(f'answers nonsense ({" ".join(words)[:60]!r} for a position)')

    def stop(self) -> None:
        """Abort the motion; returns when the machine stands still.

        Over the connection that is open, and over a fresh one where that is gone or says nothing:
        what ends a run may be the very loss of its connection.  The watchdog is not needed for it: whom it takes
        for dead it stops.  Tried for ``stop_timeout_s``.
        """
        usual_s = self._timeout_s
        self._hurry(min(usual_s, STOP_ANSWER_S))
        end = time.monotonic() + self._stop_timeout_s
        try:
            while True:
                try:
                    if not self._link.is_open:
                        self._greet()
                    self._abort(end)
                    return
                except DeviceError as error:
                    self._link.close()
                    if time.monotonic() > end:
                        raise DeviceError(f'{error}; a stop was tried for {self._stop_timeout_s:g} s, '
                                          'press the emergency stop') from None
                time.sleep(STOP_PAUSE_S)
        finally:
            self._hurry(usual_s)

    def _hurry(self, timeout_s: float) -> None:
        """Wait no longer than this for an answer."""
        self._timeout_s = timeout_s
        self._link.set_timeout(timeout_s)

    def _abort(self, end_s: float) -> None:
        self._send('set abort')
        answer = self._await(r'SET (?:abort )?(ACK|NAK)')
        self._target, self._last = None, None
        # A machine that is switched off takes no commands and has nothing to abort.
        if answer.upper().endswith('NAK') and self._get('machine') != 'OFF':
            raise self._link.fail("refuses 'abort'")
        while not self._rests():
            if time.monotonic() > end_s:
                raise self._link.fail('does not come to rest after an abort')
            time.sleep(0.005)

    def state(self) -> dict[str, object]:
        return {'estop': self._get('estop') == 'ON', 'on': self._get('machine') == 'ON',
                'homed': bool(self._homed()), 'idle': self._idle(),
                'mode': self._get('mode').lower()}

    def _beat(self) -> None:
        if self._heart is not None:
            self._heart.beat()

    # -- the protocol

    def _idle(self) -> bool:
        return self._get('program_status') == 'IDLE'

    def _mdi(self, code: str) -> None:
        self._set(f'mdi {code}')
        error = self._get('error')
        if error != 'OK':
            # One wrong line may bring several complaints, the later ones a moment later;
            # left there they would be taken for answers to the next line.
            time.sleep(0.05)
            self._forget_errors()
            raise self._link.fail(f'refuses {code!r}: {error}')

    def _forget_errors(self) -> None:
        for _ in range(20):
            if self._get('error') == 'OK':
                return

    def _set(self, command: str) -> None:
        name = command.split()[0]
        self._send(f'set {command}')
        if self._await(rf'SET (?:{name} )?(ACK|NAK)').upper().endswith('NAK'):
            shown = command if name != 'enable' else 'enable (the password)'
            raise self._link.fail(f'refuses {shown!r} in its present state; see its screen')

    def _get(self, name: str) -> str:
        self._send(f'get {name}')
        answer = self._await(rf'(?:GET )?{name}\b.*')
        if answer.upper() == f'GET {name.upper()} NAK':
            raise self._link.fail(f'does not know {name!r}; is it linuxcncrsh?')
        return answer[len(name):].strip()

    def _send(self, line: str) -> None:
        self._link.send(line.encode('ascii', 'replace') + b'\r\n')

    def _await(self, pattern: str) -> str:
        """The next line that matches; others (echoes, greetings) are passed over."""
        end = time.monotonic() + self._timeout_s
        expected = re.compile(pattern, re.IGNORECASE)
        skipped = 0
        while True:
            while self._lines:
                line = self._lines.pop(0)
                # An echo of our own command is no answer to it.
                if expected.fullmatch(line) and not re.match(r'(get|set|hello) ', line):
                    return line
                skipped += 1
                if skipped > 50:
                    raise self._link.fail(f'answers nonsense ({line[:60]!r}); is it linuxcncrsh?')
            if time.monotonic() > end:
                raise self._link.fail(f'stalls: no answer for {self._timeout_s:g} s; restart it')
            data = self._rest + self._link.receive()
            # "\n\r" after acknowledgements, "\r\n" after values: both are just breaks.
            *whole, self._rest = re.split(rb'[\r\n]+', data)
            if len(self._rest) > MOST_LINE:
                raise self._link.fail('answers nonsense (no end of line); is it linuxcncrsh?')
            self._lines += [line.decode('ascii', 'replace').strip() for line in whole if line.strip()]

    def _wait_for(self, condition, complaint: str) -> None:
        end = time.monotonic() + self._ready_timeout_s
        while not condition():
            if time.monotonic() > end:
                raise self._link.fail(complaint)
            time.sleep(0.005)


class _All(tuple):
    """A tuple of flags that is true when every flag is."""

    def __bool__(self) -> bool:
        return len(self) > 0 and all(self)


def from_settings(settings: Mapping[str, Any]) -> LinuxCncRsh:
    """A client by the settings of the sequencer: ``host``, ``port``, ``origin`` [m], ``setup_codes``, ``timeout`` [s],
    ``watch_port``."""
    return LinuxCncRsh(settings['host'], settings['port'], settings['origin'], settings['setup_codes'],
                       timeout_s=settings['timeout'], watch_port=settings['watch_port'])
