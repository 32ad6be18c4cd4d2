"""A PSD behind an analogue input box that speaks Modbus TCP (LabJack T7).

Two ways of reading the four photocurrents: ``stream`` lets the box sample by its own
clock and send packets, tens of thousands of scans a second; ``poll`` reads the inputs
by request, some hundreds a second, and works with any box that has float32 registers.

The stream's times are the box's own: its counter at the first scan, matched with our clock by reading the
counter now and then (LabJack, *Correlating Scan Times to Host Time*).
"""

import inspect
import logging
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from pymodbus.client import ModbusTcpClient

from stepdiag_ros.devices import t7
from stepdiag_ros.devices.base import DeviceError, SpotBlock
from stepdiag_ros.devices.hostclock import HOST
from stepdiag_ros.devices.link import FIRST_PAUSE_S, Link
from stepdiag_ros.devices.psd_signal import SpotOptics
from stepdiag_ros.devices.steering import Steering
from stepdiag_ros.devices.timing import GAP_PERIODS, Accuracy, ClockMatch, Grid, times_of_polls

CHANNELS = (0, 1, 2, 3)
PACKET_S = 5.0e-3
"""Packets of about this time span: short enough for steady stamps, long enough to be few."""
FIRST_MATCHES, MATCH_S = 8, 1.0
"""Readings of the box's counter when a stream begins, and time between two later ones."""
CLOCK_DRIFT = 1.0e-4
"""Of a box without a counter: how much slower [s/s] than ours its clock may be taken to run."""

# pymodbus called its unit `slave` before 3.10.
UNIT = next(name for name in ('device_id', 'slave')
            if name in inspect.signature(ModbusTcpClient.read_holding_registers).parameters)

# pymodbus logs what it also raises; the nodes say it once, in one line.
logging.getLogger('pymodbus').setLevel(logging.CRITICAL)


class ModbusPsd:
    """Client of one detector: ``channels`` are the inputs of I1…I4.

    ``mode``: ``stream`` or ``poll``.  ``optics`` says how currents become a spot, ``steering`` what turns the beam.
    """

    def __init__(self, host: str, port: int = t7.CONTROL_PORT, stream_port: int = t7.STREAM_PORT,
                 optics: SpotOptics | None = None, channels: tuple[int, ...] = CHANNELS,
                 mode: str = 'stream', timeout_s: float = 5.0, unit: int = 1, steering: Steering | None = None):
        if mode not in ('stream', 'poll'):
            raise DeviceError(f'PSD at {host}:{port}: mode is {mode!r}; choose stream or poll')
        self._where = f'PSD at {host}:{port}'
        self._address = (host, port)
        self._timeout_s = timeout_s
        self._optics = optics or SpotOptics()
        self._steering = steering or Steering()
        # Currents first, then the sensors of the mirrors' angles.
        self._channels = (*channels, *self._steering.inputs)
        self._mode = mode
        self._unit = unit
        self._client: ModbusTcpClient | None = None
        self._link = Link('PSD stream', host, stream_port, timeout_s)
        self._calibration = t7.Calibration()
        self._period_s = 0.0          # of the running stream; 0: none runs
        self._next_s: float | None = None
        self._grid = Grid()
        self._before_ns = 0          # when the last polled sample that was handed out was taken
        self._clock: ClockMatch | None = None
        self._origin_s = 0.0          # host's time of the stream's first scan, roughly

    def connect(self) -> None:
        if self._client is not None:
            return
        client = ModbusTcpClient(self._address[0], port=self._address[1], timeout=self._timeout_s,
                                 retries=0, reconnect_delay=0)
        for attempt in range(4):
            time.sleep(FIRST_PAUSE_S * 2.0 ** (attempt - 1) if attempt else 0.0)
            if client.connect():
                break
        else:
            raise DeviceError(f'{self._where}: cannot connect after 4 attempts; check that it is '
                              'switched on and that host and port are right')
        self._client = client
        if self._mode == 'stream':
            self._write(t7.STREAM_ENABLE, t7.uint_registers(0), must=False)
            self._write(t7.INTERNAL_FLASH_READ_POINTER, t7.uint_registers(t7.CALIBRATION_ADDRESS))
            constants = self._read(t7.INTERNAL_FLASH_READ, 8)
            self._calibration = t7.Calibration.unpack(np.array(constants, '>u2').tobytes())
            if not (1e-5 < self._calibration.positive_slope < 1e-2
                    and np.isfinite(self._calibration.volts(np.arange(4) * 20_000)).all()):
                raise self._fail('has no valid calibration constants in its flash; '
                                 'use mode poll or have it calibrated')

    def close(self) -> None:
        if self._client is not None:
            if self._period_s:
                try:
                    self._write(t7.STREAM_ENABLE, t7.uint_registers(0), must=False)
                except DeviceError:
                    pass   # it is gone already, and its stream with it
            if self._client is not None:
                self._client.close()
            self._client = None
        self._link.close()
        self._period_s, self._next_s = 0.0, None

    def read_block(self, samples: int, period_s: float) -> SpotBlock:
        if self._client is None:
            raise DeviceError(f'{self._where}: is not connected; connect first')
        read = self._streamed if self._mode == 'stream' else self._polled
        stamp_ns, spacing_s, volts, accuracy = read(samples, period_s)
        spot, intensity = self._optics.spot(volts[:, :4])
        angles = self._steering.sensed(volts[:, 4:]) if self._steering.inputs else None
        return SpotBlock(stamp_ns, spacing_s, spot[:, 0], spot[:, 1], intensity, accuracy, angles)

    def steer(self, angles: np.ndarray) -> None:
        """Command azimuth and elevation (2,) [rad] of the beam by the box's two outputs."""
        self._write(t7.DAC0, [word for volts in self._steering.command_volts(angles)
                              for word in t7.float_registers(float(volts))])

    def shift_time(self, step_s: float) -> None:
        """The host's clock has jumped by ``step_s`` [s] since the last block."""
        if self._next_s is not None:
            self._next_s += step_s
        self._origin_s += step_s
        self._before_ns = 0
        if self._clock is not None:
            self._clock.shift(step_s)

    # -- by request

    def _polled(self, samples: int, period_s: float) -> tuple[int, float, np.ndarray, Accuracy]:
        first, last = min(self._channels), max(self._channels)
        columns = [channel - first for channel in self._channels]
        volts, asked, answered, missed = [], [], [], 0
        end = time.monotonic() + (samples - 0.5) * period_s
        while len(volts) < samples and (not volts or time.monotonic() < end):
            missed += self._grid.wait(period_s)[1]
            if asked and not 0.0 <= HOST.now() - asked[-1] <= GAP_PERIODS * period_s:
                break   # the next block begins after the pause
            asked.append(HOST.now())
            volts.append(t7.floats(self._read(t7.AIN0 + 2 * first, 2 * (last - first + 1)))[columns])
            answered.append(HOST.now())
        if not np.all(np.isfinite(volts)):
            raise self._fail('answers voltages that are not finite; restart it')
        stamp_ns, spacing_s, accuracy = times_of_polls(asked, answered, period_s, missed, self._before_ns)
        self._before_ns = stamp_ns + int(accuracy.taken_ns[-1])
        return stamp_ns, spacing_s, np.array(volts), accuracy

    # -- by the box's own clock

    def _streamed(self, samples: int, period_s: float) -> tuple[int, float, np.ndarray, Accuracy]:
        stale = self._next_s is not None and \
            HOST.now() - self._next_s > max(1.0, 5.0 * samples * period_s)
        if self._period_s != period_s or stale:
            self._start_stream(period_s, samples)
        while len(self._raw) < samples:
            self._take(self._link.receive())
        if self._clock is not None and time.monotonic() >= self._match_s:
            self._match_clock()
        raw, self._raw = self._raw[:samples], self._raw[samples:]
        after_s = self._taken * period_s
        stamp, known = self._origin_s + after_s, 0.0
        if self._clock is not None:
            stamp, known = self._clock.ours(after_s), self._clock.uncertainty(after_s)
        self._taken += samples
        self._next_s = stamp + samples * period_s
        missed, self._missed = self._missed, 0
        return (round(stamp * 1e9), period_s, self._calibration.volts(raw),
                Accuracy(uncertainty_ns=np.array([round(known * 1e9)]), missed=missed))

    def _start_stream(self, period_s: float, samples: int) -> None:
        width = len(self._channels)
        self._write(t7.STREAM_ENABLE, t7.uint_registers(0), must=False)
        self._link.close()
        self._link.open()
        scans = int(np.clip(round(PACKET_S / period_s), 1,
                            min(samples, t7.MAX_SAMPLES_PER_PACKET // width)))
        for channel in self._channels:
            self._write(t7.AIN0_RANGE + 2 * channel, t7.float_registers(10.0))
            self._write(t7.AIN0_NEGATIVE_CH + channel, [t7.SINGLE_ENDED])
        self._write(t7.STREAM_SCANRATE_HZ, t7.float_registers(1.0 / period_s)
                    + t7.uint_registers(width) + t7.uint_registers(scans * width)
                    + t7.float_registers(0.0) + t7.uint_registers(0) + t7.uint_registers(0))
        self._write(t7.STREAM_AUTO_TARGET, t7.uint_registers(t7.TARGET_ETHERNET)
                    + t7.uint_registers(0) + t7.uint_registers(0))
        self._write(t7.STREAM_SCANLIST_ADDRESS0, [word for channel in self._channels
                                                  for word in t7.uint_registers(2 * channel)])
        self._packets = t7.PacketStream()
        self._raw = np.empty((0, width), '>u2')
        self._transaction = 0
        self._missed = 0      # scans that the box skipped
        self._taken = 0       # scans handed out
        self._arrived = 0     # scans received
        asked = HOST.now()
        self._write(t7.STREAM_ENABLE, t7.uint_registers(1))
        self._origin_s = 0.5 * (asked + HOST.now())
        self._period_s = period_s
        self._clock = None
        first = self._counter(t7.STREAM_START_TIME_STAMP)
        if first is not None and self._counter(t7.CORE_TIMER) is not None:
            self._first_scan, self._clock = first, ClockMatch()
            for _ in range(FIRST_MATCHES):
                self._match_clock()

    def _match_clock(self) -> None:
        """Read the box's counter; it begins anew every two minutes, which our clock can count."""
        asked = HOST.now()
        ticks = self._counter(t7.CORE_TIMER)
        answered = HOST.now()
        since = ((ticks - self._first_scan) % 2**32) / t7.CORE_HZ
        turns = round((0.5 * (asked + answered) - self._origin_s - since) / t7.CORE_TURN_S)
        self._clock.add(asked, since + turns * t7.CORE_TURN_S, answered)
        self._match_s = time.monotonic() + MATCH_S

    def _counter(self, address: int) -> int | None:
        """A register of the box's clock; None where the box has no such register."""
        answer = self._exchange(lambda: self._client.read_holding_registers(address, count=2, **{UNIT: self._unit}),
                                f'reading register {address}', 2, must=False)
        return None if answer.isError() else t7.uint(answer.registers)

    def _take(self, data: bytes) -> None:
        try:
            packets = self._packets.feed(data)
        except ValueError as error:
            raise self._fail(f'answers nonsense ({error}); restart it') from None
        for packet in packets:
            if packet.transaction != self._transaction & 0xFFFF:
                raise self._fail(f'lost stream packets between number {self._transaction & 0xFFFF} '
                                 f'and {packet.transaction}; reconnect')
            self._transaction += 1
            if packet.status in (t7.STATUS_SCAN_OVERLAP, t7.STATUS_RECOVERY_OVERFLOW):
                raise self._fail(f'cannot keep up (status {packet.status}); lower the sample rate')
            width = len(self._channels)
            scans = packet.raw[:len(packet.raw) // width * width].reshape(-1, width)
            scans = scans[~(scans == t7.SKIPPED).all(axis=1)]
            if packet.status == t7.STATUS_RECOVERY_END:
                # Scans are missing: a block never spans the gap.
                self._raw = scans[:0]
                self._arrived += packet.additional
                self._missed += packet.additional
                self._taken = self._arrived
            self._raw = np.concatenate([self._raw, scans])
            self._arrived += len(scans)
        if self._clock is None:
            self._follow_clock(self._link.arrived_s, len(packets))

    def _follow_clock(self, now: float, packets: int) -> None:
        """Bring the stream's origin in line with the host's clock, by when packets come.

        A packet cannot arrive before its last scan, so an early arrival pulls the origin
        back at once; a late one says little and lets it forward at the drift limit only.
        """
        if not packets:
            return
        excess = now - (self._arrived - 1) * self._period_s - self._origin_s
        limit = CLOCK_DRIFT * PACKET_S * packets
        self._origin_s += min(excess, limit)

    # -- Modbus

    def _read(self, address: int, count: int) -> list[int]:
        return self._exchange(lambda: self._client.read_holding_registers(
            address, count=count, **{UNIT: self._unit}), f'reading register {address}',
            count).registers

    def _write(self, address: int, registers: list[int], must: bool = True) -> None:
        self._exchange(lambda: self._client.write_registers(
            address, registers, **{UNIT: self._unit}), f'writing register {address}', must=must)

    def _exchange(self, request, what: str, count: int | None = None, must: bool = True):
        if self._client is None:
            raise DeviceError(f'{self._where}: is not connected; connect first')
        asked = time.monotonic()
        try:
            answer = request()
        except Exception as error:   # besides its own the library passes on what decoding a bad answer raises
            if time.monotonic() - asked > 0.8 * self._timeout_s:
                raise self._fail(f'stalls: no answer to {what} for {self._timeout_s:g} s; '
                                 'restart it') from None
            text = ' '.join(str(error).removeprefix('Modbus Error: ').split())[:200]
            raise self._fail(f'dropped the connection or answered nonsense while {what} '
                             f'({text}); reconnect') from None
        if answer.isError():
            if must:
                raise self._fail(f'refuses {what} ({answer}); is it a T7?')
        elif count is not None and len(getattr(answer, 'registers', ())) != count:
            raise self._fail(f'answers nonsense: {len(getattr(answer, "registers", ()))} registers for {count} '
                             f'while {what}; restart it')
        return answer

    def _fail(self, what: str) -> DeviceError:
        if self._client is not None:
            self._client.close()
            self._client = None
        self._link.close()
        self._period_s, self._next_s = 0.0, None
        return DeviceError(f'{self._where}: {what}')


def from_settings(settings: Mapping[str, Any]) -> ModbusPsd:
    """A client by the settings of the detector's node: ``host``, ``port``, ``stream_port``, ``optics``, ``channels``,
    ``mode``, ``timeout`` [s]; ``steering`` where a beam is steered."""
    return ModbusPsd(settings['host'], settings['port'], settings['stream_port'], settings['optics'],
                     settings['channels'], settings['mode'], settings['timeout'], steering=settings.get('steering'))
