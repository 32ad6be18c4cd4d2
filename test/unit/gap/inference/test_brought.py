"""Forms in blocks are what each form is, brought over alone and written out."""

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.made import Split
from stepdiag_ros.gap.alternatives.unmodelled import unknown_families
from stepdiag_ros.gap.inference import brought
from stepdiag_ros.gap.inference.brought import Brought
from stepdiag_ros.gap.inference.factored import is_factored
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of

#: Of each stop: a sixth of the 300 kB that all may take.
MOST_BYTES_A_STOP = 50e3
#: To which columns are rounded, in units of what they are before the fit's share is taken off.
ROUNDED = 1e-7


@pytest.fixture(scope='module')
def space_and_forms(case):
    observation = case.observe()
    joint = fit_jointly(observation, [], noise_of(observation))
    forms = [form for kind in all_effects().values() for form in kind().appearance(observation.view)]
    families = unknown_families(observation.view)
    return joint.parity, forms + [form for family in families.values() for form in family]


@pytest.mark.parametrize('at_a_time', [1, brought.AT_A_TIME])
def test_columns_products_and_data_are_those_of_each_form_alone(space_and_forms, monkeypatch, at_a_time):
    space, forms = space_and_forms
    monkeypatch.setattr(brought, 'AT_A_TIME', at_a_time)
    if at_a_time == 1:
        monkeypatch.setattr(brought, 'COLUMNS_AT_A_TIME', 1)
    by_run = [form for form in forms if isinstance(form.columns, Split)]
    forms = forms[::37] + [form for form in by_run if form.by_reading is not None][:6] + by_run[-2:]
    assert {is_factored(form) for form in forms} == {True, False} and by_run[-1].by_reading is None
    data = np.concatenate([space.data, space.own_data])
    found = Brought.into(space, forms, data)
    directions = np.random.default_rng(1).standard_normal((len(data), 3))
    directions[:space.stops] = space.projection.projected(directions[:space.stops])
    times = found.times(directions, slice(0, found.width))
    some = found.slices[1]
    np.testing.assert_array_equal(found.times(directions, some)[some], times[some])
    assert not found.times(directions, some)[some.stop:].any()
    for form, part, gram in zip(forms, found.slices, found.grams, strict=True):
        whole = space.project(form)
        full = found.columns(part, len(data))
        full[:space.stops] = space.projection.projected(full[:space.stops])
        # Against the form as it is, it is rounded; against itself, as it is kept, all is exact.
        before = max(np.abs(space.white_part(np.asarray(form.columns) * form.scale[:, None, None])).max(),
                     np.abs(whole).max(), 1e-12)
        np.testing.assert_allclose(full[:space.size], whole, atol=10.0 * ROUNDED * before)
        size, mine = max(np.abs(whole).max(), 1e-12), full[:space.size]
        np.testing.assert_allclose(gram, mine.T @ mine, atol=1e-7 * size**2 * len(whole))
        np.testing.assert_allclose(found.along[part], full.T @ data, atol=1e-7 * size * np.abs(data).sum())
        np.testing.assert_allclose(times[part], full.T @ directions, atol=1e-7 * size * len(data))


def test_a_stop_takes_little_memory(space_and_forms):
    space, forms = space_and_forms
    found = Brought.into(space, forms, np.concatenate([space.data, space.own_data]))
    kept = sum(block.columns.nbytes for block in (*found.blocks, *found.own))
    assert kept / (space.row.max() + 1) < MOST_BYTES_A_STOP


def test_what_drifts_stands_in_no_block(space_and_forms):
    space, forms = space_and_forms
    found = Brought.into(space, forms, np.concatenate([space.data, space.own_data]))
    written = np.unique(np.concatenate([block.places for block in (*found.blocks, *found.own)]))
    drifts = [part for form, part in zip(forms, found.slices, strict=True) if is_factored(form)]
    assert sum(part.stop - part.start for part in drifts) > found.width / 3
    assert not any(np.any((written >= part.start) & (written < part.stop)) for part in drifts)
