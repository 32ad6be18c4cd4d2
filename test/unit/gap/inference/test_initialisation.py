"""Large effects: the fit stays sane, the search begins at the right place, the name is found."""

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap.constants import LARGE_RESIDUAL
from stepdiag_ros.gap.inference.initialisation import misfit, place_to_begin
from stepdiag_ros.gap.inference.joint import fit_jointly, inverse
from stepdiag_ros.gap.inference.select_effects import noise_of
from test.some import some

LARGE_EFFECTS = [
    ('psd_zero_offset', {'x': 1e-3, 'y': -7e-4}),
    ('psd_nonlinearity', {'k3': 2e4, 'cross': 0.5}),
    ('mirror_curvature', {'radius': 40.0, 'astigmatism': 0.2}),
    ('psd_rotation', {'angle': 0.4}),
]


@pytest.mark.parametrize(('name', 'values'), some(LARGE_EFFECTS[0], later=LARGE_EFFECTS))
def test_the_search_begins_where_the_effect_is_taken_out(case, name, values):
    observation = case.observe(effect_class(name)(**values))
    setups = observation.fit.parameters.setup_first.values()
    # Bent as the readings are, machine and mounts stay what a machine and mounts can be.
    assert np.abs(observation.fit.theta[:min(setups) + 4 * len(setups)]).max() < 0.02
    nominal = fit_jointly(observation, [], noise_of(observation))
    assert misfit(nominal) > LARGE_RESIDUAL
    begun = place_to_begin(nominal, {kind.name: kind() for kind in all_effects().values()})
    assert misfit(begun) < 0.3 * misfit(nominal)
    assert name in {a.effect.name for a in begun.active}


def test_a_log_with_a_small_effect_begins_at_its_nominal_fit(case):
    observation = case.observe(effect_class('backlash')(B=[1e-6, 0.0, 0.0]))
    nominal = fit_jointly(observation, [], noise_of(observation))
    assert place_to_begin(nominal, {}) is nominal


@pytest.mark.long
def test_two_gross_effects_are_named(case):
    found = case.diagnose(effect_class('psd_zero_offset')(x=1e-3, y=5e-4),
                          effect_class('mirror_curvature')(radius=60.0, astigmatism=0.0))
    assert {e.name for e in found.effects} == {'psd_zero_offset', 'mirror_curvature'}
    assert found.cross_validation.after < 1.5


def test_inverse_of_columns_eleven_orders_apart():
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(50, 4)) * np.array([1e-3, 1.0, 1e4, 1e8])
    normal, norms = columns.T @ columns, np.linalg.norm(columns, axis=0)
    even = np.outer(norms, norms)
    assert (inverse(normal) * even) @ (normal / even) == pytest.approx(np.eye(4), abs=1e-9)
    twice = np.concatenate([columns, columns[:, -1:]], axis=1)
    assert np.all(np.diag(inverse(twice.T @ twice)) > 0.0)
