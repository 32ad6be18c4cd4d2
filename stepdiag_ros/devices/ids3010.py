"""attocube IDS3010: up to three interferometer axes over JSON-RPC 2.0 on TCP.

Methods and answers as in attocube's published Python and C interfaces: an answer's
``result`` begins with an error or warning number, positions follow in picometres.
Firmware before 1.9 has the methods in ``com.attocube.ids``, later one in
``com.attocube.sen``; which, is tried on connecting.

A request per sample and an answer per request would bound the rate by the round
trip.  Requests are therefore sent in small groups on the block's time grid without
waiting, and the answers read meanwhile.
"""

import math
import time
from collections import deque

import numpy as np

from stepdiag_ros.devices.base import DeviceError, DisplacementBlock
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.jsonstream import JsonStream
from stepdiag_ros.devices.link import Link
from stepdiag_ros.devices.optical_switch import OpticalSwitch

PORT = 9090
NAMESPACES = ('com.attocube.sen', 'com.attocube.ids')
METHOD_NOT_FOUND = -32601
GROUP_S = 2.0e-3
"""Requests of this time span are sent together when samples are closer than that."""
ZERO_SAMPLES = 16
STALE_S = 0.020
"""A sample whose answer comes this much after its time was taken we know not when: no signal."""
LATE_S = 0.05
"""A block that begins later than this after the last one's end starts a new time grid."""


class Ids3010:
    """Client of one IDS3010 whose first ``beams`` axes look at the mirror.

    ``newline``: end each request with one (the device takes both).  ``switch``: what
    routes the laser where several machines share it (:class:`OpticalSwitch`), if there is one.
    """

    def __init__(self, host: str, port: int = PORT, beams: int = 1, timeout_s: float = 5.0,
                 newline: bool = True, switch: OpticalSwitch | None = None):
        if not 1 <= beams <= 3:
            raise DeviceError(f'interferometer at {host}:{port}: has 1 to 3 beams, not {beams}')
        self._link = Link('interferometer', host, port, timeout_s)
        self._beams = beams
        self._timeout_s = timeout_s
        self._end = b'\n' if newline else b''
        self._switch = switch
        self._stream = JsonStream()
        self._waiting: deque[dict] = deque()
        self._next_id = self._expected_id = 1
        self._namespace = NAMESPACES[0]
        self._zero_pm = np.zeros(beams)
        self._index_method = 'com.attocube.ecu.getRefractiveIndexForCompensation'
        self._next_s: float | None = None

    @property
    def namespace(self) -> str:
        """The firmware's namespace, as found on connecting."""
        return self._namespace

    def connect(self) -> None:
        self._link.open()
        self._stream, self._next_s = JsonStream(), None
        self._waiting.clear()
        self._expected_id = self._next_id
        for self._namespace in NAMESPACES:
            answer = self._ask(f'{self._namespace}.system.getCurrentMode')
            if 'result' in answer:
                break
        else:
            raise self._link.fail('knows neither com.attocube.sen nor com.attocube.ids; '
                                  'is it an IDS3010?')
        self._start_measuring(answer)

    def _start_measuring(self, answer: dict) -> None:
        end = time.monotonic() + max(self._timeout_s, 30.0)
        started = False
        while (mode := str(self._result(answer)[-1])) != 'measurement running':
            if time.monotonic() > end:
                raise self._link.fail(f'does not start to measure, its mode is {mode!r}; '
                                      'align the beams')
            if mode == 'system idle' and not started:
                self._call(f'{self._namespace}.system.startMeasurement')
                started = True
            time.sleep(0.05)
            answer = {'result': self._call(f'{self._namespace}.system.getCurrentMode')}

    def close(self) -> None:
        self._link.close()
        if self._switch is not None:
            self._switch.close()

    def select_setup(self, name: str) -> None:
        pass   # one head looks at every setup of a machine; its base unit is moved by hand

    def select_machine(self, name: str) -> None:
        """Route the laser to another machine; without a switch there is only one."""
        if self._switch is not None:
            self._switch.connect()
            self._switch.select(name)

    def reset(self) -> None:
        self._call(f'{self._namespace}.system.resetAxes')
        # Whether the device counts absolute positions from the reset on depends on its
        # firmware; a mean of its own readings is the zero in both cases.
        method = f'{self._namespace}.displacement.getAbsolutePositions'
        self._link.send(b''.join(self._encode(method) for _ in range(ZERO_SAMPLES)))
        rows = [self._row(answer) for answer in self._answers(ZERO_SAMPLES)]
        self._zero_pm = self._table(rows)[:, 1:].mean(axis=0)
        self._next_s = None   # the grid begins anew: what is read next was not due meanwhile

    def read_block(self, samples: int, period_s: float) -> DisplacementBlock:
        method = f'{self._namespace}.displacement.getAbsolutePositions'
        begin = self._begin(samples * period_s)
        group = max(1, round(GROUP_S / period_s))
        rows: list[list[float]] = []
        arrived: list[float] = []
        sent = 0
        while sent < samples:
            count = min(group, samples - sent)
            self._wait_until(begin + (sent + count - 1) * period_s, rows, arrived)
            self._link.send(b''.join(self._encode(method) for _ in range(count)))
            sent += count
        # Once a block: how good the light was, and what index of air was divided out.
        axes = range(self._beams)
        self._link.send(b''.join(
            self._encode(f'{self._namespace}.displacement.getAxisSignalQuality', [axis])
            for axis in axes) + self._encode(self._index_method, [0]))
        rows.extend(self._row(answer) for answer in self._answers(samples - len(rows)))
        arrived += [HOST.now()] * (samples - len(arrived))
        contrast = min(self._number(self._result(answer)) for answer in self._answers(self._beams))
        index = self._index(self._answers(1)[0])
        self._next_s = begin + samples * period_s
        table = self._table(rows)
        stale = np.array(arrived) - (begin + np.arange(samples) * period_s) > STALE_S
        quality = np.where((table[:, 0] == 0.0) & ~stale, np.clip(round(contrast / 10.0), 0, 100), 0)
        return DisplacementBlock(round(begin * 1e9), period_s,
                                 (table[:, 1:] - self._zero_pm) * 1e-12,
                                 quality.astype(np.uint8), index)

    def shift_time(self, step_s: float) -> None:
        """The host's clock has jumped by ``step_s`` [s] since the last block."""
        if self._next_s is not None:
            self._next_s += step_s

    def _begin(self, length_s: float) -> float:
        """Time [s] of a block's first sample: seamless after the last block where that is possible."""
        now = HOST.now()
        if self._next_s is not None and -length_s < now - self._next_s < LATE_S:
            return self._next_s
        return now

    def _wait_until(self, due_s: float, rows: list, arrived: list[float]) -> None:
        """Until ``due_s`` take in answers and when they came."""
        while (left := due_s - HOST.now()) > 0.0:
            data = self._link.receive(wait_s=left)
            if data:
                self._take(data)
                while self._waiting:
                    rows.append(self._row(self._waiting.popleft()))
                    arrived.append(HOST.now())

    def environment(self) -> dict[str, float]:
        readings = {}
        for name, method, scale in (('air_temperature', 'getTemperatureInDegrees', 1.0),
                                    ('air_pressure', 'getPressureInHPa', 100.0),
                                    ('humidity', 'getHumidityInPercent', 0.01)):
            answer = self._ask(f'com.attocube.ecu.{method}')
            result = answer.get('result')
            # Without an environmental unit the device answers with an error: no sensor.
            if isinstance(result, list) and len(result) > 1 and not result[0] \
                    and isinstance(result[1], int | float):
                readings[name] = self._number(result) * scale
        return readings

    def _index(self, answer: dict) -> float:
        error = answer.get('error')
        if isinstance(error, dict) and error.get('code') == METHOD_NOT_FOUND \
                and self._index_method.endswith('ForCompensation'):
            self._index_method = 'com.attocube.ecu.getRefractiveIndex'
            answer = self._ask(self._index_method)
        result = answer.get('result')
        if not (isinstance(result, list) and len(result) > 1):
            return 1.0
        index = self._number(result)
        if not 0.999 < index < 1.01:
            raise self._link.fail(f'reports a refractive index of {index!r}; check its sensors')
        return index

    def _row(self, answer: dict) -> list[float]:
        result = self._result(answer)
        if len(result) < 1 + self._beams:
            raise self._link.fail(f'answers {len(result) - 1} positions, {self._beams} are needed')
        return result[:1 + self._beams]

    def _table(self, rows: list[list[float]]) -> np.ndarray:
        try:
            table = np.array(rows, float)
        except (TypeError, ValueError, OverflowError):
            raise self._link.fail('answers nonsense (positions that are no numbers); '
                                  'restart it') from None
        if not np.all(np.isfinite(table)):
            raise self._link.fail('answers positions that are not finite; restart it')
        return table

    def _number(self, result: list) -> float:
        """The first number of an answer, behind its error number."""
        try:
            value = float(result[1])
        except (IndexError, TypeError, ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            raise self._link.fail(f'answers nonsense ({str(result)[:60]!r} where a number belongs); restart it')
        return value

    def _encode(self, method: str, params: list | None = None) -> bytes:
        number, self._next_id = self._next_id, self._next_id + 1
        return b'{"jsonrpc":"2.0","method":"%s","params":%s,"id":%d,"api":2}%s' % (
            method.encode(), str(params or []).encode(), number, self._end)

    def _ask(self, method: str, params: list | None = None) -> dict:
        self._link.send(self._encode(method, params))
        return self._answers(1)[0]

    def _call(self, method: str, params: list | None = None) -> list:
        return self._result(self._ask(method, params))

    def _take(self, data: bytes) -> None:
        try:
            answers = self._stream.feed(data)
        except ValueError as error:
            raise self._link.fail(f'answers nonsense ({error}); restart it') from None
        for answer in answers:
            if not isinstance(answer, dict) or answer.get('id') != self._expected_id:
                raise self._link.fail(f'answers nonsense ({str(answer)[:60]!r} to request '
                                      f'{self._expected_id}); restart it')
            self._expected_id += 1
        self._waiting.extend(answers)

    def _answers(self, count: int) -> list[dict]:
        while len(self._waiting) < count:
            self._take(self._link.receive())
        return [self._waiting.popleft() for _ in range(count)]

    def _result(self, answer: dict) -> list:
        if 'error' in answer:
            error = answer['error']
            text = error.get('message', error) if isinstance(error, dict) else error
            raise self._link.fail(f'refuses a request: {" ".join(str(text)[:200].split())}')
        result = answer.get('result')
        if not isinstance(result, list) or not result \
                or not all(isinstance(value, int | float | str | bool) for value in result):
            raise self._link.fail(f'answers nonsense ({str(answer)[:60]!r}); restart it')
        return result
