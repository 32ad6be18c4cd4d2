"""Time profiles: where they begin, their rates, and what an unknown one is taken to be."""

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.patterns import each_alone, power_law, relaxations, relaxing
from stepdiag_ros.effects.timeforms import WATCH_WAVES, slowing, time_profiles, unknown

SPAN = 1500.0


@pytest.mark.parametrize('kind', [time_profiles, relaxations])
def test_time_profiles_are_the_integrals_of_their_rates(kind):
    time = np.linspace(20.0, SPAN, 8000)
    for profile in kind(time):
        steps = 0.5 * (profile.rates[:, 1:] + profile.rates[:, :-1]) * np.diff(time)
        np.testing.assert_allclose(np.cumsum(steps, axis=1), profile.values[:, 1:] - profile.values[:, :1],
                                   atol=1e-3)


def test_nothing_relaxes_faster_than_an_effect_can():
    time = np.linspace(0.0, 300.0, 100)
    for profile in relaxations(time, 20.0):
        for name in {'tau_s', 'start_s'} & set(profile.shape):
            assert profile.shape[name] >= 20.0
            faster = profile.retune({**profile.shape, name: 3.0})
            assert faster.shape[name] == 20.0
    # Of a short log the whole is known.
    assert min(profile.shape.get('tau_s', np.inf) for profile in relaxations(time / 10.0, 20.0)) == pytest.approx(3.0)


def test_many_time_constants_hold_a_logarithm_and_a_power():
    time = np.linspace(0.0, SPAN, 500)
    profile = relaxing(time, 20.0)
    two = 0.6 * np.exp(-time / 80.0) + 0.4 * np.exp(-time / 900.0)
    for wanted in (np.log1p(time / 60.0), np.sqrt(time + 30.0), two):
        wanted = wanted - wanted[0]
        size, *_ = np.linalg.lstsq(profile.values.T, wanted, rcond=None)
        assert np.abs(profile.values.T @ size - wanted).max() < 0.02 * np.ptp(wanted)


def test_a_profile_that_slows_down_holds_what_fades():
    """A logarithm, a root and two time constants, in few of its functions; late in the log it is quiet."""
    time = np.linspace(0.0, SPAN, 500)
    profile = slowing(time)
    two = -0.6 * np.exp(-time / 80.0) - 0.4 * np.exp(-time / 900.0)
    for wanted in (np.log1p(time / 60.0), np.sqrt(time), two):
        wanted = wanted - wanted[0]
        size, *_ = np.linalg.lstsq(profile.values.T, wanted, rcond=None)
        assert np.abs(profile.values.T @ size - wanted).max() < 0.02 * np.ptp(wanted)
    spread = np.linalg.norm(profile.rates * profile.sizes[:, None], axis=0)
    assert spread[-1] < 0.05 * spread[1]


def test_time_profiles_begin_with_the_log():
    for profile in time_profiles(np.linspace(0.0, SPAN, 400)):
        np.testing.assert_allclose(profile.values[:, 0], 0.0, atol=1e-12)


def test_a_winding_profile_is_a_walk_and_a_smooth_one_is_smoother():
    time = np.linspace(0.0, SPAN, 2000)
    winding, smooth = unknown(time)

    def variance(profile, lag):
        change = (profile.values[1:, lag:] - profile.values[1:, :-lag]) * profile.sizes[1:, None]
        return float(np.sum(change**2, axis=0).mean())

    # A walk's variance grows with the time, that of one whose rate walks with its square or more.
    assert variance(winding, 200) / variance(winding, 100) == pytest.approx(2.0, rel=0.1)
    assert variance(smooth, 200) / variance(smooth, 100) > 3.0


def test_between_the_ends_of_a_watch_a_walk_is_a_bridge():
    """Its variance against the Brownian bridge's, s(ℓ − s)/ℓ times the rate of the walk that the half waves make."""
    time = np.concatenate([np.linspace(0.0, 1000.0, 101), np.linspace(1005.0, 1125.0, 241),
                           np.linspace(1130.0, SPAN, 38)])
    watch = np.arange(101, 342)
    whole, closer = unknown(time), unknown(time, [watch])
    for profile, finer in zip(whole, closer, strict=True):
        added = len(profile.values)
        np.testing.assert_array_equal(finer.values[:added], profile.values)
        assert not finer.values[added:, np.setdiff1d(np.arange(len(time)), watch)].any()
        np.testing.assert_allclose(finer.values[added:, watch[[0, -1]]], 0.0, atol=1e-12)
        steps = 0.5 * (finer.rates[added:, watch[1:]] + finer.rates[added:, watch[:-1]]) * np.diff(time[watch])
        np.testing.assert_allclose(np.cumsum(steps, axis=1), finer.values[added:, watch[1:]], atol=2e-2)
    winding = closer[0]
    rate = np.pi**2 / (2.0 * SPAN)
    s = time[watch] - time[watch[0]]
    bridge = rate * s * (s[-1] - s) / s[-1]
    variance = np.sum((winding.values[-WATCH_WAVES:, watch] * winding.sizes[-WATCH_WAVES:, None])**2, axis=0)
    assert 0.85 < variance.sum() / bridge.sum() < 1.0  # the waves beyond the fifth hold the rest


def test_a_power_law_finds_its_way_to_what_gives_way_faster_and_faster():
    time = np.linspace(0.0, SPAN, 300)
    wanted = (time / SPAN)**1.5
    profile = power_law(time, 1.8)
    errors = {exponent: np.abs(profile.retune({'exponent': exponent}).values[0] - wanted).max()
              for exponent in (1.2, 1.5, 2.4)}
    assert min(errors, key=errors.get) == 1.5 and errors[1.5] < 1e-3


def test_a_short_log_gets_few_waves():
    assert len(unknown(np.linspace(0.0, SPAN, 48))[0].values) < len(
        unknown(np.linspace(0.0, SPAN, 480))[0].values)


def test_a_gain_that_ages_is_one_form(bench):
    spot, late = bench.view.spot_model, bench.view.time / np.ptp(bench.view.time)
    change = np.zeros(bench.view.reading.shape)
    change[:, bench.view.beams:] = spot * (1.0 + 0.1 * late[:, None]) * [0.02, -0.03]
    forms = {form.label: form for form in effect_class('psd_gain')().appearance(bench.view)}
    _, left = bench.fitted(forms['apart in x and y, ageing'], change)
    _, constant = bench.fitted(forms['apart in x and y'], change)
    assert left < 1e-6 < 1e-3 < constant


def test_an_offset_may_differ_from_setup_to_setup(bench):
    change = np.zeros(bench.view.reading.shape)
    change[:, bench.view.beams] = 3e-5 * (1.0 + 0.1 * np.sin(bench.view.setup))
    forms = {form.label: form for form in effect_class('psd_zero_offset')().appearance(bench.view)}
    form = forms['nearly the same in each setup']
    _, left = bench.fitted(form, change)
    assert left < 1e-6
    # The differences are held to a small part of the offset.
    assert form.process and form.scale[2:].max() < 0.5 * form.scale[0]


def test_the_dead_path_changes_as_the_way_does(bench):
    """A shift of the tool on a profile of its own must not pass as air of an unknown dead path."""
    view, late = bench.view, bench.view.elapsed / bench.view.elapsed.max()
    forms = {form.label: form for form in effect_class('air_refraction_drift')().appearance(view)}
    air, shift = np.zeros(view.reading.shape), np.zeros(view.reading.shape)
    longer = view.distance + view.distance.min()
    air[:, :view.beams] = 1e-6 * np.sin(3.0 * late)[:, None] * longer
    shift[:, :view.beams] = 1e-6 * (np.sin(3.0 * late)[:, None] * view.distance + 0.3 * np.cos(7.0 * late)[:, None])
    twice = forms['dead path 2 times as described, smooth']
    assert len(twice.columns) == len(forms['smooth'].columns)
    assert bench.fitted(twice, air)[1] < 0.1 * bench.fitted(forms['smooth'], air)[1]
    assert min(bench.fitted(form, shift)[1] for form in forms.values() if form.process) > 0.05


def test_one_axis_may_warm_alone(bench):
    view, late = bench.view, bench.view.elapsed / bench.view.elapsed.max()
    from_end = view.commanded[:, [1]] - view.commanded[:, 1].max()
    change = 3e-6 * np.sin(4.0 * late)[:, None] * from_end * view.by_shift[1]
    forms = {form.label: form for form in effect_class('scale_thermal_expansion')().appearance(view)}
    _, left = bench.fitted(forms['Y alone, held at the end, smooth'], change)
    _, other = bench.fitted(forms['Y alone, smooth'], change)
    assert left < 0.05 < other


def test_an_axis_that_never_moved_has_no_form_alone(bench):
    still = np.stack([np.zeros(bench.view.reading.shape), np.ones(bench.view.reading.shape)])
    forms = each_alone(bench.view, time_profiles(bench.view.elapsed), still, ('X', 'Y'), 1e-5)
    assert forms
    assert {form.names[0].rstrip('0123456789') for form in forms} == {'Y'}
