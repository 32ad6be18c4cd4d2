"""LabJack T7: the part of its Modbus map and stream protocol that an analogue scan needs.

Registers and packets as in LabJack's T-series data sheet (Modbus map, *Low-Level
Stream*, *Internal Flash*); all numbers are big-endian.  In stream mode the box sends
raw 16-bit readings on a TCP port of its own; the constants that turn them into volts
lie in its flash memory.
"""

import struct
from dataclasses import dataclass

import numpy as np

CONTROL_PORT, STREAM_PORT = 502, 702

AIN0 = 0                          # AINn is at 2n, float32 [V]
AIN0_RANGE = 40000                # AINn_RANGE at 40000 + 2n, float32 [V]
AIN0_NEGATIVE_CH = 41000          # AINn_NEGATIVE_CH at 41000 + n, uint16
SINGLE_ENDED = 199
DAC0 = 1000                       # DACn at 1000 + 2n, float32 [V], 0 to 5 V in 12 bits
DAC_VOLTS, DAC_CODES = 5.0, 4096
STREAM_SCANRATE_HZ = 4002         # float32
STREAM_NUM_ADDRESSES = 4004       # uint32, as the following
STREAM_SAMPLES_PER_PACKET = 4006
STREAM_SETTLING_US = 4008         # float32
STREAM_RESOLUTION_INDEX = 4010
STREAM_BUFFER_SIZE_BYTES = 4012
STREAM_CLOCK_SOURCE = 4014
STREAM_AUTO_TARGET = 4016
STREAM_DATATYPE = 4018            # must be 0
STREAM_NUM_SCANS = 4020           # 0: until stopped
STREAM_START_TIME_STAMP = 4026    # uint32: CORE_TIMER at the stream's first scan
STREAM_SCANLIST_ADDRESS0 = 4100   # uint32 each
STREAM_ENABLE = 4990
TARGET_ETHERNET = 1
MAX_SAMPLES_PER_PACKET = 512

CORE_TIMER = 61520                # uint32: counts at CORE_HZ and begins again at 2**32
CORE_HZ = 40.0e6
CORE_TURN_S = 2**32 / CORE_HZ

INTERNAL_FLASH_READ_POINTER = 61810
INTERNAL_FLASH_READ = 61812
CALIBRATION_ADDRESS = 0x3C4000

FEEDBACK, STREAM_TYPE = 76, 16
STATUS_RECOVERY_ACTIVE, STATUS_RECOVERY_END = 2940, 2941
STATUS_SCAN_OVERLAP, STATUS_RECOVERY_OVERFLOW = 2942, 2943
HEADER = struct.Struct('>HHHBBBBHHH')
"""Transaction, protocol, length, unit, function, type, reserved, backlog, status, additional."""
SKIPPED = 0xFFFF


@dataclass(frozen=True)
class Calibration:
    """Volts from raw readings at one gain; the defaults are the nominal ones of ±10 V."""

    positive_slope: float = 0.000315805780
    negative_slope: float = -0.000315805800
    center: float = 33523.0
    offset: float = -10.586956522

    @classmethod
    def unpack(cls, flash: bytes) -> 'Calibration':
        """From the first 16 bytes at :data:`CALIBRATION_ADDRESS` (high speed, ±10 V)."""
        return cls(*struct.unpack('>4f', flash[:16]))

    def pack(self) -> bytes:
        return struct.pack('>4f', self.positive_slope, self.negative_slope, self.center, self.offset)

    def volts(self, raw: np.ndarray) -> np.ndarray:
        """Raw readings, any shape → [V]."""
        raw = np.asarray(raw, float)
        return np.where(raw < self.center, (self.center - raw) * self.negative_slope,
                        (raw - self.center) * self.positive_slope)

    def raw(self, volts: np.ndarray) -> np.ndarray:
        """[V] → raw readings as the converter gives them, uint16."""
        volts = np.asarray(volts, float)
        exact = np.where(volts < 0.0, self.center - volts / self.negative_slope,
                         self.center + volts / self.positive_slope)
        # The all-ones word marks scans that were skipped; no reading uses it.
        return np.clip(np.rint(exact), 0, SKIPPED - 1).astype('>u2')


@dataclass(frozen=True)
class Packet:
    """One stream packet: its running number, status, additional information, readings (m,) uint16."""

    transaction: int
    status: int
    additional: int
    raw: np.ndarray


def pack_packet(transaction: int, raw: np.ndarray, backlog: int = 0, status: int = 0,
                additional: int = 0) -> bytes:
    """A packet as the box sends it."""
    data = np.asarray(raw, '>u2').tobytes()
    return HEADER.pack(transaction & 0xFFFF, 0, HEADER.size - 6 + len(data), 1, FEEDBACK,
                       STREAM_TYPE, 0, min(backlog, 0xFFFF), status, additional) + data


class PacketStream:
    """Feed bytes from the stream port, take out whole packets."""

    def __init__(self) -> None:
        self._data = b''

    def feed(self, data: bytes) -> list[Packet]:
        """Packets completed by ``data``; :class:`ValueError` when these are none."""
        data = self._data + data
        packets, at = [], 0
        while len(data) - at >= HEADER.size:
            transaction, protocol, length, _, function, kind, _, _, status, additional = \
                HEADER.unpack_from(data, at)
            if protocol != 0 or function != FEEDBACK or kind != STREAM_TYPE \
                    or length < HEADER.size - 6 or length % 2:
                raise ValueError(f'{data[at:at + HEADER.size].hex()} is no stream packet')
            if len(data) - at < 6 + length:
                break
            raw = np.frombuffer(data, '>u2', (length + 6 - HEADER.size) // 2, at + HEADER.size)
            packets.append(Packet(transaction, status, additional, raw))
            at += 6 + length
        self._data = data[at:]
        return packets


def float_registers(value: float) -> list[int]:
    return list(struct.unpack('>2H', struct.pack('>f', value)))


def uint_registers(value: int) -> list[int]:
    return list(struct.unpack('>2H', struct.pack('>I', value)))


def uint(registers: list[int]) -> int:
    """A pair of registers → uint32."""
    return (registers[0] << 16) | registers[1]


def floats(registers: list[int]) -> np.ndarray:
    """Pairs of registers → float32 numbers."""
    with np.errstate(invalid='ignore'):   # a signalling NaN of a stranger is one like any other
        return np.array(registers, '>u2').view('>f4').astype(float)
