"""Arrivals with heavy tails or correlation are noise of another law, and causes stay causes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import Law, arrivals, run_covariance, sensor_noise
from stepdiag_ros.estimate.noise_law import Errors, Latent, weighed
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.inference.projection import Projection
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.arrival_law import as_it_is
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

T3 = '{position: {dof: 3}, angle: {dof: 3}}'
ALIKE = '{position: {correlation: 0.6}, angle: {correlation: 0.6}}'


def law_of(log):
    observation = observe(log)
    return as_it_is(Projection.of(observation.table, observation.fit, noise_of(observation)), observation.table)


def test_normal_independent_arrivals_stay_so(case):
    for seed in (1, 2):
        noise, gain = law_of(case.untidy('{}', seed=seed))
        assert noise.tidy and noise.spread is None and gain == 0.0


def test_tails_are_found_with_the_scale_that_was_drawn(case):
    noise, gain = law_of(case.untidy(T3, seed=2))
    assert gain > 40.0
    assert noise.position_law.dof <= 5.0 and noise.angle_law.dof <= 5.0
    # Drawn with standard deviations of 0.3 µm and 0.2 µrad: scales of those over √3.
    assert noise.position == pytest.approx(3e-7 / np.sqrt(3.0), rel=0.25)
    assert noise.angle == pytest.approx(2e-7 / np.sqrt(3.0), rel=0.25)
    assert noise.spread.shape == (5, noise.sensor.shape[0]) and noise.spread.max() > 3.0


def test_correlation_is_found_with_its_size(case):
    noise, gain = law_of(case.untidy(ALIKE, seed=2))
    assert gain > 40.0 and noise.angle_law.correlation in (0.45, 0.6, 0.75)
    assert noise.angle == pytest.approx(2e-7, rel=0.2)


def test_the_log_evidence_of_tails_is_that_of_the_integral():
    """One error alone, seen through normal noise: against the integral over Student's t."""
    dof, middle, wide = 4.0, 5.0, 0.3
    known = 1.0 / (1.0 + wide)   # 1/v = 1/V − 1, so 1 − V = 1/(1 + v)
    latent = Latent(np.zeros((1, 1)), np.eye(1), np.array([2]), [np.array([0])], slice(0, 1))
    errors = Errors(latent, np.array([middle * known]), np.array([1.0 - known]))
    noise = replace(_plain(), position_law=Law(dof))
    _, evidence, _, _ = weighed(noise, [errors], 1, 0)
    x = np.linspace(-60.0, 60.0, 200_001)
    density = np.trapezoid(stats.t.pdf(x, dof) * stats.norm.pdf(x, middle, np.sqrt(wide)), x)
    assert evidence == pytest.approx(np.log(density) - stats.norm.logpdf(middle, 0.0, np.sqrt(1.0 + wide)), abs=0.01)


def test_what_one_reading_shows_of_two_arrivals_is_far_off_once():
    """A way of two stops shows the difference of its arrivals: against the integral over both distributions."""
    dof, read = 2.5, 14.0
    noise, sources, stops = replace(_plain(2), position_law=Law(dof)), np.array([2, 2]), [np.array([0]), np.array([1])]
    for turn in range(9):
        sizes = np.ones(2) if noise.spread is None else noise.spread[2]
        white = sizes * np.array([1.0, -1.0]) / np.hypot(*sizes)
        latent = Latent(white[None], np.eye(2), sources, stops, slice(0, 1))
        errors = Errors(latent, white * read / np.hypot(*sizes), 1.0 - white**2)
        noise, evidence, _, _ = weighed(noise, [errors], 2, turn)
        total = stats.norm.logpdf(read, 0.0, np.hypot(*sizes)) + evidence
    x = np.linspace(-400.0, 400.0, 400_001)
    exact = np.log(np.trapezoid(stats.t.pdf(x, dof) * stats.t.pdf(x - read, dof), x))
    assert total == pytest.approx(exact, abs=1.0)   # either may be the one: ln 2
    assert max(noise.spread[2]) > 5.0 > 1.5 > min(noise.spread[2])


def _plain(stops=1):
    from stepdiag_ros.estimate.noise import NoiseModel
    return NoiseModel(3e-7, 2e-7, np.ones((stops, 3)), 'drawn')


def test_correlated_arrivals_by_drawing(case):
    """The covariance of a run against 20 000 drawn AR(1) arrivals."""
    observation = case.observe()
    table, arrival, rho = observation.table, observation.fit.arrival, 0.6
    rows = np.flatnonzero(table.run == 0)[:7]
    numbers, draws = arrivals(table), 20_000
    sensor = np.full((len(table), 3), 1e-9)
    covariance = run_covariance(rows, 3e-7, 0.0, sensor, arrival, numbers, (rho, 0.0))
    rng = np.random.default_rng(3)
    values = 1e-9 * rng.standard_normal((draws, len(rows), 3))
    for axis in range(3):
        # An arrival errs as the one before it did, whichever axis that moved: errors come and go with time.
        error = rng.standard_normal((draws, len(rows)))
        for k in range(1, error.shape[1]):
            error[:, k] = rho * error[:, k - 1] + np.sqrt(1.0 - rho**2) * error[:, k]
        last = np.maximum.accumulate(np.where((table.axis[rows] == axis) | (np.arange(len(rows)) == 0),
                                              np.arange(len(rows)), 0))
        values += 3e-7 * error[:, last, None] * arrival[2 + axis][rows]
    drawn = np.cov(values.reshape(draws, -1), rowvar=False)
    sigma = np.sqrt(np.diag(covariance))
    assert np.abs((drawn - covariance) / sigma[:, None] / sigma).max() < 0.05


@pytest.mark.parametrize(('law', 'seed'), some((T3, 3), later=[(ALIKE, 1)]))
def test_untidy_noise_is_no_cause(case, law, seed):
    """Both have been a cause of certainty 1.0 to a noise that was taken to be normal and independent."""
    found = diagnose(case.untidy(law, seed=seed), [kind() for kind in all_effects().values()])
    assert found.verdict == 'no_gap', (found.effects, found.unmodelled)
    assert not found.joint.noise.tidy
    assert any('noise:' in line for line in found.warnings)
    assert 0.8 < found.cross_validation.after < 1.25


@pytest.mark.parametrize(('law', 'arrival'), some(('{}', 20), later=[(T3, 25)]))
def test_a_slip_is_no_tail(case, law, arrival):
    """A step that stays makes tails where noise may have them; it is found all the same, in tidy noise and untidy."""
    slip = effect_class('count_slip')(jump=19 * 316.4e-9, arrival=arrival)
    found = diagnose(case.untidy(law, slip, seed=2), [kind() for kind in all_effects().values()])
    assert [e.name for e in found.effects] == ['count_slip'] and not found.unmodelled, found.unmodelled


@pytest.mark.long
def test_nothing_is_claimed_of_a_slip_that_is_an_outlier_as_well(case):
    """Three stops before the end of a run a slip is one arrival of one axis that is far off; heavy tails have these."""
    slip = effect_class('count_slip')(jump=19 * 316.4e-9, arrival=20)
    found = diagnose(case.untidy(T3, slip, seed=2), [kind() for kind in all_effects().values()])
    assert found.verdict == 'no_gap' and found.joint.noise.position_law.dof < 5.0



def test_spread_widens_only_what_it_says(case):
    observation = case.observe()
    noise = noise_of(observation)
    spread = np.ones((5, len(observation.table)))
    assert np.array_equal(noise.spread_of(observation.fit.arrival), observation.fit.arrival)
    wider = replace(noise, spread=2.0 * spread).spread_of(observation.fit.arrival)
    assert np.array_equal(wider, 2.0 * observation.fit.arrival)
    assert readings_of(observation.table).shape == wider.shape[1:]


def said_and_true(case, alike, step, dwell, seed=11):
    """What the means of a cell's dwells are said to err by, and what they truly do, each (beams + 2,) [m]: against the
    same cell once with silent sensors."""
    laws = ', '.join(f'{name}: {{correlation: {alike}, quantum: {step * sigma}}}'
                     for name, sigma in (('displacement', 5e-9), ('spot', 2e-7)))
    loud = reduce_log(case.untidy(f'{{{laws}}}', dwell=dwell, seed=seed))
    silent = reduce_log(simulate_log(parse_cell(
        case.text.replace('displacement: 5.0e-9', 'displacement: 0.0').replace('spot: 2.0e-7', 'spot: 0.0')
        .replace('dwell: 0.6', f'dwell: {dwell}').replace('seed: 11', f'seed: {seed}'))))
    truly = np.concatenate([loud.displacement - silent.displacement, loud.spot - silent.spot], axis=1).std(axis=0)
    return sensor_noise(loud, case.cell.description.noise).mean(axis=0), truly


@pytest.mark.parametrize(('alike', 'step', 'dwell', 'within'), [
    (0.0, 0.0, 0.6, 0.25), (0.3, 0.0, 0.6, 0.25), (0.6, 0.0, 0.6, 0.25), (0.8, 0.0, 0.6, 0.25), (0.7, 1.0, 0.6, 0.25),
    (0.7, 2.0, 0.6, 0.25), (0.7, 2.0, 0.4, 0.45), (0.0, 0.0, 0.12, 0.35), (0.7, 0.0, 0.12, 1.0)])
def test_a_dwells_mean_is_as_uncertain_as_samples_leave_it(case, alike, step, dwell, within):
    """Samples that go with those before them, in steps of so many times their noise, 30 a dwell and fewer.  Six samples
    hardly tell how alike they are, and one log of twenty in steps of twice their noise tells it to a fifth."""
    np.testing.assert_allclose(*said_and_true(case, alike, step, dwell), rtol=within)


def test_coarse_steps_bend_what_is_said_of_a_dwells_mean_little_on_the_average(case):
    """What one log of them tells loosely several tell well: no more than a quarter is bias."""
    ratios = [np.divide(*said_and_true(case, 0.7, 2.0, 0.4, seed)) for seed in range(8, 16)]
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, rtol=0.25)
