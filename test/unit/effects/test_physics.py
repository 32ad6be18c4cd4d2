"""What shows inside the dwells and in the environment, not in the stops' means."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.model.log import DWELL
from stepdiag_ros.virtual.cell import Sampling
from stepdiag_ros.virtual.offline import simulate_log


def test_vibration_is_a_line_in_the_dwells_spectrum(bench):
    amp, frequency = np.array([3e-7, 0.0, 0.0]), 8.0
    effect = effect_class('vibration')(amp=amp, frequency=frequency)
    shaken = simulate_log(bench.cell, effects=[effect])
    time = (shaken.displacement.time_ns - shaken.displacement.time_ns[0]) * 1e-9
    change = (shaken.displacement.values - bench.log.displacement.values)[:, 0]
    # Seen along the line of sight: X's share of the diagonal, 0.5/√0.5.
    rows = shaken.displacement.setup == shaken.displacement.setup_names.index('ppp')
    part = np.cos(2 * np.pi * frequency * time[rows]), np.sin(2 * np.pi * frequency * time[rows])
    runs = np.cumsum(np.diff(time[rows], prepend=0.0) > 5.0)
    columns = np.stack([*part, *(1.0 * (runs == r) for r in np.unique(runs))], axis=1)
    found = np.linalg.lstsq(columns, change[rows], rcond=None)[0]
    assert np.hypot(found[0], found[1]) == pytest.approx(3e-7 * 0.5 / np.sqrt(0.5), rel=0.1)
    assert effect_class('vibration')().appearance(bench.view) == []


def test_clock_skew_shifts_the_samples_not_the_steps(bench):
    cell = replace(bench.cell, sampling=Sampling(200.0, 200.0, 0.1, True),
                   description=replace(bench.cell.description, noise=replace(
                       bench.cell.description.noise, displacement=0.0, spot=0.0)))
    plain = simulate_log(cell, setups=('ppp',))
    late = simulate_log(cell, setups=('ppp',),
                        effects=[effect_class('clock_skew')(interferometer=0.05, psd=0.0)])
    np.testing.assert_array_equal(late.steps.time_ns, plain.steps.time_ns)
    np.testing.assert_array_equal(late.spot.values, plain.spot.values)
    # Ten samples of 5 ms: every sample shows what was there 50 ms earlier.
    run = slice(200, 600)
    block = slice(190, 590)
    np.testing.assert_allclose(np.diff(late.displacement.values[run, 0]),
                               np.diff(plain.displacement.values[block, 0]), atol=2e-9)
    # A late stamp puts the end of the move into the dwell.
    start = plain.steps.time_ns[plain.steps.phase == DWELL][2]
    first = np.searchsorted(late.displacement.time_ns, start)
    creep = [np.ptp(log.displacement.values[first:first + 15, 0]) for log in (plain, late)]
    assert creep[1] > 1e-4 > 1e-7 > creep[0]


def test_sensors_show_the_air_that_the_reading_is_not_corrected_for(bench):
    effect = effect_class('air_refraction_drift')(dT=3.0, dP=300.0, tau=60.0)
    log = simulate_log(bench.cell, effects=[effect])
    assert log.environment['air_temperature'].value[-5:].mean() == pytest.approx(23.0, abs=0.1)
    assert log.environment['air_pressure'].value[-5:].mean() == pytest.approx(101625.0, abs=20.0)
    # The index that the instrument believes stays.
    np.testing.assert_array_equal(log.displacement.refractive_index,
                                  bench.log.displacement.refractive_index)


def test_scale_sensors_show_the_warming(bench):
    effect = effect_class('scale_thermal_expansion')(alpha=1e-5, dT=[2.0, 0.0, -1.0], tau=60.0)
    log = simulate_log(bench.cell, effects=[effect])
    last = [log.environment[f'scale_temperature/{axis}'].value[-5:].mean() for axis in 'xyz']
    np.testing.assert_allclose(last, [22.0, 20.0, 19.0], atol=0.1)


def test_settling_begins_when_the_control_says_in_position(bench):
    # A lag, and a smaller one that dies away four times as slowly.
    effect = effect_class('servo_settling')(amp=1e-6, tau=0.1, slow=[4e-7, 0.0, 0.0])
    log = simulate_log(bench.cell, setups=('lin_x',), effects=[effect])
    plain = simulate_log(bench.cell, setups=('lin_x',))
    start = log.steps.time_ns[log.steps.phase == DWELL][1]
    rows = np.searchsorted(log.displacement.time_ns, start) + np.arange(20)
    lag = (log.displacement.values - plain.displacement.values)[rows, 0]
    time = (log.displacement.time_ns[rows] - start) * 1e-9
    expected = -1e-6 * np.exp(-time / 0.1) - 4e-7 * np.exp(-time / 0.4)
    np.testing.assert_allclose(lag - lag[-1], expected - expected[-1], atol=2e-8)


def test_the_mount_gives_way_by_other_amounts_only_if_asked(bench):
    kind = effect_class('mirror_mount_creep')
    logs = [simulate_log(bench.cell, setups=('ppp', 'npp'), effects=[kind(amp=5e-5, tau=5.0, spread=s)])
            for s in (0.0, 0.5)]
    assert np.abs(logs[0].spot.values - logs[1].spot.values).max() > 1e-6
