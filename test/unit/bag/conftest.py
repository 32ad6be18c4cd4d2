"""A small log with everything that a log can hold, and how two logs are compared."""

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest

from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import DONE, DWELL, MOVE, NONE, CalibrationLog, Samples, ScalarSeries, StepEvents

START = 1_790_000_000_000_000_000
SECOND = 1_000_000_000
TEXT = """
schema: 1
machine: {name: small, chain: FXYZ, volume: [0.8, 0.6, 0.5], tool: [0.0, 0.0, -0.15]}
plan: {steps: 1, order: XYZ, repeats: 1}
setups:
  ppp: {standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.8, stops: 2}
"""
#: run id, setup, direction, stops in the order of the visit
RUNS = (('ppp/0/+', 'ppp', 1, (0, 1, 2, 3)), ('ppp/0/-', 'ppp', -1, (3, 2, 1, 0)),
        ('lin_x/0/+', 'lin_x', 1, (0, 1)))
BLOCK = 5           # samples
PERIOD = 20_000_000     # ns


def build_log() -> CalibrationLog:
    """Ten dwells of one block each, sensors, all environment topics."""
    rng = np.random.default_rng(11)
    description = Description.from_yaml(TEXT)
    names = tuple(description.setups)
    events, times, setups = [], [], []
    now = START
    for run, (_, setup, direction, visits) in enumerate(RUNS):
        for number, index in enumerate(visits):
            axis = NONE if number == 0 else (index - 1 if direction > 0 else index) % 3
            dwell = now + SECOND // 2
            done = dwell + BLOCK * PERIOD
            for time, phase in ((now, MOVE), (dwell, DWELL), (done, DONE)):
                events.append((time, run, names.index(setup), direction, index, axis, phase))
            times.append(dwell + np.arange(BLOCK) * PERIOD)
            setups.append(names.index(setup))
            now = done + SECOND // 4
    time, run, setup, direction, index, axis, phase = (np.array(c, np.int64)
                                                       for c in zip(*events, strict=True))
    steps = StepEvents(time, tuple(r[0] for r in RUNS), run, names, setup, 0 * run, direction, index,
                       axis, rng.normal(size=(len(time), 3)), phase)
    at = np.concatenate(times)
    n = len(at)
    block, where = np.repeat(np.arange(len(setups)), BLOCK), np.repeat(setups, BLOCK)
    distance = Samples(at, rng.normal(0.1, 1e-6, (n, 1)), rng.integers(1, 101, n).astype(float),
                       np.full(n, 1.00027), names, where, block)
    spot = Samples(at, rng.normal(0.0, 1e-4, (n, 2)), rng.normal(2.5, 0.01, n), np.ones(n), names,
                   where, block)
    every = START + np.arange(4, dtype=np.int64) * 2 * SECOND
    environment = {key: ScalarSeries(every, rng.normal(level, 0.1, 4), np.full(4, 1e-4))
                   for key, level in (('air_temperature', 20.0), ('air_pressure', 101_325.0),
                                      ('humidity', 0.5), ('scale_temperature/x', 20.1),
                                      ('scale_temperature/y', 20.2), ('scale_temperature/z', 20.3))}
    return CalibrationLog(description, steps, distance, spot, environment, 'small', '/cell1')


def differences(a: CalibrationLog, b: CalibrationLog) -> list[str]:
    """Names of everything that is not bit-identical; source and warnings do not count."""
    found = [] if a.description == b.description else ['description']
    pairs = [('steps', a.steps, b.steps), ('displacement', a.displacement, b.displacement),
             ('spot', a.spot, b.spot)]
    if a.environment.keys() != b.environment.keys():
        found.append('environment keys')
    else:
        pairs += [(key, a.environment[key], b.environment[key]) for key in a.environment]
    for name, left, right in pairs:
        for field in (one for one in fields(left) if one.compare):
            x, y = getattr(left, field.name), getattr(right, field.name)
            same = x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes() \
                if isinstance(x, np.ndarray) else x == y
            if not same:
                found.append(f'{name}.{field.name}')
    return found


@pytest.fixture
def small_log() -> CalibrationLog:
    return build_log()


@pytest.fixture
def differs() -> Callable[[CalibrationLog, CalibrationLog], list[str]]:
    return differences


@pytest.fixture
def changed(small_log: CalibrationLog) -> Callable[..., CalibrationLog]:
    """The small log with whole arrays of one part replaced: ``changed('spot', values=…)``."""
    def change(part: str, **arrays) -> CalibrationLog:
        return replace(small_log, **{part: replace(getattr(small_log, part), **arrays)})
    return change
