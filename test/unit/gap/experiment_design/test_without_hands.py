"""The further run that a cell can make by itself: what it has not measured yet, within the time, not the same again."""

import numpy as np
import pytest

from stepdiag_ros.api import diagnose, load_cell, simulate
from stepdiag_ros.effects import all_effects
from stepdiag_ros.gap.experiment_design.extended_log import Run, seconds_of, with_run
from stepdiag_ros.gap.experiment_design.without_hands import left_open, run_without_hands

CELL = """
schema: 1
seed: 20
machine: {name: open, chain: FXYZ, volume: [0.20, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 3, order: XYZ, repeats: 2}
setups:
  ppp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  pnp: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.20, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.20, stops: 2}
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
geometry:
  drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}
misalignments:
  drawn: {laser: 3.0e-4, mirror: 2.0e-4, psd_zero: 0.0}
effects: {psd_zero_offset: {x: 4.0e-4, y: -3.0e-4}}
motion: {feed: 0.5, acceleration: 8.0, settling: 0.002, dwell: 0.06, mount: 2.0}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""
EFFECTS = [kind() for kind in all_effects([]).values()]
SOON_S = 30.0


@pytest.fixture(scope='module')
def cell(tmp_path_factory):
    path = tmp_path_factory.mktemp('open') / 'open.yaml'
    path.write_text(CELL, encoding='utf-8')
    return load_cell(path)


@pytest.fixture(scope='module')
def found(cell):
    """One diagonal and one line do not tell the detector's zero from other causes."""
    return diagnose(simulate(cell, ['ppp', 'lin_x']))


def test_what_is_open_has_its_probability(found):
    what = left_open(found)
    assert 'psd_zero_offset' in what and len(what) > 2
    assert all(p == found.ranking[name] for name, p in what.items())
    assert list(what.values()) == sorted(what.values(), reverse=True)


def test_a_setup_that_the_log_does_not_hold_is_measured(found, cell):
    able = run_without_hands(found, EFFECTS, cell.setup_names, longest_s=SOON_S)
    assert able.code == 'pnp' and able.run.error < 0.05 and not able.run.run.known
    assert 5.0 < able.seconds < SOON_S


@pytest.mark.long
def test_it_settles_what_it_promised_to(cell):
    """That a running cell does so while it measures, test/node/test_settling.py sees."""
    settled = diagnose(simulate(cell, ['ppp', 'lin_x', 'pnp']))
    assert not left_open(settled)
    assert [effect.name for effect in settled.effects] == ['psd_zero_offset']


def test_what_a_code_brings_back_as_it_was_tells_nothing_new(found):
    assert run_without_hands(found, EFFECTS, ['ppp', 'lin_x'], longest_s=SOON_S) is None


def test_no_run_is_made_twice_for_one_question_or_beyond_the_time(found, cell):
    assert run_without_hands(found, EFFECTS, cell.setup_names, ['pnp'], SOON_S) is None
    assert run_without_hands(found, EFFECTS, cell.setup_names, longest_s=2.0) is None


def test_a_setup_as_it_was_is_more_repeats_of_it(found):
    joint = found.joint
    table, description = joint.observation.table, joint.observation.log.description
    run = Run(description.setups['ppp'], as_mounted='ppp', wait=100.0)
    longer, like = with_run(table, run, description, 0)
    new = slice(len(table), None)
    assert longer.setup_names == table.setup_names
    assert set(longer.setup[new]) == {table.setup_names.index('ppp')}
    assert set(longer.repeat[new]) == {2, 3}
    np.testing.assert_array_equal(longer.commanded[new], table.commanded[like])
    assert seconds_of(joint, run) == pytest.approx(100.0 + seconds_of(joint, Run(run.setup, as_mounted='ppp')))
