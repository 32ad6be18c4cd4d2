"""The noise of a log from its repeats: what was drawn is found, what is no noise is not counted."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import (
    FLOOR_M,
    NoiseModel,
    arrivals,
    estimate_noise,
    lasting,
    run_covariance,
    sensor_noise,
    whiteners,
)
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.log import NONE, STOOD
from stepdiag_ros.model.machine import GeometricErrors


@pytest.fixture
def case(plan_of):
    """A description, its table without readings, readings of a perfect machine, arrival derivatives."""
    description = plan_of(5, 3)
    table = planned_table(description)
    parameters = parameters_of(description, table)
    arrival = ForwardModel(description, table, parameters).jacobian(np.zeros(parameters.size))[2]
    return description, table, observe(description, table, GeometricErrors.zero()), arrival


def noisy(table, clean, arrival, rng, position=3e-7, angle=2e-7):
    sensor = np.full(clean.shape, 5e-10)
    sensor[:, -2:] = 2e-8
    values = clean.ravel().copy()
    for white in whiteners(table, NoiseModel(position, angle, sensor, 'drawn'), arrival, np.isfinite(clean)):
        values[white.rows] += white.factor @ rng.standard_normal(len(white.rows))
    out = filled(table, values.reshape(clean.shape))
    return replace(out, displacement_scatter=sensor[:, :-2] * 10.0, spot_scatter=sensor[:, -2:] * 10.0)


@pytest.mark.parametrize(('position', 'angle'), [(3e-7, 2e-7), (2e-8, 1e-6)])
def test_drawn_noise_is_found(case, position, angle):
    description, table, clean, arrival = case
    rng = np.random.default_rng(1)
    found = [estimate_noise(noisy(table, clean, arrival, rng, position, angle), description.noise, arrival)
             for _ in range(3)]
    assert found[0].source == 'repeats'
    # Some 400 degrees of freedom each, three logs: 2 % are one deviation.
    assert np.mean([n.position for n in found]) == pytest.approx(position, rel=0.12)
    assert np.mean([n.angle for n in found]) == pytest.approx(angle, rel=0.08)


def test_drift_and_a_jump_are_no_noise(case):
    description, table, clean, arrival = case
    drifting = noisy(table, clean, arrival, np.random.default_rng(2))
    time = table.time_s / table.time_s.max()
    shifted = drifting.displacement + 2e-5 * time[:, None] + 1e-5 * time[:, None]**2
    shifted[120:] += 2e-6
    found = estimate_noise(replace(drifting, displacement=shifted), description.noise, arrival)
    assert found.position == pytest.approx(3e-7, rel=0.3)


def test_errors_of_the_machine_and_backlash_are_no_noise(case, draw_errors):
    description, table, _, arrival = case
    clean = observe(description, table, draw_errors(description.machine, 5))
    clean[:, 0] += np.where(table.direction > 0, 0.0, 5e-6)
    found = estimate_noise(noisy(table, clean, arrival, np.random.default_rng(3)), description.noise, arrival)
    assert found.position == pytest.approx(3e-7, rel=0.2)


def test_a_single_repeat_is_believed(case):
    description, table, clean, arrival = case
    one = noisy(table, clean, arrival, np.random.default_rng(4)).select(table.repeat == 0)
    found = estimate_noise(one, description.noise, arrival[:, table.repeat == 0])
    assert (found.source, found.dof) == ('belief', (0, 0))
    assert found.angle == description.noise.angle_repeatability


def test_sensor_noise_is_scatter_over_root_of_samples(case):
    description, table, *_ = case
    seen = sensor_noise(replace(table, displacement_scatter=np.full_like(table.displacement, 4e-9)),
                        description.noise)
    # The median of what hundred samples' neighbours differ by is half a percent below its root mean square.
    assert seen[:, 0] == pytest.approx(4.02e-10, rel=2e-3)
    assert seen[:, 1:] == pytest.approx(description.noise.spot / 10.0)     # no scatter seen: belief
    quiet = sensor_noise(replace(table, spot_scatter=np.zeros_like(table.spot)), description.noise)
    assert np.all(quiet[:, 1:] == FLOOR_M)


@pytest.mark.parametrize('count', [3, 6, 20])
def test_the_scatter_of_short_dwells_is_their_root_mean_square(case, count):
    description, table, *_ = case
    drawn = np.random.default_rng(8).normal(0.0, 4e-9, (len(table), count))
    scatter = np.sqrt(np.mean(np.diff(drawn, axis=1)**2, axis=1) / 2.0)
    alike = replace(table, displacement_scatter=scatter[:, None], displacement_parts=None,
                    displacement_count=np.full(len(table), count), setup=np.zeros_like(table.setup))
    seen = sensor_noise(alike, description.noise)
    assert np.median(seen[:, 0]) == pytest.approx(4e-9 / np.sqrt(count), rel=0.06)


def test_an_axis_rests_on_one_arrival_until_it_moves(case):
    _, table, *_ = case
    numbers = arrivals(table)
    run = np.flatnonzero(table.run == 0)
    moved = np.diff(numbers[run], axis=0) != 0
    for stop, axis in enumerate(table.axis[run][1:]):
        assert axis != NONE
        assert np.array_equal(moved[stop], np.arange(3) == axis)
    other = np.flatnonzero(table.run == 1)
    assert not np.intersect1d(numbers[run], numbers[other]).size
    holed = table.select(np.arange(len(table)) != 4)
    gap = np.diff(arrivals(holed)[holed.run == 0], axis=0)[3]
    assert np.all(gap != 0)


@pytest.mark.parametrize('stood', [(), (2, 3)])
def test_run_covariance_by_drawing(case, stood):
    """The covariance against 20 000 drawn arrivals; ``stood``: stops at which nothing had moved."""
    _, table, _, arrival = case
    rows = np.flatnonzero(table.run == 0)[:6]
    sensor = np.full((len(table), 3), 1e-9)
    axis = table.axis.copy()
    axis[rows[list(stood)]] = STOOD
    numbers = arrivals(replace(table, axis=axis))
    covariance = run_covariance(rows, 3e-7, 2e-7, sensor, arrival, numbers)
    rng, draws = np.random.default_rng(5), 20_000
    values = 1e-9 * rng.standard_normal((draws, 6, 3))
    for axis in range(3):
        _, own = np.unique(numbers[rows, axis], return_inverse=True)
        shift = 3e-7 * rng.standard_normal((draws, own.max() + 1))[:, own]
        values += shift[..., None] * arrival[2 + axis][rows]
    fresh = np.cumsum([stop not in stood for stop in range(6)]) - 1
    for k in range(2):
        values += 2e-7 * rng.standard_normal((draws, 6, 1))[:, fresh] * arrival[k][rows]
    drawn = np.cov(values.reshape(draws, -1), rowvar=False)
    sigma = np.sqrt(np.diag(covariance))
    assert np.abs((drawn - covariance) / sigma[:, None] / sigma).max() < 0.04


def test_whitened_noise_is_white(case):
    description, table, clean, arrival = case
    one = noisy(table, clean, arrival, np.random.default_rng(6))
    model = NoiseModel(3e-7, 2e-7, np.where(np.arange(3) < 1, 5e-10, 2e-8) * np.ones((len(table), 1)), 'drawn')
    rest = np.concatenate([one.displacement, one.spot], axis=1) - clean
    white = np.concatenate([w(rest.ravel()) for w in whiteners(table, model, arrival, np.isfinite(clean))])
    assert white.std() == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.06


def test_what_wanders_as_1_f_by_drawing(case):
    """Means over dwells of 2000 drawn series of noise as 1/f, waves of equal power in each e-fold."""
    _, table, _, _ = case
    rng, draws, waves = np.random.default_rng(6), 2000, 200
    power = np.linspace(1e-16, 4e-16, len(table))
    rows = np.flatnonzero(table.run == 1)[:8]
    begin, length = (table.dwell_ns - table.dwell_ns[0])[rows] * 1e-9, (table.done_ns - table.dwell_ns)[rows] * 1e-9
    slowest, fastest = 1.0 / np.ptp(table.time_s), 50.0 / length[0]
    frequency = slowest * (fastest / slowest) ** rng.random((draws, waves))
    phase = 2.0 * np.pi * rng.random((draws, waves))
    amplitude = np.sqrt(2.0 * np.log(fastest / slowest) / waves)
    values = np.zeros((draws, len(rows)))
    for k in range(len(rows)):
        middle = begin[k] + 0.5 * length[k]
        values[:, k] = amplitude * np.sqrt(power[rows[k]]) * np.sum(
            np.sinc(frequency * length[k]) * np.sin(2.0 * np.pi * frequency * middle + phase), axis=1)
    found = lasting(replace(table, wander=power), rows)
    sigma = np.sqrt(np.diag(found))
    assert np.abs((values.T @ values / draws - found) / sigma[:, None] / sigma).max() < 0.15
    assert found[0, 1] > 0.3 * found[0, 0]


def test_what_wanders_is_not_counted_as_arrivals(case):
    description, table, clean, arrival = case
    rng = np.random.default_rng(7)
    table = noisy(table, clean, arrival, rng, 1e-7)
    wander = np.full(len(table), 1e-15)
    values = table.displacement.copy()
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        drawn = rng.multivariate_normal(np.zeros(len(rows)), lasting(replace(table, wander=wander), rows))
        values[rows] += drawn[:, None]
    table = replace(table, displacement=values)
    assert estimate_noise(table, description.noise, arrival).position > 1.4e-7
    known = estimate_noise(replace(table, wander=wander), description.noise, arrival).position
    assert known == pytest.approx(1e-7, rel=0.3)


def test_repeats_of_five_targets_tell_the_noise_where_there_are_no_longer_ones(tmp_path):
    """A table of cycles with 20 µm of lost motion and a drift: neither is noise."""
    rng = np.random.default_rng(4)
    file = tmp_path / 'stage_x.csv'
    places = [(at, 1) for at in range(0, 50, 10)] + [(at, -1) for at in range(40, -10, -10)]
    file.write_text('cycle,direction,target_mm,measured_mm\n' + ''.join(
        f'{cycle},{sign},{at},{at + 0.01 * sign + 0.004 * cycle + 0.001 * rng.standard_normal()}\n'
        for cycle in range(1, 13) for at, sign in places))
    log = import_csv(file).log
    noise = fit(log.description, reduce_log(log)).noise
    assert noise.source == 'repeats' and noise.dof[0] == 44
    assert noise.position == pytest.approx(1e-6, rel=0.35)
