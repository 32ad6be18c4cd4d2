"""Lines in the dwells' samples: shaking is found, slow and smooth noise is not taken for it."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.noise.disturbances import disturbed
from stepdiag_ros.gap.noise.dwell_spectrum import dwell_spectrum, dwells_by_channel
from stepdiag_ros.gap.noise.incoherent_lines import find_lines
from stepdiag_ros.gap.preprocess.dwells import dwells_of
from stepdiag_ros.gap.preprocess.observe import observe

COUNT, SIZE, PERIOD_S = 300, 30, 0.02


def _dwells(extra=0.0, seed=3, begin=None):
    """White dwells of unit noise with ``extra`` (COUNT, SIZE) on top."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((COUNT, SIZE)) + extra
    rows = np.arange(COUNT)[:, None] * SIZE + np.array([0, SIZE])
    return dwells_of(values.ravel(), np.arange(values.size) * round(PERIOD_S * 1e9), rows,
                     np.arange(COUNT) % 12, rows[:, 0] * round(PERIOD_S * 1e9) if begin is None else begin)


def _line(frequency, amplitude, seed=5):
    phase = 2.0 * np.pi * np.random.default_rng(seed).random((COUNT, 1))
    return amplitude * np.sin(2.0 * np.pi * frequency * PERIOD_S * np.arange(SIZE) + phase)


def _pink(power, size, seed=7):
    """Stretches of noise with a spectrum f^-power, rms ``size`` inside a dwell."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(1 << 17)
    frequency[0] = frequency[1]
    series = np.fft.irfft(frequency ** (-power / 2.0) * np.exp(2j * np.pi * rng.random(len(frequency))))
    parts = series[:COUNT * 5 * SIZE].reshape(COUNT, -1)[:, :SIZE]
    parts = parts - parts.mean(axis=1, keepdims=True)
    return size * parts / parts.std()


def test_white_noise_has_no_line_and_no_background():
    evidence = [find_lines(_dwells(seed=seed)) for seed in range(12)]
    assert max(lines.log_bayes for lines, _ in evidence) < 5.0
    assert max(slow for _, slow in evidence) < 8.0


@pytest.mark.parametrize('frequency', [4.3, 11.7, 22.0, 24.6])
def test_a_line_well_below_the_noise_is_found(frequency):
    lines, _ = find_lines(_dwells(_line(frequency, 0.4)))
    assert lines.log_bayes > 12.0
    assert lines.frequency == pytest.approx(frequency, abs=0.5)
    assert lines.amplitude == pytest.approx(0.4, rel=0.3)


@pytest.mark.parametrize('power', [1.0, 2.0])
def test_noise_of_a_smooth_spectrum_is_no_line(power):
    lines, slow = find_lines(_dwells(_pink(power, 1.0)))
    assert slow > 50.0
    assert lines.log_bayes < 6.0
    lines, _ = find_lines(_dwells(_pink(power, 1.0) + _line(11.7, 0.6)))
    assert lines.log_bayes > 20.0


@pytest.mark.parametrize('alike', [0.3, 0.55, 0.68, 0.8])
def test_a_sensor_whose_neighbouring_samples_are_alike_has_no_line(alike):
    """Of much noise a form of the smooth spectrum that is a little off leaves a line at the lowest frequency."""
    noise = np.random.default_rng(4).standard_normal((COUNT, SIZE + 50))
    for k in range(1, SIZE + 50):
        noise[:, k] += alike * noise[:, k - 1]
    lines, slow = find_lines(_dwells(3.0 * noise[:, 50:]))
    assert slow > 50.0 and lines.log_bayes < 6.0


def test_what_every_move_leaves_behind_is_no_line():
    creep = np.exp(-np.arange(SIZE) / 4.0)[None] * np.where(np.arange(COUNT) % 12 < 6, 8.0, -5.0)[:, None]
    lines, slow = find_lines(_dwells(creep))
    assert lines.log_bayes < 6.0 and slow < 12.0


def test_a_swing_that_dies_out_is_no_line_though_it_is_sampled_later_in_each_dwell():
    later = np.random.default_rng(9).uniform(0.0, 1.0, (COUNT, 1))
    time = (np.arange(SIZE) + later) * PERIOD_S
    swing = np.exp(-time / 0.1) * np.cos(2.0 * np.pi * 5.0 * time)
    extra = swing * np.where(np.arange(COUNT) % 12 < 4, 30.0, 0.0)[:, None]
    begin = (np.arange(COUNT) * SIZE - later[:, 0]) * PERIOD_S * 1e9
    lines, slow = find_lines(_dwells(extra, begin=np.rint(begin).astype(np.int64)))
    assert lines.log_bayes < 6.0 and slow < 12.0


def test_a_dwell_of_six_samples_tells_a_line_from_noise():
    def short(extra):
        values = np.random.default_rng(3).standard_normal((COUNT, 6)) + extra[:, :6]
        begin = np.arange(COUNT) * 6
        return dwells_of(values.ravel(), np.arange(values.size) * round(PERIOD_S * 1e9),
                         begin[:, None] + np.array([0, 6]), np.arange(COUNT) % 12, begin * round(PERIOD_S * 1e9))
    assert find_lines(short(_line(12.0, 1.0)))[0].log_bayes > 8.0
    assert find_lines(short(np.zeros((COUNT, 6))))[0].log_bayes < 4.0
    assert find_lines(short(_pink(2.0, 2.0)))[0].log_bayes < 4.0


def _seen(log):
    table = reduce_log(log)
    away = table.displacement.mean(axis=1)
    return dwell_spectrum(dwells_by_channel(log, table), table.run, 0.2 + away - np.nanmin(away))


def _with(samples, extra):
    return replace(samples, values=samples.values + extra)


def test_shaking_is_told_from_hum_and_from_moving_air(case):
    log = case.log()
    assert not (_seen(log).shakes or _seen(log).mains_hum or _seen(log).turbulent)
    seconds = (log.displacement.time_ns - log.displacement.time_ns[0]) * 1e-9
    swing = np.sin(2.0 * np.pi * 9.0 * seconds)[:, None]
    assert _seen(replace(log, displacement=_with(log.displacement, 4e-8 * swing))).shakes
    hum = 2e-6 * np.sin(2.0 * np.pi * 9.0 * (log.spot.time_ns - log.spot.time_ns[0]) * 1e-9)
    seen = _seen(replace(log, spot=_with(log.spot, hum[:, None] * [1.0, 0.0])))
    assert seen.mains_hum and not seen.shakes
    path = 0.2 + log.displacement.values - log.displacement.values.min()
    seen = _seen(replace(log, displacement=_with(log.displacement, 8e-8 * swing * path)))
    assert seen.grows_with_path and not seen.shakes and not seen.mains_hum
    rng = np.random.default_rng(2)
    waves = np.exp(rng.uniform(np.log(0.02), np.log(5.0), 120))
    turbulence = np.sin(2.0 * np.pi * waves * seconds[:, None] + 7.0 * rng.random(120)).sum(axis=1)
    seen = _seen(replace(log, displacement=_with(log.displacement, 3e-8 * turbulence[:, None] * path)))
    assert seen.turbulent and not seen.shakes


def test_settling_is_not_taken_for_shaking(case):
    seen = _seen(case.log(effect_class('servo_settling')(amp=5e-6, tau=0.15)))
    assert not seen.shakes and not seen.turbulent


def test_hum_is_noise_of_the_spot_in_the_dwells_as_shaking_is_of_the_displacement(case):
    """Else effects would be fitted to it."""
    log = case.log()
    hum = 2e-6 * np.sin(2.0 * np.pi * 5.0 * (log.spot.time_ns - log.spot.time_ns[0]) * 1e-9)
    humming = replace(log, spot=_with(log.spot, hum[:, None] * [1.0, 0.0]))
    before = observe(humming)
    after, found = disturbed(humming, before)
    beams = humming.displacement.values.shape[1]
    assert found.dwell_spectrum.mains_hum
    grown = after.bin_sigma / before.bin_sigma
    assert np.nanmin(grown[:, beams]) > 1.2     # spot x; neither the lengths nor spot y
    assert np.nanmax(np.delete(grown, beams, axis=1)) == 1.0
