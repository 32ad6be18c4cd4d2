"""Offsets between clocks, measured while a log is recorded, are taken off its stamps; so are steps of either clock."""

import numpy as np

from stepdiag_ros.bag.clockoffsets import ClockOffsets, offsets_of, put_on_one_clock
from stepdiag_ros.bag.schemas import CLOCK_OFFSET, CLOCK_STEP, DISPLACEMENT, SPOT, TOPICS
from stepdiag_ros.bag.tables import Group, TopicTable

SECOND = 1_000_000_000
BEGIN = 1_000 * SECOND


def table(of: str, stamp_ns, number, **columns) -> TopicTable:
    stamp, number = np.array(stamp_ns, np.int64), np.array(number)
    values = {'header.stamp.sec': stamp // SECOND, 'header.stamp.nanosec': stamp % SECOND,
              **{name: np.array(column) for name, column in columns.items()}}
    return TopicTable(of, TOPICS[of], count=len(stamp), groups=[Group(values, number, np.arange(len(stamp)) + 1)])


def records(stamp_ns, number, offset_s, uncertainty_s=1e-4, clock=b'a', sensor=b'psd') -> TopicTable:
    n = len(stamp_ns)
    return table(CLOCK_OFFSET, stamp_ns, number, **{'header.frame_id': [sensor] * n}, clock=[clock] * n,
                 reference=[b'b'] * n, offset=offset_s, uncertainty=[uncertainty_s] * n)


def stamps(of: TopicTable) -> np.ndarray:
    return of.groups[0].values['header.stamp.sec'] * SECOND + of.groups[0].values['header.stamp.nanosec']


def test_stamps_are_put_onto_the_sequencers_clock_drift_and_all():
    true = BEGIN + np.arange(0, 100 * SECOND, SECOND)
    ahead = 0.040 + 20e-6 * (true - BEGIN) / SECOND         # 40 ms, 20 ppm
    told = np.arange(0, 100, 5)
    tables = {SPOT: table(SPOT, true + np.rint(ahead * SECOND).astype(np.int64), np.arange(100)),
              DISPLACEMENT: table(DISPLACEMENT, true, np.arange(100)),
              CLOCK_OFFSET: records(true[told], 1000 + told, ahead[told])}
    offsets = offsets_of(tables)
    said = put_on_one_clock(tables, offsets)
    assert np.abs(stamps(tables[SPOT]) - true).max() < 100_000      # beyond the last comparison it stays as it was
    assert np.abs(stamps(tables[SPOT]) - true)[:96].max() <= 2
    np.testing.assert_array_equal(stamps(tables[DISPLACEMENT]), true)
    assert len(said) == 1 and said[0].startswith('psd: its clock was +40.000 ms at first and +41.900 ms at last')
    assert (offsets['psd'].uncertainty_at(true) == 100_000).all()


def test_one_clock_is_left_alone():
    true = BEGIN + np.arange(10) * SECOND
    tables = {SPOT: table(SPOT, true, np.arange(10)),
              CLOCK_OFFSET: records(true, 100 + np.arange(10), [3e-5] * 10, clock=b'b')}
    assert not put_on_one_clock(tables, offsets_of(tables))
    np.testing.assert_array_equal(stamps(tables[SPOT]), true)
    # One name for what is not one clock: what was measured counts.
    tables = {SPOT: table(SPOT, true + 40_000_000, np.arange(10)),
              CLOCK_OFFSET: records(true, 100 + np.arange(10), [0.040] * 10, clock=b'b')}
    assert put_on_one_clock(tables, offsets_of(tables))
    np.testing.assert_array_equal(stamps(tables[SPOT]), true)


def test_steps_of_either_clock_are_none_of_the_offset():
    """The driver's clock is set by −5 s, the sequencer's by 1 h; stamps of the log are brought back before."""
    seen = BEGIN + np.arange(8) * 10 * SECOND
    offset = np.full(8, 0.040)
    offset[3:] -= 5.0             # the driver's clock, between the third and the fourth comparison
    offset[3] += 2.5              # … which is still halfway in what was compared before
    offset[6:] -= 3600.0          # the sequencer's
    stamp = seen.copy()
    stamp[6:] += 3600 * SECOND
    number = np.arange(8) * 10
    steps = table(CLOCK_STEP, [seen[3] - 5 * SECOND, stamp[6]], [25, 59],
                  **{'header.frame_id': [b'psd_driver', b'step_sequencer']}, step=[-5.0, 3600.0],
                  topic=[SPOT.encode(), CLOCK_OFFSET.encode()], published=[0, 6])
    found = offsets_of({CLOCK_OFFSET: records(stamp, number, offset), CLOCK_STEP: steps})['psd']
    np.testing.assert_array_equal(found.time_ns, np.delete(seen, 3))
    assert np.abs(found.offset_ns - 40_000_000).max() <= 1000


def test_what_is_no_offset_is_passed_over():
    seen = BEGIN + np.arange(3) * SECOND
    assert not offsets_of({CLOCK_OFFSET: records(seen, [1, 2, 3], [np.nan, np.inf, 1e300])})
    assert not offsets_of({CLOCK_OFFSET: records(seen, [1, 2, 3], [0.1] * 3, uncertainty_s=float('nan'))})
    assert not offsets_of({CLOCK_OFFSET: records(seen, [1, 2, 3], [0.1] * 3, sensor=b'camera')})
    assert not offsets_of({})


def test_what_comes_after_the_last_step_changes_nothing():
    clock = ClockOffsets(BEGIN + np.arange(4) * SECOND, np.arange(4) * 1000, np.full(4, 10), False, np.arange(4))
    early = clock.until(BEGIN + SECOND)
    assert list(early.offset_ns) == [0, 1000] and len(clock.until(0).offset_ns) == 4
