"""Every effect's two faces against each other: what it does to a simulated log lies in the span of the
columns by which the diagnosis would know it, with the right size and sign."""

from functools import cache

import numpy as np
import pytest

from stepdiag_ros.effects import VOCABULARY, effect_class
from stepdiag_ros.effects.base import Form, StopView
from stepdiag_ros.effects.servo_settling import ServoSettling
from test.some import some


def drift_tau(view: StopView) -> float:
    """A time constant that is one of those tried."""
    return 0.25 * float(np.ptp(view.time))


def beginning(view: StopView, tau: float) -> float:
    """Share of an exponential drift, counted from the log's beginning to a dwell's, that its middle shows."""
    return float(np.exp(-view.bin_time[0].mean() / tau))


def pick(forms: list[Form], *words: str) -> Form:
    return next(form for form in forms if all(word in form.label for word in words))


def compare(bench, name: str, parameters: dict, *words: str, limit: float) -> np.ndarray:
    """Coefficients of the form whose label has ``words``; fails where more than ``limit`` remains."""
    kind = effect_class(name)
    acting = bench.with_effect(kind(**parameters))
    change = bench.change(acting)
    assert np.abs(change).max() > 1e-9
    # Topics and the sum signal are what the acting log says; the geometry is the same.
    found, left = bench.fitted(pick(kind().appearance(acting.view), *words), change)
    assert left < limit
    return found


def test_air_refraction_drift(bench):
    tau = drift_tau(bench.view)
    found = compare(bench, 'air_refraction_drift', {'dT': 1.0, 'dP': 200.0, 'tau': tau},
                    f'exponential, τ = {tau:.0f} s', limit=0.02)
    # Edlén's rule of thumb: −0.93e-6 a kelvin, +2.7e-9 a pascal.
    np.testing.assert_allclose(found, (-0.93e-6 + 200 * 2.68e-9) * beginning(bench.view, tau), rtol=0.08)


def test_air_that_was_logged_needs_no_course(bench):
    found = compare(bench, 'air_refraction_drift', {'dT': 4.0, 'dP': 0.0, 'tau': 100.0}, 'logged air',
                    limit=0.1)
    np.testing.assert_allclose(found, 1.0, rtol=0.05)


def test_air_that_the_instrument_divides_out_is_no_candidate(bench):
    forms = effect_class('air_refraction_drift')().appearance(bench.view)
    assert not any('logged' in form.label for form in forms)


@pytest.mark.parametrize('kind', ['phase by run', 'phase by setup'])
def test_cyclic_nonlinearity(bench, kind):
    """Arrivals of the quiet cell repeat to far less than a fringe, so that a setup has one phase."""
    given = {'amp': 2e-8, 'amp2': 0.0, 'phase': 0.4, 'wavelength': 1530e-9}
    found = compare(bench, 'cyclic_nonlinearity', given, '1530', 'optical', kind, limit=0.03)
    swing = np.hypot(found[0::2], found[1::2])
    # Runs are short here and what the errors can take is not seen: the middle of them tells.
    assert np.median(swing) == pytest.approx(2e-8, rel=0.2)


def test_beams_side_by_side_have_phases_of_their_own(other_bench):
    """By how much their paths differ is not known to a fringe; runs of two stops have none to spare for a phase."""
    given = {'amp': 1e-8, 'amp2': 0.0, 'phase': 0.4, 'wavelength': 1530e-9}
    compare(other_bench, 'cyclic_nonlinearity', given, '1530', 'optical', 'phase by setup', limit=0.3)


def test_count_slip(bench):
    view = bench.view
    acting = bench.with_effect(effect_class('count_slip')(jump=3.8e-7, arrival=15))
    change = bench.change(acting)
    slipped = np.flatnonzero(np.abs(change[:, 0]) > 1e-7)
    first = slipped[0]
    forms = effect_class('count_slip')().appearance(view)
    form = next(f for f in forms
                if f.shape == {'run': int(view.run[first]), 'index': int(view.index[first])})
    np.testing.assert_allclose(form.columns[0] * 3.8e-7, change, atol=1e-15)
    assert len(forms) == len(view.run) - len(np.unique(view.run))


def test_beam_pointing_drift(bench):
    tau = drift_tau(bench.view)
    given = np.array([1e-5, -2e-5])
    found = compare(bench, 'beam_pointing_drift', {'amp': given, 'tau': tau},
                    f'exponential, τ = {tau:.0f} s', limit=1e-3)
    np.testing.assert_allclose(found, given * beginning(bench.view, tau), rtol=0.01)


@pytest.mark.parametrize(('astigmatism', 'words'), [(0.0, ('sphere',)), (0.4, ('quadratic',))])
def test_mirror_curvature(bench, astigmatism, words):
    found = compare(bench, 'mirror_curvature', {'radius': 5000.0, 'astigmatism': astigmatism}, *words,
                    limit=1e-3)
    want = [2e-4] if astigmatism == 0.0 else [2.8e-4, 0.0, 1.2e-4]
    np.testing.assert_allclose(found, want, atol=2e-7)


@pytest.mark.parametrize('each', ['exponential', 'each mounting'])
def test_mirror_mount_creep(bench, each):
    tau = 0.3 * float(bench.view.mount_time.max())
    given = np.array([4e-5, -2e-5])
    found = compare(bench, 'mirror_mount_creep', {'amp': given, 'tau': tau, 'spread': 0.0},
                    f'exponential, τ = {tau:.0f} s', each, limit=0.12).reshape(-1, 2)
    # It begins when the mirror is mounted, before the first dwell of the setup.
    assert np.all(np.sign(found) == np.sign(given))
    assert np.all(np.abs(found) < np.abs(given))
    np.testing.assert_allclose(found[:, 0] / found[:, 1], given[0] / given[1], rtol=0.05)


def test_psd_zero_offset(bench):
    found = compare(bench, 'psd_zero_offset', {'x': 1e-5, 'y': -2e-5}, 'constant', limit=1e-9)
    np.testing.assert_allclose(found, [1e-5, -2e-5], rtol=1e-9)


def test_psd_gain(bench):
    found = compare(bench, 'psd_gain', {'x': 0.01, 'y': -0.02}, 'apart', limit=0.01)
    np.testing.assert_allclose(found, [0.01, -0.02], rtol=0.05)
    found = compare(bench, 'psd_gain', {'x': 0.01, 'y': 0.01}, 'alike', limit=0.03)
    np.testing.assert_allclose(found, [0.01], rtol=0.05)


def test_a_gain_that_ages_does_so_inside_the_dwells(bench):
    """What the spot shows in a dwell is the rate of its profile from stop to stop."""
    view = bench.view
    form = pick(effect_class('psd_gain')().appearance(view), 'apart', 'ageing')
    gain, ageing = form.columns[:2], form.columns[2:]
    assert form.names == ('x', 'y', 'x ageing', 'y ageing')
    late = np.divide(ageing, gain, out=np.full_like(gain, np.nan), where=gain != 0.0)
    rate, middle = np.polyfit(view.time, np.nanmean(late, axis=(0, 2)), 1)
    assert rate * np.ptp(view.time) == pytest.approx(1.0) and rate * view.time.mean() == pytest.approx(-middle)
    away = view.bin_time - view.bin_time.mean(axis=1, keepdims=True)
    np.testing.assert_array_equal(form.inside[:2], 0.0)
    np.testing.assert_allclose(form.inside[2:], rate * gain[:, :, None] * away[:, :, None], atol=1e-18)


def test_psd_nonlinearity(bench):
    found = compare(bench, 'psd_nonlinearity', {'k3': 1000.0, 'cross': 0.4}, 'cubic with cross terms',
                    limit=0.01)
    # k3 (1 mm)³ = 1 µm of x³; of x y² what is left of it.
    np.testing.assert_allclose(found, [1e-6, 1e-6, 0.6e-6, 0.6e-6], rtol=0.05)
    found = compare(bench, 'psd_nonlinearity', {'k3': 1000.0, 'cross': 0.0}, 'radial cubic,', limit=0.01)
    np.testing.assert_allclose(found, [1e-6], rtol=0.02)


def test_psd_rotation(bench):
    found = compare(bench, 'psd_rotation', {'angle': 0.01}, 'constant', limit=0.02)
    np.testing.assert_allclose(found, [0.01], rtol=0.02)


@pytest.mark.parametrize(('angle', 'words'), some((0.36, '+21°, constant'), later=[(-0.22, '-13°, constant')]))
def test_psd_turned_far_shortens_the_spot(bench, angle, words):
    kind = effect_class('psd_rotation')
    forms, change = kind().appearance(bench.view), bench.change(bench.with_effect(kind(angle=angle)))
    found, rest = bench.fitted(pick(forms, words), change)
    assert rest < 0.02
    np.testing.assert_allclose(found, [np.sin(angle)], rtol=0.02)
    turned = bench.view.spot_model @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    exact, shear = (np.sin(angle) * pick(forms, label).columns[0][:, -2:] for label in (words, 'constant'))
    assert exact == pytest.approx(turned - bench.view.spot_model, abs=1e-12)
    assert np.abs(shear - exact).max() > 0.1 * np.abs(exact).max()


def test_ambient_light_that_the_sum_signal_shows(bench):
    given = {'level': 0.0, 'swing': 0.03, 'period': 150.0}
    found = compare(bench, 'ambient_light', given, 'as the sum signal says', limit=0.02)
    np.testing.assert_allclose(found, [1.0], rtol=0.03)


def test_ambient_light_that_only_the_clock_shows(bench):
    period = float(np.ptp(bench.view.time))
    compare(bench, 'ambient_light', {'level': 0.0, 'swing': 0.03, 'period': period}, 'smooth', limit=0.1)


@pytest.mark.parametrize('logged', [True, False])
def test_scale_thermal_expansion(bench, logged):
    tau = drift_tau(bench.view)
    rise = np.array([3.0, -2.0, 2.5])
    words = ('logged temperatures',) if logged else (f'exponential, τ = {tau:.0f} s',)
    # The topics carry their sensors' noise.
    found = compare(bench, 'scale_thermal_expansion', {'alpha': 1e-5, 'dT': rise, 'tau': tau}, *words,
                    limit=0.1 if logged else 0.01)
    want = 1e-5 if logged else 1e-5 * rise * beginning(bench.view, tau)
    np.testing.assert_allclose(found, want * np.ones(3), rtol=0.15 if logged else 0.03)


def test_structural_thermal_drift(bench):
    tau = drift_tau(bench.view)
    given = np.array([1e-6, 2e-6, -3e-6])
    found = compare(bench, 'structural_thermal_drift', {'amp': given, 'tau': tau},
                    f'exponential, τ = {tau:.0f} s', limit=0.02)
    np.testing.assert_allclose(found, given * beginning(bench.view, tau), rtol=0.03)


def test_backlash(bench):
    found = compare(bench, 'backlash', {'B': [1e-6, 2e-6, 5e-7]}, 'constant reversal, carried over',
                    limit=0.01)
    np.testing.assert_allclose(found[:3], [1e-6, 2e-6, 5e-7], rtol=0.01)


def test_a_reversal_that_varies_along_its_axis_and_with_anothers_place(bench):
    along, load = np.zeros((3, 6)), np.array([0.0, 3e-7, -2e-7, 0.0, 0.0, 0.0])
    along[0, 1], along[2, 0] = 2e-7, -3e-7
    given = {'B': [1e-6, 2e-6, 5e-7], 'along': along.ravel(), 'load': load}
    # Waves at few stops may stand for each other: what counts is that the form does what the effect does.
    compare(bench, 'backlash', given, 'reversal of each place and under load, carried over', limit=0.01)


def test_servo_settling(bench):
    tau, amp = 0.17, 1e-6
    acting = bench.with_effect(effect_class('servo_settling')(amp=amp, tau=tau))
    form = pick(effect_class('servo_settling')().appearance(acting.view), f'τ = {tau:g} s', 'each axis',
                'at the first stops')
    found, left = bench.fitted(form, bench.change(acting))
    assert left < 0.1
    np.testing.assert_allclose(found, amp, rtol=0.15)
    inside = (acting.bins - bench.plain.bins)[:, :, :1]
    seen = form.inside[:, :, :, :1]
    size = np.array([np.sum(c * inside) / np.sum(c * c) for c in seen])
    np.testing.assert_allclose(size, amp, rtol=0.1)
    assert np.abs(inside - np.tensordot(size, seen, 1)).max() < 0.1 * np.abs(inside).max()


class Swinging(ServoSettling):
    """Swings at 2.5 Hz while it dies away, and creeps more slowly."""

    def before_pose(self, moment):
        since = np.maximum(moment.since_arrival, 0.0)
        left = 0.6 * np.exp(-since / 0.1) * np.cos(5.0 * np.pi * since) + 0.4 * np.exp(-since / 0.4)
        moving = moment.moved[:, None] == np.arange(3)
        moment.position = moment.position - self.amp * left[:, None] * moving * moment.approach


def test_a_servo_that_swings_and_creeps_into_the_next_run(bench):
    acting = bench.with_effect(Swinging(amp=1e-6, tau=0.1))
    view = acting.view
    form = pick(Swinging().appearance(view), 'swings at 3 Hz', 'at the first stops')
    form = form.at({'tau_s': 0.1, 'swing_Hz': 2.5, 'creep_s': 0.4})
    inside = (acting.bins - bench.plain.bins)[:, :, 0]
    # A run that begins where the last one ended; the move to the others is not in the log.
    stays = np.concatenate([[False], (np.diff(view.commanded, axis=0) == 0.0).all(axis=1)])
    assert stays.sum() >= 4 and np.abs(inside[stays]).max() > 1e-9
    rows = stays | (view.axis < 3)
    columns = form.inside[..., 0][:, rows].reshape(9, -1).T
    size, *_ = np.linalg.lstsq(columns, inside[rows].ravel(), rcond=None)
    np.testing.assert_allclose(size.reshape(3, 3), [[6e-7, 0.0, 4e-7]] * 3, atol=5e-8)
    rest = inside[rows] - (columns @ size).reshape(-1, inside.shape[1])
    assert np.abs(rest[stays[rows]]).max() < 0.2 * np.abs(inside[stays]).max()


@pytest.mark.parametrize(('motion', 'by', 'power'), some(
    ('EBZ', 'X', 1.0), ('EAY', 'X', 2.0), later=[('EZX', 'Y', 1.0), ('ECX', 'Z', 1.0)]))
def test_non_rigid_coupling(bench, motion, by, power):
    kind = 'product' if power == 1.0 else 'bent'
    given = {'motion': motion, 'by': by, 'amp': 1e-5, 'power': power}
    found = compare(bench, 'non_rigid_coupling', given, f'{motion} by {by}, {kind}', limit=0.01)
    np.testing.assert_allclose(found[-1 if power == 2.0 else 0], 1e-5, rtol=0.01)


def test_a_coupling_that_bends_along_both_axes(bench):
    given = {'motion': 'EAY', 'by': 'X', 'amp': 1e-5, 'bend': [0.5, -0.3]}
    found = compare(bench, 'non_rigid_coupling', given, 'EAY by X, bent', limit=0.01)
    np.testing.assert_allclose(found, [1e-5, 0.5e-5, -0.3e-5], atol=2e-7)


def test_squareness_drift(bench):
    tau = drift_tau(bench.view)
    given = np.array([1e-6, 2e-6, -3e-6])
    found = compare(bench, 'squareness_drift', {'amp': given, 'tau': tau},
                    f'exponential, τ = {tau:.0f} s', limit=0.01)
    np.testing.assert_allclose(found, given * beginning(bench.view, tau), rtol=0.03)


@pytest.fixture(scope='module')
def forms_of(bench):
    """``forms_of(name)``: by which the diagnosis would know an effect in the bench's log."""
    return cache(lambda name: effect_class(name)().appearance(bench.view))


@pytest.mark.parametrize('name', VOCABULARY)
def test_forms_are_whole(bench, forms_of, name):
    """Shapes, names and sizes fit together, and nothing is infinite."""
    view = bench.view
    for form in forms_of(name):
        k = len(form.columns)
        assert k == len(form.names) == len(set(form.names)) == len(form.scale)
        assert form.columns.shape == (k, *view.reading.shape)
        assert np.isfinite(form.columns).all()
        assert np.all(form.scale > 0.0)
        assert form.columns.any() or form.inside is not None
        if form.inside is not None:
            assert form.inside.shape == (k, *view.bin_time.shape, view.reading.shape[1])
            # Bins are counted from the dwell's mean.
            assert np.abs(form.inside.mean(axis=2)).max() <= 1e-9 * max(np.abs(form.inside).max(), 1e-300)


@pytest.mark.parametrize('name', [n for n in VOCABULARY
                                  if n not in ('count_slip', 'non_rigid_coupling', 'vibration', 'clock_skew')])
def test_forms_are_few(forms_of, name):
    forms = forms_of(name)
    # What changes at once has one form for each stop, and these share one weight.
    assert 0 < len([form for form in forms if not form.family]) <= 80
    assert len({form.label for form in forms}) == len(forms)


@pytest.mark.parametrize(('name', 'values', 'words'), some(
    ('squareness_drift', {'amp': [2e-6, 4e-6, -6e-6]}, ('exponential',)),
    ('scale_thermal_expansion', {'alpha': 1e-5, 'dT': [1.0, -0.5, 0.8]}, ('exponential',)),
    ('mirror_curvature', {'radius': 5000.0, 'astigmatism': 0.4}, ('quadratic',)),
    ('non_rigid_coupling', {'motion': 'EAY', 'by': 'X', 'amp': 1e-5}, ('EAY by X, product',)),
    ('backlash', {'B': [1e-6, 2e-6, 5e-7]}, ('constant reversal, carried over',)),
    later=[('structural_thermal_drift', {'amp': [2e-6, 4e-6, -6e-6]}, ('exponential',)),
           ('beam_pointing_drift', {'amp': [1e-5, -2e-5]}, ('exponential',))]))
def test_on_a_moving_table_with_three_beams(other_bench, name, values, words):
    if words == ('exponential',):
        tau = drift_tau(other_bench.view)
        values, words = {**values, 'tau': tau}, (f'exponential, τ = {tau:.0f} s',)
    found = compare(other_bench, name, values, *words, limit=0.02)
    assert np.isfinite(found).all()


def test_a_slip_of_one_beam_alone_has_a_form(other_bench):
    forms = effect_class('count_slip')().appearance(other_bench.view)
    alone = [f for f in forms if f.label.endswith('beam 1')]
    assert len(alone) == len(forms) / 4
    assert all(f.columns[0, :, 1].any() and not f.columns[0, :, [0, 2]].any() for f in alone)
