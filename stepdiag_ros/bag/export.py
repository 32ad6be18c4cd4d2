"""A whole :class:`CalibrationLog` as a bag: :func:`write_log`.

What is read back is bit-identical: samples whose times do not fit one period are
cut into blocks that do.
"""

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.codec import (
    encode_angles,
    encode_displacement,
    encode_scalar,
    encode_spot,
    encode_step,
    encode_string,
)
from stepdiag_ros.bag.qos import LATCHED, RELIABLE
from stepdiag_ros.bag.schemas import BEAM_ANGLE, DESCRIPTION, DISPLACEMENT, SCALE, SPOT, STEP, TOPICS, WORKPIECE
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import CalibrationLog, Samples, ScalarSeries, StepEvents

_NS = 1_000_000_000
PROGRESS_MESSAGES = 1000
"""Of one topic, between two words of progress."""
#: log time [ns], relative topic, stamp [ns], message
_Message = tuple[int, str, int, bytes]


def write_log(log: CalibrationLog, path: str | Path, block_samples: int | None = None,
              namespace: str | None = None, compression: str = 'zstd',
              custom_data: dict[str, str] | None = None,
              progress: Callable[[int, int], None] = lambda _done, _total: None) -> Path:
    """Write ``log`` as the rosbag2 directory ``path``; returns it.

    ``block_samples`` caps the samples of a block (``None``: the log's own blocks);
    ``namespace`` defaults to the log's own, else ``/cell1``.  A block is logged when
    its last sample is complete, as a recorder would receive it.  ``progress(done, total)`` is told now and then how
    many seconds of the log are written.
    """
    if block_samples is not None and block_samples < 1:
        raise StepdiagError(f'{path}: blocks of {block_samples} samples cannot be; give at least 1')
    prefix = '/' + (namespace if namespace is not None else log.namespace or 'cell1').strip('/')
    streams = {DESCRIPTION: _description(log), STEP: _steps(log.steps),
               DISPLACEMENT: _blocks(log.displacement, DISPLACEMENT, block_samples),
               SPOT: _blocks(log.spot, SPOT, block_samples)}
    if not len(log.spot):
        del streams[SPOT]
    if len(log.beam_angle):
        streams[BEAM_ANGLE] = _angles(log.beam_angle)
    for key in ('air_temperature', 'air_pressure', 'humidity'):
        if key in log.environment:
            streams[f'environment/{key}'] = _scalars(f'environment/{key}', {'air': log.environment[key]})
    scales = {a: log.environment[f'scale_temperature/{a}'] for a in (*'xyz', WORKPIECE)
              if f'scale_temperature/{a}' in log.environment}
    if scales:
        streams[SCALE] = _scalars(SCALE, scales)
    with BagWriter(path, live=False, compression=compression, custom_data=custom_data) as bag:
        for relative in streams:
            bag.add_topic(f'{prefix}/{relative}', TOPICS[relative],
                          LATCHED if relative == DESCRIPTION else RELIABLE)
        sequence = dict.fromkeys(streams, 0)
        merged = heapq.merge(*streams.values(), key=lambda message: message[0])
        begin, end = (log.steps.time_ns[[0, -1]].tolist() if len(log.steps) else (0, 1))
        for log_time, relative, stamp, data in merged:
            sequence[relative] += 1
            if sequence[relative] % PROGRESS_MESSAGES == 0:
                progress(round((log_time - begin) / _NS), round((end - begin) / _NS))
            bag.write(f'{prefix}/{relative}', data, log_time, stamp, sequence[relative])
    return Path(path)


def _description(log: CalibrationLog) -> Iterator[_Message]:
    starts = [int(a[0]) for a in (log.steps.time_ns, log.displacement.time_ns) if len(a)]
    start = min(starts, default=0)
    yield start, DESCRIPTION, start, encode_string(log.description.to_yaml())


def _steps(steps: StepEvents) -> Iterator[_Message]:
    for k in range(len(steps)):
        time = int(steps.time_ns[k])
        yield time, STEP, time, encode_step(
            time, steps.run_ids[steps.run[k]], steps.setup_names[steps.setup[k]],
            int(steps.repeat[k]), int(steps.direction[k]), int(steps.index[k]), int(steps.axis[k]),
            steps.commanded[k], int(steps.phase[k]))


def _scalars(topic: str, series: dict[str, ScalarSeries]) -> Iterator[_Message]:
    rows = sorted((int(s.time_ns[k]), frame, k) for frame, s in series.items()
                  for k in range(len(s.time_ns)))
    for time, frame, k in rows:
        yield time, topic, time, encode_scalar(time, frame, float(series[frame].value[k]),
                                               float(series[frame].variance[k]))


def _angles(angles: Samples) -> Iterator[_Message]:
    for time, setup, pair in zip(angles.time_ns.tolist(), angles.setup, angles.values.tolist(), strict=True):
        yield time, BEAM_ANGLE, time, encode_angles(time, angles.setup_names[setup], *pair)


def _blocks(samples: Samples, topic: str, most: int | None) -> Iterator[_Message]:
    """Messages of one sensor in order of time."""
    if not len(samples):
        return
    beams = np.isfinite(samples.values).sum(axis=1)
    changes = (np.diff(samples.block) != 0) | (np.diff(samples.setup) != 0) \
        | (np.diff(samples.refractive_index) != 0) | (np.diff(beams) != 0)
    edges = np.concatenate([[0], np.flatnonzero(changes) + 1, [len(samples)]])
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        for a, b, period in _uniform(samples.time_ns, int(begin), int(end), most):
            stamp = int(samples.time_ns[a])
            setup = samples.setup_names[samples.setup[a]]
            if topic == DISPLACEMENT:
                data = encode_displacement(stamp, setup, period, samples.values[a:b, :beams[a]],
                                           float(samples.refractive_index[a]), samples.health[a:b])
            else:
                data = encode_spot(stamp, setup, period, samples.values[a:b, 0],
                                   samples.values[a:b, 1], samples.health[a:b])
            yield int(samples.time_ns[b - 1]), topic, stamp, data


def _uniform(time: np.ndarray, begin: int, end: int, most: int | None) -> Iterator[tuple[int, int, float]]:
    """Cut ``begin:end`` into pieces that one sample period [s] describes to the nanosecond."""
    while begin < end:
        stop = end if most is None else min(end, begin + most)
        period = _period(time[begin:stop])
        if period is None:    # not evenly spaced: as far as the first spacing holds
            steps = np.diff(time[begin:stop])
            stop = begin + 1 + int(np.argmax(steps != steps[0])) if steps[0] > 0 else begin + 1
            period = _period(time[begin:stop])
        yield begin, stop, 1.0 if period is None else period
        begin = stop


def _period(time: np.ndarray) -> float | None:
    """Sample period [s] from which every time follows by rounding, ``None`` if there is none.

    Each time, known to half a nanosecond, allows an interval of periods; any period in
    the intersection will do, and the mean spacing, if it is in it, is what was meant.
    """
    if len(time) == 1:
        return 1.0
    number = np.arange(1, len(time))
    since = (time[1:] - time[0]).astype(float)
    low, high = ((since - 0.5) / number).max(), ((since + 0.5) / number).min()
    mean = since[-1] / number[-1]
    for period in (mean / _NS, (low + high) / 2.0 / _NS):
        if period > 0 and np.array_equal(
                np.rint(number * period * _NS).astype(np.int64), time[1:] - time[0]):
            return period
    return None
