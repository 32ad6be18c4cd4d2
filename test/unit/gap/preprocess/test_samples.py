"""Samples that are no readings are left out, and nothing else is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.estimate.samples import clean, quantum
from stepdiag_ros.gap import diagnose


def cleaned(log, values):
    """What is left of a log with other lengths ``values``, and what is said of it."""
    return clean(replace(log, displacement=replace(log.displacement, values=values)))


def left_out(log):
    """Numbers of the samples of the lengths that are left out."""
    return np.flatnonzero(np.isnan(log.displacement.values[:, 0]))


def test_a_tidy_log_is_left_as_it_is(case):
    log = case.log(effect_class('servo_settling')(amp=5e-6, tau=0.02))
    found, words = clean(log)
    assert not words
    assert np.array_equal(found.displacement.values, log.displacement.values)
    assert np.array_equal(found.spot.values, log.spot.values)


def test_spots_without_light_are_no_readings(case):
    """A detector without light reads anything: here its middle."""
    log = case.log()
    dark = np.random.default_rng(1).random(len(log.spot)) < 0.08
    spot = replace(log.spot, values=np.where(dark[:, None], 0.0, log.spot.values),
                   health=np.where(dark, 1e-3, log.spot.health))
    found, words = clean(replace(log, spot=spot))
    assert np.array_equal(np.isnan(found.spot.values[:, 0]), dark)
    assert 'position sensor' in words[0] and 'without signal' in words[0]
    answer = diagnose(replace(log, spot=spot), [kind() for kind in all_effects().values()])
    gap = answer.cross_validation
    assert answer.verdict == 'no_gap' and gap.after_m < np.sqrt(2.0) * gap.floor_m


def test_readings_carried_over_from_before_the_move_are_none(case):
    """However many: a mean of a dwell in which one is left is off by millimetres.  In steps as well, and where these
    are so coarse that most neighbours that differ are in motion: how noisy samples are only dwells tell."""
    log = case.log()
    rows = reduce_log(log).displacement_rows
    for values in (log.displacement.values.copy(), *(np.round(log.displacement.values / step) * step
                                                     for step in (2e-9, 3e-8))):
        at = []
        for k, (lo, _) in enumerate(rows[1::9]):
            at += range(lo, lo + 1 + k % 3)
            values[lo:lo + 1 + k % 3] = values[lo - 1] = values[lo - 3]
        found, _ = cleaned(log, values)
        assert np.array_equal(left_out(found), np.sort(at))


def test_a_sample_read_again_under_way_is_none_though_readings_move_in_steps(case):
    """It is late by the time between two samples: at rest nobody can tell, and a clock seemed off by milliseconds."""
    log, step = case.log(), 2e-7
    tidy = reduce_log(log)
    values = np.round(log.spot.values / step) * step
    rng = np.random.default_rng(2)
    for k in np.flatnonzero(rng.random(len(values)) < 0.08):
        values[k] = values[k - 1]
    kept = clean(replace(log, spot=replace(log.spot, values=values)))[0].spot
    moving = np.ones(len(values), bool)
    for lo, hi in tidy.spot_rows:
        moving[lo:hi] = False
        assert np.isfinite(kept.values[lo + 3:hi]).all()
    # The axes go by micrometres from sample to sample in the middle of most moves; at their ends they creep.
    late = moving & np.append(False, (values[1:] == values[:-1]).all(axis=1))
    left = np.isnan(kept.values[:, 0])
    assert not np.any(left & moving & ~late) and np.mean(left[late]) > 0.5
    found = diagnose(replace(log, spot=replace(log.spot, values=values)), [kind() for kind in all_effects().values()])
    assert found.verdict == 'no_gap'


@pytest.mark.parametrize('left', [0, 1, 2, 5])
def test_hardly_any_sample_is_left_as_it_is(case, left):
    """A sensor that was dead, or a log cut after its first samples."""
    log = case.log()
    values = log.displacement.values.copy()
    values[left:] = np.nan
    found, _ = cleaned(log, values)
    assert np.array_equal(found.displacement.values, values, equal_nan=True)


def test_readings_that_stand_still_are_readings(case):
    """A dwell in which nothing changes is no instrument that was asked too soon."""
    log = case.log()
    values = log.displacement.values.copy()
    for lo, hi in reduce_log(log).displacement_rows:
        values[lo:hi] = values[lo]
    found, words = cleaned(log, values)
    assert np.isfinite(found.displacement.values).all() and not words


def test_an_evaluation_leaves_out_what_is_no_reading(case):
    """Duplicates and spikes in a few dwells made the machine's repeatability hundreds of times worse."""
    samples = '{duplicates: 0.04, spikes: 0.005, dropouts: 0.01, burst: 4}'
    law = f'{{displacement: {samples}, spot: {samples}}}'
    tidy, untidy = evaluate(case.log()), evaluate(case.untidy(law))
    assert untidy.status == tidy.status
    assert all(untidy.noise[name] < 1.3 * size for name, size in tidy.noise.items() if isinstance(size, float))
    assert any('repeating the reading before' in words for words in untidy.warnings)


@pytest.mark.parametrize('step', [0.0, 2e-7])
def test_a_driver_that_hangs_is_said_and_its_readings_are_none(case, step):
    """It sent its last spot again and again for a second, through a move and the dwell behind it, newly stamped; also
    where readings move in steps, and repeat themselves while the axes stand."""
    log = case.log()
    values, rows = log.spot.values.copy(), reduce_log(log).spot_rows
    values = np.round(values / step) * step if step else values
    begins = rows[[3, 11], 0] + 5
    ends = rows[[5, 12], 1]
    for begin, end in zip(begins, ends, strict=True):
        values[begin:end] = values[begin - 1]
    hung = replace(log, spot=replace(log.spot, values=values))
    found, words = clean(hung)
    # What stood before the first move may be a reading, where readings repeat themselves at rest.
    first = rows[[3, 11], 1] if step else begins
    assert all(np.isnan(found.spot.values[begin:end]).all() for begin, end in zip(first, ends, strict=True))
    time = log.spot.time_ns * 1e-9
    longest = max(time[end - 1] - time[begin - 1] for begin, end in zip(first, ends, strict=True))
    assert re.search(f'2 times for which it sent one reading again and again, {longest:.1f}.* s at most', words[0])
    assert diagnose(hung, [kind() for kind in all_effects().values()]).verdict == 'no_gap'


@pytest.mark.parametrize('size', [1, 20])
def test_what_a_driver_drew_between_two_blocks_is_no_reading(case, size):
    """It fills in the blocks that got lost, at rest and in moves."""
    log, rng = case.log(), np.random.default_rng(3)
    values, time = log.spot.values.copy(), (log.spot.time_ns - log.spot.time_ns[0]) * 1e-9
    lost = np.repeat(rng.random(len(values) // size + 1) < 0.1, size)[:len(values)]
    lost[[0, -1]] = False
    for k in range(2):
        values[lost, k] = np.interp(time[lost], time[~lost], values[~lost, k])
    filled = replace(log, spot=replace(log.spot, values=values))
    found, words = clean(filled)
    assert np.isnan(found.spot.values[lost]).mean() > 0.98 and np.isfinite(found.spot.values[~lost]).mean() > 0.99
    assert 'on straight lines' in words[0]
    assert diagnose(filled, [kind() for kind in all_effects().values()]).verdict == 'no_gap'


def test_a_log_without_intensity_is_believed(case):
    log = case.log()
    assert not clean(replace(log, spot=replace(log.spot, health=np.zeros(len(log.spot)))))[1]


def test_lone_spikes_are_found_at_the_ends_of_dwells_too(case):
    log = case.log()
    table = reduce_log(log)
    values, at = log.displacement.values.copy(), []
    for k, (lo, hi) in enumerate(table.displacement_rows[::5]):
        at.append((lo, hi - 1, (lo + hi) // 2)[k % 3])
    values[at] += 3e-7
    found, _ = cleaned(log, values)
    assert np.array_equal(left_out(found), np.sort(at))


@pytest.mark.parametrize('hertz', [2.0, 5.0, 8.0, 12.0])
def test_the_crest_of_a_swing_that_dies_away_is_no_spike(case, hertz):
    log = case.log()
    values = log.displacement.values.copy()
    for k, (lo, hi) in enumerate(reduce_log(log).displacement_rows):
        since = (log.displacement.time_ns[lo:hi] - log.displacement.time_ns[lo]) * 1e-9 + 0.02 * (k % 7) / 7.0
        values[lo:hi, 0] += 5e-6 * np.exp(-since / 0.1) * np.sin(2.0 * np.pi * hertz * since + k)
    found, words = cleaned(log, values)
    assert np.isfinite(found.displacement.values).all() and not words


def test_a_spike_that_was_read_twice_is_one(case):
    """Where readings move in steps neighbours are often equal: they tell nothing of what was asked for too soon."""
    log = case.log()
    values, at = np.round(log.displacement.values / 2e-9) * 2e-9, []
    for lo, hi in reduce_log(log).displacement_rows[::7]:
        at += [lo, lo + 1, (lo + hi) // 2, (lo + hi) // 2 + 1]
        for first in at[-4::2]:
            values[first:first + 2] = values[first] + 1e-6
    found, _ = cleaned(log, values)
    assert np.array_equal(left_out(found), np.sort(at))


def test_repeated_readings_are_left_out_but_not_readings_in_steps(case):
    log = case.log()
    table = reduce_log(log)
    values = log.spot.values.copy()
    lo = table.spot_rows[::3, 0] + 4
    values[lo] = values[lo - 1]
    found, words = clean(replace(log, spot=replace(log.spot, values=values)))
    assert np.array_equal(np.flatnonzero(np.isnan(found.spot.values[:, 0])), np.sort(lo)) and 'repeating' in words[0]
    coarse = np.round(log.spot.values / 3e-7) * 3e-7
    found, _ = clean(replace(log, spot=replace(log.spot, values=coarse)))
    assert np.isfinite(found.spot.values).all()


@pytest.mark.parametrize('width', [2e-8, 5e-8])
def test_steps_of_lengths_that_are_counted_from_each_reset(case, width):
    """Four and ten times as large as a sample's noise."""
    log = case.untidy(f'{{displacement: {{quantum: {width}}}}}')
    table = reduce_log(log)
    assert quantum(log.displacement, table.displacement_rows, table.run) == pytest.approx([width], rel=1e-3)
    assert not quantum(log.spot, table.spot_rows, table.run).any()
