"""From samples to stops."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.log import DONE, DWELL, MOVE, NONE, STOOD, CalibrationLog, Samples, StepEvents

SECOND = 1_000_000_000


@pytest.fixture
def log(plan_of):
    """Three stops of one run, one second apart, dwelling half of it, ten samples a second; values count up."""
    stops = 3
    times, phases, index = [], [], []
    for i in range(stops):
        times += [i * SECOND, i * SECOND + SECOND // 2, (i + 1) * SECOND - 1]
        phases += [MOVE, DWELL, DONE]
        index += [i] * 3
    m = len(times)
    steps = StepEvents(np.array(times), ('ppp/0/+',), np.zeros(m, int), ('ppp',), np.zeros(m, int),
                       np.zeros(m, int), np.ones(m, int), np.array(index), np.repeat([NONE, 0, 1], 3),
                       np.repeat(np.arange(3.0)[:, None] * np.ones(3), 3, axis=0), np.array(phases))

    def samples(columns, health):
        time = np.arange(30) * SECOND // 10
        values = 1.0 + 1e-9 * np.arange(30)[:, None] * np.ones(columns)
        return Samples(time, values, np.full(30, health), np.full(30, 1.00027), ('ppp',),
                       np.zeros(30, int), np.arange(30) // 5)
    return CalibrationLog(plan_of(1, 1, names=('ppp',)), steps, samples(1, 80.0), samples(2, 4.0), source='made')


def test_means_over_the_dwell_only(log):
    table = reduce_log(log)
    # Samples at 0.5 … 0.9 s: numbers 5 … 9.
    assert table.displacement[:, 0] - 1.0 == pytest.approx([7e-9, 17e-9, 27e-9], rel=1e-6)
    assert table.displacement_count.tolist() == [5, 5, 5]
    assert table.displacement_rows.tolist() == [[5, 10], [15, 20], [25, 30]]
    assert table.displacement_scatter[0, 0] == pytest.approx(1e-9 / np.sqrt(2.0), rel=1e-5)
    assert np.all(table.refractive_index == pytest.approx(1.00027))
    assert np.all(table.intensity == 4.0)
    assert table.time_s == pytest.approx([0.25, 1.25, 2.25])
    assert not table.warnings


def test_the_end_of_a_dwell_is_left_out(log):
    """[DWELL, DONE): a sample stamped DONE belongs to the move."""
    steps = log.steps
    time = steps.time_ns.copy()
    time[2] = 9 * SECOND // 10
    table = reduce_log(replace(log, steps=replace(steps, time_ns=time)))
    assert table.displacement_count[0] == 4


def test_a_long_dwell_is_cut_where_that_is_asked_for(log):
    """The last of three dwells lasts twenty usual ones."""
    steps, long = log.steps, 10 * SECOND
    time = steps.time_ns.copy()
    time[-1] = time[-2] + long
    samples = [replace(part, time_ns=np.concatenate([part.time_ns[:25], np.linspace(
        2.5 * SECOND, 12.4 * SECOND, 5).astype(np.int64)])) for part in (log.displacement, log.spot)]
    longer = replace(log, steps=replace(steps, time_ns=time), displacement=samples[0], spot=samples[1])
    whole, cut = reduce_log(longer), reduce_log(longer, cut=True)
    pieces = long * 2 // SECOND
    assert len(whole) == 3 and len(cut) == 2 + pieces
    assert cut.axis.tolist() == [*whole.axis, *[STOOD] * (pieces - 1)] and (cut.index[2:] == 2).all()
    assert cut.dwell_ns[2] == whole.dwell_ns[2] and cut.done_ns[-1] == whole.done_ns[2]
    assert np.array_equal(cut.dwell_ns[3:], cut.done_ns[2:-1]) and (cut.move_ns[3:] == -1).all()
    assert cut.displacement_count[2:].sum() == whole.displacement_count[2] == 5
    # Usual dwells are left as they are.
    assert np.array_equal(reduce_log(log, cut=True).displacement, reduce_log(log).displacement)


def test_no_signal_and_no_number_are_left_out_and_told(log):
    health, values = log.displacement.health.copy(), log.displacement.values.copy()
    health[6], values[7] = 0, np.nan
    health[15:20] = 0
    table = reduce_log(replace(log, displacement=replace(log.displacement, health=health, values=values)))
    assert table.displacement_count.tolist() == [3, 0, 5]
    assert np.isnan(table.displacement[1, 0])
    assert np.isfinite(table.spot).all()
    assert any('7 dwell samples without signal' in w for w in table.warnings)
    assert any('1 of 3 dwells hold no usable sample' in w for w in table.warnings)


def test_samples_of_another_setup_do_not_count(log):
    samples = replace(log.displacement, setup_names=('ppp', 'npp'),
                      setup=np.where(np.arange(30) < 15, 0, 1))
    table = reduce_log(replace(log, displacement=samples))
    assert table.displacement_count.tolist() == [5, 0, 0]
    assert any("2 of 3 dwells hold no usable sample: e.g. in a dwell of setup ppp they bear the frame_id 'npp'" in w
               for w in table.warnings)


def test_stamps_by_another_clock_are_told(log):
    late = replace(log.displacement, time_ns=log.displacement.time_ns + 3600 * SECOND)
    [warning] = reduce_log(replace(log, displacement=late)).warnings
    assert '3 of 3 dwells hold no usable sample: they begin 3600 s after these, set the clocks' in warning


def test_stops_against_their_direction_are_told(log):
    turned = replace(log.steps, direction=-log.steps.direction)
    [warning] = reduce_log(replace(log, steps=turned)).warnings
    assert 'the stops of 1 run(s) come against their direction' in warning


def test_unfinished_dwells_and_second_visits(log):
    steps = log.steps
    cut = StepEvents(**{key: value[:-1] if isinstance(value, np.ndarray) else value
                        for key, value in vars(steps).items()})
    table = reduce_log(replace(log, steps=cut))
    assert len(table) == 2
    assert any('1 dwells never ended' in w for w in table.warnings)
    again = replace(steps, index=np.array([0, 0, 0, 1, 1, 1, 1, 1, 1]))
    table = reduce_log(replace(log, steps=again))
    assert len(table) == 2
    assert table.displacement[1, 0] - 1.0 == pytest.approx(27e-9, rel=1e-6)
    assert any('came twice' in w for w in table.warnings)


def test_a_dwell_without_its_move_is_a_stop_all_the_same(log):
    steps = log.steps
    late = StepEvents(**{key: value[1:] if isinstance(value, np.ndarray) else value
                         for key, value in vars(steps).items()})
    table = reduce_log(replace(log, steps=late))
    assert table.move_ns.tolist()[0] == -1
    assert len(table) == 3


def test_nothing_to_evaluate_is_said(log):
    none = StepEvents(**{key: value[:0] if isinstance(value, np.ndarray) else value
                         for key, value in vars(log.steps).items()})
    with pytest.raises(StepdiagError, match='holds no dwell'):
        reduce_log(replace(log, steps=none))
    with pytest.raises(StepdiagError, match='check the stamps of both'):
        reduce_log(replace(log, displacement=Samples.empty(1), spot=Samples.empty(2)))


def test_select_keeps_all_columns_together(log):
    table = reduce_log(log)
    part = table.select(np.array([True, False, True]))
    assert len(part) == 2
    assert part.index.tolist() == [0, 2]
    assert part.run_ids == table.run_ids


def test_an_axis_that_is_named_wrongly_is_mended_and_said(log):
    """The commanded positions say which axis moved, whatever the step names."""
    commanded = np.repeat(np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [0.8, 0.6, 0.0]]), 3, axis=0)
    steps = replace(log.steps, commanded=commanded, axis=np.repeat([NONE, 0, 1], 3))
    assert reduce_log(replace(log, steps=steps)).warnings == ()
    table = reduce_log(replace(log, steps=replace(steps, axis=np.repeat([NONE, NONE, 1], 3))))
    assert table.axis.tolist() == [NONE, 0, 1]
    assert '1 of 3 stops name another axis' in table.warnings[0]
