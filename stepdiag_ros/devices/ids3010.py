"""attocube IDS3010: up to three interferometer axes over JSON-RPC 2.0 on TCP.

Methods and answers as in attocube's published Python and C interfaces: an answer's
``result`` begins with an error or warning number, positions follow in picometres.
Firmware before 1.9 has the methods in ``com.attocube.ids``, later one in
``com.attocube.sen``; which, is tried on connecting.

A request per sample and an answer per request would bound the rate by the round
trip.  Requests are therefore sent on the grid of the sample times without waiting, and the
answers read meanwhile.  The protocol has no time of a sample: it lies between request and
answer (:mod:`~stepdiag_ros.devices.timing`).
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.devices.base import DeviceError, DisplacementBlock
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.jsonstream import JsonStream
from stepdiag_ros.devices.link import Link
from stepdiag_ros.devices.optical_switch import OpticalSwitch
from stepdiag_ros.devices.timing import GAP_PERIODS, Grid, times_of_polls

PORT = 9090
NAMESPACES = ('com.attocube.sen', 'com.attocube.ids')
METHOD_NOT_FOUND = -32601
ENVIRONMENT = {'air_temperature': ('getTemperatureInDegrees', 1.0), 'air_pressure': ('getPressureInHPa', 100.0),
               'humidity': ('getHumidityInPercent', 0.01)}
"""Method and factor to SI (temperatures °C) of each reading of the environmental unit."""
GROUP_S = 1.0e-3
"""Requests of this time span are sent together when samples are closer than that."""
ZERO_SAMPLES = 16
HEALTH_S = 0.05
"""How often the quality of the light and the index of air are asked for."""
STALE_S = 0.020
"""A sample whose answer arrives this much after its request was taken we know not when: no signal."""
PAUSE_S = 0.05
"""Pause between two blocks after which the next one begins anew."""
MOST_OPEN = 100
"""Requests without an answer after which we wait for one."""


@dataclass
class _Block:
    """Polls of one block: when they were sent, what was answered when; ``until`` the time of the block's end."""

    until: float
    missed: int = 0
    asked: list[float] = field(default_factory=list)
    answered: list[float] = field(default_factory=list)
    answers: list[dict] = field(default_factory=list)
    closed: bool = False

    def take(self, answer: dict, arrived_s: float) -> None:
        self.answers.append(answer)
        self.answered.append(arrived_s)

    @property
    def complete(self) -> bool:
        return self.closed and len(self.answered) == len(self.asked)


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
        self._handlers: deque[Callable[[dict, float], None]] = deque()   # of answers that are to come
        self._next_id = self._expected_id = 1
        self._namespace = NAMESPACES[0]
        self._zero_pm = np.zeros(beams)
        self._index_method = 'com.attocube.ecu.getRefractiveIndexForCompensation'
        self._grid = Grid()
        self._blocks: deque[_Block] = deque()
        self._before_ns = 0          # when the last sample that was handed out was taken
        self._health_s = 0.0         # monotonic time of the next question for quality and index
        self._contrast, self._air = 0.0, 1.0

    @property
    def namespace(self) -> str:
        """The firmware's namespace, as found on connecting."""
        return self._namespace

    def connect(self) -> None:
        self._link.open()
        self._stream, self._grid, self._health_s = JsonStream(), Grid(), 0.0
        self._handlers.clear()
        self._blocks.clear()
        self._expected_id = self._next_id
        for self._namespace in NAMESPACES:
            answer = self._ask(f'{self._namespace}.system.getCurrentMode')
            if 'result' in answer:
                break
        else:
            raise self._link.fail('knows neither com.attocube.sen nor com.attocube.ids; '
                                  'is it an IDS3010?')
        self._start_measuring(answer)
        self._link.send(b''.join(self._ask_for_health()))
        self._finish()

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
        self._finish()   # one head looks at every setup of a machine; its base unit is moved by hand

    def select_machine(self, name: str) -> None:
        """Route the laser to another machine; without a switch there is only one."""
        if self._switch is not None:
            self._switch.connect()
            self._switch.select(name)

    def reset(self) -> None:
        self._finish()
        self._call(f'{self._namespace}.system.resetAxes')
        # Whether the device counts absolute positions from the reset on depends on its
        # firmware; a mean of its own readings is the zero in both cases.
        method = f'{self._namespace}.displacement.getAbsolutePositions'
        table = self._table([self._row(answer) for answer in self._ask_all([(method, [])] * ZERO_SAMPLES)])
        lit = table[:, 0] == 0.0
        self._zero_pm = table[lit if lit.any() else slice(None), 1:].mean(axis=0)

    def _finish(self) -> None:
        """Take in what is still to be answered, and forget it: it belongs to another zero."""
        while self._handlers:
            self._take(self._link.receive())
        self._blocks.clear()
        self._grid.forget()
        self._before_ns = 0

    def read_block(self, samples: int, period_s: float) -> DisplacementBlock:
        if self._blocks and HOST.now() - self._blocks[-1].asked[-1] > PAUSE_S:
            self._blocks.clear()   # nobody read for a while: what was asked before that is of no use now
            self._grid.forget()
        while not (self._blocks and self._blocks[0].complete):
            self._poll(samples, period_s)
        block = self._blocks.popleft()
        stamp_ns, spacing_s, accuracy = times_of_polls(block.asked, block.answered, period_s, block.missed,
                                                        self._before_ns)
        self._before_ns = stamp_ns + int(accuracy.taken_ns[-1])
        table = self._table([self._row(answer) for answer in block.answers])
        known = np.array(block.answered) - np.array(block.asked) <= STALE_S
        quality = np.where((table[:, 0] == 0.0) & known, np.clip(round(self._contrast / 10.0), 0, 100), 0)
        return DisplacementBlock(stamp_ns, spacing_s, (table[:, 1:] - self._zero_pm) * 1e-12,
                                 quality.astype(np.uint8), self._air, accuracy)

    def shift_time(self, _step_s: float) -> None:
        """The host's clock has jumped since the last block: what was asked by the old one is forgotten."""
        self._finish()

    def _poll(self, samples: int, period_s: float) -> None:
        """Ask for what is due next, and take in what has been answered."""
        while len(self._handlers) > MOST_OPEN:
            self._take(self._link.receive())
        count, missed = self._grid.wait(period_s, max(1, round(GROUP_S / period_s)))
        self._take(self._link.receive(wait_s=0.0))
        now, asked = time.monotonic(), HOST.now()
        block = self._blocks[-1] if self._blocks and not self._blocks[-1].closed else None
        if block is not None and (now >= block.until or asked - block.asked[-1] > GAP_PERIODS * period_s
                                  or asked < block.asked[-1]):
            block.closed, block = True, None
        if block is None:
            block = _Block(now + (samples - 0.5) * period_s)
            self._blocks.append(block)
        block.missed += missed
        block.asked += [asked] * count
        method = f'{self._namespace}.displacement.getAbsolutePositions'
        requests = [self._request(method, [], block.take) for _ in range(count)]
        if now >= self._health_s:
            self._health_s = now + HEALTH_S
            requests += self._ask_for_health()
        self._link.send(b''.join(requests))
        if len(block.asked) >= samples:
            block.closed = True

    def _ask_for_health(self) -> list[bytes]:
        """Requests: how good the light is in each beam, and what index of air is divided out."""
        contrasts: list[float] = []

        def contrast(answer: dict, _arrived: float) -> None:
            contrasts.append(self._number(self._result(answer)))
            if len(contrasts) == self._beams:
                self._contrast = min(contrasts)

        def index(answer: dict, _arrived: float) -> None:
            self._air = self._index(answer)
        return [self._request(f'{self._namespace}.displacement.getAxisSignalQuality', [axis], contrast)
                for axis in range(self._beams)] + [self._request(self._index_method, [0], index)]

    def environment(self) -> dict[str, float]:
        readings = {}
        answers = self._ask_all([(f'com.attocube.ecu.{method}', []) for method, _ in ENVIRONMENT.values()])
        for (name, (_, scale)), answer in zip(ENVIRONMENT.items(), answers, strict=True):
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
            self._index_method = 'com.attocube.ecu.getRefractiveIndex'   # of older firmware, from now on
            return self._air
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

    def _request(self, method: str, params: list, handler: Callable[[dict, float], None]) -> bytes:
        """A request to be sent; its answer and when that arrived [s] go to ``handler``."""
        number, self._next_id = self._next_id, self._next_id + 1
        self._handlers.append(handler)
        return b'{"jsonrpc":"2.0","method":"%s","params":%s,"id":%d,"api":2}%s' % (
            method.encode(), str(params).encode(), number, self._end)

    def _ask_all(self, questions: list[tuple[str, list]]) -> list[dict]:
        """Answers to methods with parameters, sent together."""
        answers: list[dict] = []
        self._link.send(b''.join(self._request(method, params, lambda answer, _arrived: answers.append(answer))
                                 for method, params in questions))
        while len(answers) < len(questions):
            self._take(self._link.receive())
        return answers

    def _ask(self, method: str, params: list | None = None) -> dict:
        return self._ask_all([(method, params or [])])[0]

    def _call(self, method: str, params: list | None = None) -> list:
        return self._result(self._ask(method, params))

    def _take(self, data: bytes) -> None:
        try:
            answers = self._stream.feed(data)
        except ValueError as error:
            raise self._link.fail(f'answers nonsense ({error}); restart it') from None
        arrived_s = self._link.arrived_s
        for answer in answers:
            if not isinstance(answer, dict) or answer.get('id') != self._expected_id or not self._handlers:
                raise self._link.fail(f'answers nonsense ({str(answer)[:60]!r} to request '
                                      f'{self._expected_id}); restart it')
            self._expected_id += 1
            self._handlers.popleft()(answer, arrived_s)

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


def from_settings(settings: Mapping[str, Any]) -> Ids3010:
    """A client by the settings ``host``, ``port``, ``beams``, ``timeout`` [s] of the interferometer's node."""
    return Ids3010(settings['host'], settings['port'], settings['beams'], settings['timeout'])
