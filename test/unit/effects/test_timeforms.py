"""Courses in time: where they begin, their rates, and what an unknown one is taken to be."""

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.effects.patterns import relaxations
from stepdiag_ros.effects.timeforms import courses, unknown

SPAN = 1500.0


@pytest.mark.parametrize('kind', [courses, relaxations])
def test_courses_are_the_integrals_of_their_rates(kind):
    time = np.linspace(20.0, SPAN, 8000)
    for course in kind(time):
        steps = 0.5 * (course.rates[:, 1:] + course.rates[:, :-1]) * np.diff(time)
        np.testing.assert_allclose(np.cumsum(steps, axis=1), course.values[:, 1:] - course.values[:, :1],
                                   atol=1e-3)


def test_courses_begin_with_the_log():
    for course in courses(np.linspace(0.0, SPAN, 400)):
        np.testing.assert_allclose(course.values[:, 0], 0.0, atol=1e-12)


def test_a_winding_course_is_a_walk_and_a_smooth_one_is_smoother():
    time = np.linspace(0.0, SPAN, 2000)
    winding, smooth = unknown(time)

    def variance(course, lag):
        change = (course.values[1:, lag:] - course.values[1:, :-lag]) * course.sizes[1:, None]
        return float(np.sum(change**2, axis=0).mean())

    # A walk's variance grows with the time, that of one whose rate walks with its square or more.
    assert variance(winding, 200) / variance(winding, 100) == pytest.approx(2.0, rel=0.1)
    assert variance(smooth, 200) / variance(smooth, 100) > 3.0


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
