"""Contract messages as CDR bytes, without ROS.

One function a message type.  Times are integer nanoseconds since the epoch.
Little-endian XCDR1 unless ``order='>'``, as ROS 2 middlewares send it.
"""

import struct
from collections.abc import Sequence

import numpy as np

_NS = 1_000_000_000


class CdrWriter:
    """Appends primitives with XCDR1 alignment behind an encapsulation header."""

    def __init__(self, order: str = '<'):
        self.order = order
        self.data = bytearray(b'\x00\x01\x00\x00' if order == '<' else b'\x00\x00\x00\x00')

    def align(self, size: int) -> None:
        self.data += b'\x00' * ((4 - len(self.data)) % size)

    def put(self, code: str, *values: float) -> 'CdrWriter':
        """Scalars of one :mod:`struct` code."""
        self.align(struct.calcsize(code))
        self.data += struct.pack(f'{self.order}{len(values)}{code}', *values)
        return self

    def string(self, value: str) -> 'CdrWriter':
        raw = value.encode() + b'\x00'
        self.put('I', len(raw))
        self.data += raw
        return self

    def sequence(self, code: str, values: np.ndarray) -> 'CdrWriter':
        """An unbounded sequence; ``code`` as NumPy writes it (``f8``, ``u1``)."""
        array = np.ascontiguousarray(values, dtype=self.order + code)
        self.put('I', array.size)
        if array.size:
            self.align(array.itemsize)
            self.data += array.tobytes()
        return self

    def header(self, stamp_ns: int, frame_id: str) -> 'CdrWriter':
        seconds, rest = divmod(int(stamp_ns), _NS)
        return self.put('i', seconds).put('I', rest).string(frame_id)

    def bytes(self) -> bytes:
        return bytes(self.data)


def encode_string(text: str, order: str = '<') -> bytes:
    """``std_msgs/msg/String``."""
    return CdrWriter(order).string(text).bytes()


def encode_displacement(stamp_ns: int, setup: str, sample_period_s: float, displacement_m: np.ndarray,
                        refractive_index: float, quality: np.ndarray, order: str = '<') -> bytes:
    """``stepdiag_msgs/msg/Displacement``: ``displacement_m`` (n, beams), ``quality`` (n,) 0..100."""
    values = np.asarray(displacement_m, dtype=float)
    beams = 1 if values.ndim == 1 else values.shape[1]
    return (CdrWriter(order).header(stamp_ns, setup).put('d', sample_period_s).put('B', beams)
            .sequence('f8', values).put('d', refractive_index).sequence('u1', quality).bytes())


def encode_spot(stamp_ns: int, setup: str, sample_period_s: float, x_m: np.ndarray, y_m: np.ndarray,
                intensity_v: np.ndarray, order: str = '<') -> bytes:
    """``stepdiag_msgs/msg/SpotPosition``: three arrays (n,)."""
    return (CdrWriter(order).header(stamp_ns, setup).put('d', sample_period_s)
            .sequence('f8', x_m).sequence('f8', y_m).sequence('f8', intensity_v).bytes())


def encode_step(stamp_ns: int, run_id: str, setup: str, repeat: int, direction: int, index: int,
                axis: int, commanded_m: Sequence[float], phase: int, frame_id: str = 'machine',
                order: str = '<') -> bytes:
    """``stepdiag_msgs/msg/Step``."""
    return (CdrWriter(order).header(stamp_ns, frame_id).string(run_id).string(setup)
            .put('H', repeat).put('b', direction).put('H', index).put('B', axis)
            .put('d', *(float(c) for c in commanded_m)).put('B', phase).bytes())


def encode_scalar(stamp_ns: int, frame_id: str, value: float, variance: float = 0.0,
                  order: str = '<') -> bytes:
    """``sensor_msgs`` ``Temperature`` [°C], ``FluidPressure`` [Pa], ``RelativeHumidity`` [0..1]."""
    return CdrWriter(order).header(stamp_ns, frame_id).put('d', value, variance).bytes()


def encode_angles(stamp_ns: int, setup: str, azimuth_rad: float, elevation_rad: float, order: str = '<') -> bytes:
    """``geometry_msgs/msg/Vector3Stamped`` of a beam's angles."""
    return CdrWriter(order).header(stamp_ns, setup).put('d', azimuth_rad, elevation_rad, 0.0).bytes()


encode_temperature = encode_fluid_pressure = encode_relative_humidity = encode_scalar
