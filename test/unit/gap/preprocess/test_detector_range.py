"""A detector bent so hard that its reading turns back: found, its far readings left out, its name given."""

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.preprocess.detector_range import HARD, UNIT, bent_by, within_range
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

DISTANCE = np.tile(np.linspace(0.3, 1.5, 25), 3)
SETUP = np.repeat([0, 1, 2], 25)
LINES = np.array([[[1.5, -1.8], [8.0, -9.0]], [[0.3, 0.7], [0.9, -2.1]], [[-2.0, 1.0], [4.0, 3.0]]])
TRUE = np.concatenate([np.column_stack([np.ones(25), DISTANCE[:25] - 0.3]) @ line for line in LINES])


@pytest.mark.parametrize(('own', 'cross'), [(-0.008, -0.008), (-0.006, -0.002), (-0.01, 0.0)])
def test_the_bending_is_found_past_the_turn(own, cross):
    read = TRUE * (1.0 + own * TRUE**2 + cross * TRUE[:, ::-1]**2)
    read += 0.01 * np.random.default_rng(5).normal(size=read.shape)
    assert np.abs(TRUE).max() > 1.0 / np.sqrt(3.0 * abs(own))
    bent = bent_by(SETUP, DISTANCE, read)
    assert (bent.own, bent.cross) == pytest.approx((own, cross), abs=2e-4)
    np.testing.assert_allclose(bent.spots, TRUE, atol=0.1)


def test_the_reach_is_where_the_slope_has_changed():
    bent = bent_by(SETUP, DISTANCE, TRUE * (1.0 - 0.008 * np.sum(TRUE**2, axis=1))[:, None])
    out = np.array([bent.reach - 1e-4, bent.reach + 1e-4])
    slope = np.diff(out * (1.0 - 0.008 * out**2)) / 2e-4
    assert 1.0 - slope[0] == pytest.approx(HARD, rel=1e-3)


def test_lines_alone_are_no_bent_detector():
    noise = 0.05 * np.random.default_rng(6).normal(size=TRUE.shape)
    assert bent_by(SETUP, DISTANCE, TRUE + noise) is None
    assert bent_by(SETUP[:4], DISTANCE[:4], TRUE[:4]) is None


@pytest.mark.parametrize(('name', 'values'), [
    ('psd_zero_offset', {'x': 1e-3, 'y': -7e-4}),
    ('mirror_curvature', {'radius': 40.0, 'astigmatism': 0.2}),
    ('psd_rotation', {'angle': 0.4}),
    ('backlash', {'B': [1e-6, 0.0, 0.0]}),
])
def test_other_effects_lose_no_reading(case, name, values):
    observation = case.observe(effect_class(name)(**values))
    same, words = within_range(observation)
    assert same is observation
    assert words == ''


@pytest.mark.long
def test_a_detector_that_turns_back_is_named(case):
    cell = parse_cell(case.text.replace('mirror: 3e-4', 'mirror: 4e-3'))
    log = simulate_log(cell, effects=[effect_class('psd_nonlinearity')(k3=-1.5e4, cross=0.0)])
    observation = observe(log)
    kept, words = within_range(observation)
    lost = np.isnan(kept.table.spot).any(axis=1)
    assert 0 < lost.sum() < len(lost)
    assert words.startswith(f'the spot of {lost.sum()} of {len(lost)} stops is left out')
    assert np.abs(kept.table.spot[~lost]).max() < np.abs(observation.table.spot).max() + UNIT
    found = diagnose(log, [kind() for kind in all_effects().values()])
    assert {e.name for e in found.effects} == {'psd_nonlinearity'}
    assert found.verdict == 'explained'
    assert found.cross_validation.after < 1.5
    assert words in found.warnings
