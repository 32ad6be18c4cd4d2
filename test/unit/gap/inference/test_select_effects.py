"""Search and fit in turns: what one linearisation predicts the fit must hold."""

import pytest

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of, settle
from stepdiag_ros.virtual.cell import parse_cell
from test.unit.gap.conftest import TEXT, Case

LARGE = TEXT.replace('volume: [0.5, 0.4, 0.3]', 'volume: [2.2, 2.2, 2.6]').replace('length: 0.5', 'length: 2.2') \
    .replace('length: 0.4', 'length: 2.2').replace('length: 0.3', 'length: 2.6') \
    .replace('position_repeatability: 3.0e-7', 'position_repeatability: 8e-8')
"""A large machine that repeats well: its diagonals are long against its straight runs by what no tilted beam can be."""


@pytest.fixture(scope='module')
def large():
    case = Case()
    case.cell = parse_cell(LARGE)
    return case


@pytest.mark.long
def test_what_only_a_beam_that_lengthens_could_replace_stays_found(large):
    # The effect once freed, a linear step of the beams' tilts seems to do as well; their cosine cannot.
    found = large.diagnose(effect_class('non_rigid_coupling')(motion='EXX', by='Z', amp=-1e-5))
    assert found.verdict == 'unexplained'
    assert 'bent' in found.unmodelled
    assert found.cross_validation.after < 1.1 < found.cross_validation.before


def test_nothing_is_found_where_a_beam_that_shortens_does_as_well(large):
    assert large.diagnose(effect_class('non_rigid_coupling')(motion='EXX', by='Z', amp=1e-5)).verdict == 'no_gap'


def test_what_is_one_arrival_is_not_looked_for_where_errors_have_tails(case):
    """A slip that lasts as long as the axis that moved stays is an error of its arrival, and a tail where there are."""
    effects = {name: kind() for name, kind in all_effects().items()}
    view = case.observe().view
    run = view.run_ids.index('ppp/0/+')
    single = {form.shape['index'] for form in effects['count_slip'].appearance(view)
              if form.shape['run'] == run and form.of_one_arrival}
    last = view.index[view.run == run].max()
    assert single == {last - 2, last - 1, last}   # of each axis its last
    joint = fit_jointly(case.observe(), [], noise_of(case.observe()))
    for tails in (False, True):
        _, _, screen = settle(joint, effects, tails)
        assert any(c.form.of_one_arrival for c in screen.candidates) != tails
