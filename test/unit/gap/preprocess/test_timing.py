"""What single samples show of clocks that disagree, and readings in steps."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.estimate.samples import clean, quantum
from stepdiag_ros.gap.preprocess.clocks import late_clocks, set_clocks
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.gap.preprocess.timing import _rest, apart, least_noise, step_noise, timing, well_timed
from stepdiag_ros.model.log import DWELL, Samples


def _seen(log):
    table = reduce_log(log)
    return timing(log.displacement, table, table.displacement)


def _stamped(samples, offset_s, drift_s=0.0):
    """Samples whose stamps are late by an offset that grows by a drift in the course of the log."""
    place = (samples.time_ns - samples.time_ns[0]) / np.ptp(samples.time_ns)
    late = np.rint(1e9 * (offset_s + drift_s * place)).astype(np.int64)
    return replace(samples, time_ns=samples.time_ns + late)


def _clocks(log):
    table = reduce_log(log)
    return {'interferometer': timing(log.displacement, table, table.displacement),
            'psd': timing(log.spot, table, table.spot)}, apart(log, table)


def test_a_quiet_log_shows_nothing(case):
    clock = _seen(case.log())
    # The control reports in position only after the axis has settled: the middle is seen early, never before
    # the command.
    assert abs(clock.offset) < 0.05 and clock.before == 0.0 and clock.after == 0.0
    assert clock.sooner == 0.0 and abs(clock.drift) < 5.0 * clock.drift_sigma
    assert late_clocks(*_clocks(case.log())) == {}


def test_both_sensors_early_show_motion_before_the_command(case):
    log = case.log()
    early = replace(log, displacement=_stamped(log.displacement, -0.03),
                    spot=_stamped(log.spot, -0.03))
    seen = late_clocks(*_clocks(early))
    assert seen['interferometer'].offset == pytest.approx(-0.03, abs=8e-3)


def test_a_clock_that_runs_wrong_shows_although_late_alone_would_not(case):
    log = case.log()
    late = replace(log, displacement=_stamped(log.displacement, 0.01),
                   spot=_stamped(log.spot, 0.01))
    assert late_clocks(*_clocks(late)) == {}  # a control that begins late looks the same
    wrong = replace(log, displacement=_stamped(log.displacement, 0.01, 2e-3),
                    spot=_stamped(log.spot, 0.01, 2e-3))
    assert late_clocks(*_clocks(wrong))['interferometer'].drift == pytest.approx(2e-3, rel=0.3)


def test_a_clock_that_runs_wrong_is_put_right_where_the_control_begins_its_moves_late(case):
    """Put right by the beginning of most moves the others would come into the dwells.  How late the clock is remains
    open, that it runs wrong does not."""
    log = case.log()
    steps = log.steps
    # Axes that move a fifth of a second after the command, X sooner, and a report that comes late.
    wait = np.where(steps.phase == DWELL, -150_000_000, np.where(steps.axis == 0, 40_000_000, 200_000_000))
    wrong = replace(log, steps=replace(steps, time_ns=steps.time_ns - wait),
                    displacement=_stamped(log.displacement, 0.01, 4e-3), spot=_stamped(log.spot, 0.01, 4e-3))
    _, _, clocks, late = set_clocks(wrong, observe(wrong))
    by = late['interferometer']
    assert clocks['interferometer'].onset > 0.15
    assert by.drift == pytest.approx(4e-3, rel=0.3) and abs(by.offset - 0.012) < 0.05 < by.sigma


def test_the_sensor_that_is_off_is_named(case):
    log = case.log()
    for sensor, channel in (('interferometer', 'displacement'), ('psd', 'spot')):
        late = replace(log, **{channel: _stamped(getattr(log, channel), 0.06)})
        seen = late_clocks(*_clocks(late))
        assert list(seen) == [sensor]
        assert seen[sensor].offset == pytest.approx(0.06, abs=0.01)


def test_moves_to_and_fro_tell_a_delay_from_a_bend(case):
    """Spots with noise of a micrometre tell a delay of 5 ms to a tenth of it, all moves together."""
    log = case.log()
    noise = 1e-6 * np.random.default_rng(4).standard_normal(log.spot.values.shape)
    spot = replace(_stamped(log.spot, -5e-3), values=log.spot.values + noise)
    delay, sigma = apart(replace(log, spot=spot), reduce_log(log))
    assert abs(delay + 5e-3) < 4.0 * sigma
    assert sigma < 5e-4


def test_moves_of_which_none_stands_out_tell_a_delay_together(case):
    """A spot whose noise is a tenth to a half of its moves."""
    log = case.log()
    table = reduce_log(log)
    rng, step = np.random.default_rng(4), float(np.nanmedian(np.abs(np.diff(table.spot, axis=0))))
    for delay in (0.0, 0.04):
        noise = 0.3 * step * rng.standard_normal(log.spot.values.shape)
        loud = replace(log, spot=replace(_stamped(log.spot, delay), values=log.spot.values + noise))
        seen, sigma = apart(loud, reduce_log(loud))
        assert abs(seen - delay) < 4.0 * sigma
        assert sigma < 6e-3


def test_a_delay_that_is_long_against_the_moves_is_measured_too(case):
    log = case.log()
    table = reduce_log(log)
    plain, sigma = apart(log, table)
    late = replace(log, spot=replace(log.spot, time_ns=log.spot.time_ns - 130_000_000))
    delay, _ = apart(late, table)
    assert delay - plain == pytest.approx(-0.13, abs=max(1e-3, 5.0 * sigma))


def test_the_next_moves_first_sample_in_a_dwell_tells_of_a_clock_and_is_no_spike(case):
    """Both sensors early, each in its own way; nothing else is found, and both offsets are as they are."""
    early = effect_class('clock_skew')(interferometer=-0.033, psd=-0.16)
    found = case.diagnose(early)
    assert [f.name for f in found.effects] == ['clock_skew'] and found.verdict == 'explained', found.unmodelled
    said = found.effects[0].parameters
    assert said['interferometer_s'] == pytest.approx(-0.033, abs=5e-3)
    assert said['psd_s'] == pytest.approx(-0.16, abs=5e-3)


@pytest.mark.parametrize('offset', [-0.08, 0.05])
def test_stamps_that_are_off_are_measured(case, offset):
    log = case.log()
    late = replace(log.displacement, time_ns=log.displacement.time_ns + round(offset * 1e9))
    clock, plain = _seen(replace(log, displacement=late)), _seen(log)
    assert clock.offset - plain.offset == pytest.approx(offset, abs=3e-3)


def test_readings_in_steps(case):
    log = case.log()
    table = reduce_log(log)
    assert np.all(quantum(log.spot, table.spot_rows, table.run) == 0.0)
    coarse = replace(log.spot, values=np.round(log.spot.values / 2e-6) * 2e-6)
    table = reduce_log(replace(log, spot=coarse))
    assert quantum(coarse, table.spot_rows, table.run) == pytest.approx([2e-6, 2e-6], rel=1e-6)


def test_a_length_in_steps_of_nanometres_over_moves_of_decimetres_is_no_clock(case):
    """The step is found although moves are millions of it; else a reading that flips by one is motion before the
    command."""
    # 5.395 nm; no difference of readings between half a metre and a metre is just that.
    log, width = case.log(), 48_593_063.4 * 2.0**-53
    # Noise of a tenth of the step: dwells see one level or two, most of the time the same one.
    exact = log.displacement.values - log.displacement.values % 1e-6
    noise = 0.1 * width * np.random.default_rng(8).standard_normal(exact.shape)
    counted = np.rint((0.51 + exact - exact.min() + noise) / width) * width
    steps = replace(log, displacement=replace(log.displacement, values=counted))
    table = reduce_log(steps)
    assert quantum(steps.displacement, table.displacement_rows, table.run) == pytest.approx(width, rel=1e-6)
    clocks, between = _clocks(steps)
    assert clocks['interferometer'].sooner == 0.0
    assert late_clocks(clocks, between) == {}


def test_a_reading_in_coarse_steps_is_known_no_better_than_the_step(case):
    log = case.log()
    table = reduce_log(log)
    width = 20.0 * log.description.noise.spot
    coarse = replace(log.spot, values=np.rint(log.spot.values / width) * width)
    found = quantum(coarse, table.spot_rows, table.run)
    assert found == pytest.approx(width, rel=1e-6)
    _, noise = _rest(coarse, table, least_noise(coarse, table.spot_rows, table.run), 5, 0)
    assert noise > width / 4.0


def test_a_few_samples_that_are_alike_are_not_without_noise(case):
    """Noise of nine tenths of a step: neighbours differ too often for the step to be told, and yet the middle samples
    of some dwells are all the same."""
    log, width = case.log(), 3.35e-9
    exact = log.displacement.values - log.displacement.values % 1e-6
    noise = 0.9 * width * np.random.default_rng(8).standard_normal(exact.shape)
    steps = replace(log, displacement=replace(log.displacement, values=np.rint((exact + noise) / width) * width))
    table = reduce_log(steps)
    rows = table.displacement_rows
    assert np.all(quantum(steps.displacement, rows, table.run) == 0.0)
    least = least_noise(steps.displacement, rows, table.run)
    assert least == pytest.approx(np.hypot(0.9, 12.0**-0.5) * width, rel=0.1)
    assert _rest(steps.displacement, table, least, 5, 0)[1] >= least[0]
    clocks, between = _clocks(steps)
    assert clocks['interferometer'].sooner == 0.0 and late_clocks(clocks, between) == {}


def test_samples_whose_time_is_not_known_are_no_reason_to_look_elsewhere(case):
    """What a busy computer stamped late is left out: the samples of a dwell stand in other rows then."""
    log = case.log()
    unsure = replace(log, **{name: replace(samples, uncertainty_ns=np.where(
        np.arange(len(samples)) % 2, 20_000_000, 10_000)) for name, samples in (
            ('displacement', log.displacement), ('spot', log.spot))})
    thin = replace(unsure, displacement=well_timed(unsure.displacement), spot=well_timed(unsure.spot))
    assert len(thin.spot) < 0.6 * len(log.spot)
    table = reduce_log(log)
    (delay, sigma), (thinned, more) = apart(log, table), apart(thin, table)
    assert abs(thinned - delay) < 4.0 * more and sigma < more < 3.0 * sigma


@pytest.mark.parametrize('sigma', [0.0, 0.1, 0.25])
def test_what_is_rounded_off_by_drawing(sigma):
    """Means of 400 samples at 4000 levels, rounded to steps of 2 µm, with noise of so many steps."""
    rng, width = np.random.default_rng(3), 2e-6
    level = 1e-4 * rng.random(4000)
    samples = level[:, None] + sigma * width * rng.standard_normal((4000, 400))
    rounded = width * np.rint(samples / width)
    off = rounded.mean(axis=1) - samples.mean(axis=1)
    white = np.mean(rounded.var(axis=1) + samples.var(axis=1)) / 400  # what averages out is counted elsewhere
    rows = 400 * np.arange(4000)[:, None] + [0, 400]
    flat, ones = rounded.reshape(-1, 1), np.ones(rounded.size)
    log = Samples(np.arange(rounded.size), flat, ones, ones, ('ppp',), np.zeros(rounded.size, int), ones)
    found = step_noise(log, rows, np.array([width]))[0]
    assert found == pytest.approx(float(np.mean(off**2)), rel=0.1, abs=1.2 * white)
    assert sigma or found == pytest.approx(width**2 / 12.0, rel=0.05)


def test_a_reading_that_is_repeated_in_motion_is_not_late(case):
    """One sample of twelve repeats the one before: the moves begin when they do, and all of them tell it."""
    plain = _seen(case.log())
    log, _ = clean(case.untidy('{displacement: {duplicates: 0.08}, spot: {duplicates: 0.08}}'))
    clock = _seen(log)
    assert clock.moves == plain.moves
    assert clock.onset == pytest.approx(plain.onset, abs=1e-3)
    delay, sigma = apart(log, reduce_log(log))
    assert abs(delay) < max(1e-3, 5.0 * sigma)
