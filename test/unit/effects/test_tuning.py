"""Shape parameters found between those that are tried."""

import numpy as np
import pytest

from stepdiag_ros.effects import VOCABULARY, effect_class
from stepdiag_ros.effects.tuning import same_form, tune


def closeness(form, target):
    """How much of ``target`` (N,) a form's columns span, negative what is left."""
    columns = np.concatenate([form.columns.reshape(len(form.columns), -1),
                              form.inside.reshape(len(form.columns), -1)], axis=1).T
    size = np.linalg.norm(columns, axis=0)
    columns = columns / size
    return -float(np.sum((target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]) ** 2))


def flat(form):
    return np.concatenate([form.columns.ravel(), form.inside.ravel()])


@pytest.mark.parametrize(('name', 'label', 'shape'), [
    ('servo_settling', 'τ = 0.17 s, all', {'tau_s': 0.2345}),
    ('mirror_mount_creep', 'logarithmic', {'start_s': 3.0}),
    ('beam_pointing_drift', 'exponential', {'tau_s': 11.0}),
    ('ambient_light', 'cycle', {'period_s': 300.0})])
def test_the_best_shape_is_found(bench, name, label, shape):
    start = next(f for f in effect_class(name)().appearance(bench.view) if label in f.label)
    rng = np.random.default_rng(4)
    wanted = start.at(shape)
    both = np.concatenate([wanted.columns.reshape(len(wanted.names), -1),
                           wanted.inside.reshape(len(wanted.names), -1)], axis=1)
    target = rng.normal(1.0, 0.2, len(both)) @ both
    found = tune(start, lambda form: closeness(form, target))
    key = next(iter(shape))
    assert found.shape[key] == pytest.approx(shape[key], rel=5e-3)
    assert found.tuned_from == start.label
    again = same_form(effect_class(name)(), found, bench.view)
    np.testing.assert_allclose(flat(again), flat(found))
    assert again.shape == found.shape


def test_a_form_without_shape_stays(bench):
    form = effect_class('psd_gain')().appearance(bench.view)[0]
    assert tune(form, lambda f: 0.0) is form


def test_a_shape_that_is_best_already_stays(bench):
    form = effect_class('servo_settling')().appearance(bench.view)[0]
    assert tune(form, lambda f: 1.0 if not f.tuned_from else 0.0) is form


@pytest.mark.parametrize('name', VOCABULARY)
def test_tuning_to_the_same_shape_changes_nothing(bench, name):
    for form in effect_class(name)().appearance(bench.view):
        if form.retune is not None:
            same = form.at(form.shape)
            np.testing.assert_allclose(same.columns, form.columns)
            np.testing.assert_allclose(same.inside, form.inside)
            assert same.names == form.names
