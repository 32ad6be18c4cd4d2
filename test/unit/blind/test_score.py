"""Every figure of the table on answers whose score is known."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.blind.score import (
    Case,
    calibration,
    cells,
    closed,
    covering,
    credible_set,
    normalised_errors,
    score,
    where_f1,
    wilson,
)

ERRORS = {'EXX': {'position_m': [0.0, 0.5, 1.0], 'value': [0.0, 1e-6, 3e-6], 'sigma': [0.0, 1e-7, 1e-7]},
          'EC0Y': {'value': 1e-5, 'sigma': 1e-6}}


def case(category='single', names=('backlash',), said=(('backlash', 0.99),), verdict='explained',
         visibility=12.0, ranking=None, sets=None, shift=0.0, **extra) -> Case:
    after = {name: {**entry, 'value': np.add(entry['value'], shift * np.array(entry['sigma'])).tolist()}
             for name, entry in ERRORS.items()}
    truth = {'category': category, 'errors': ERRORS,
             'effects': [{'name': n, 'visibility': {'total': visibility}} for n in names],
             'shares': [{'channel': 'displacement', 'setup': 'ppp', 'share': 0.95},
                        {'channel': 'spot_x', 'setup': 'npp', 'share': 0.05}]}
    gap = {'verdict': verdict, 'effects': [{'name': n, 'probability': p} for n, p in said],
           'where': [{'channel': 'displacement', 'setup': 'ppp', 'share': 1.0}]}
    return Case('log', truth, gap, {
        'ranking': ranking or dict(said), 'sets': sets or [[[n for n, _ in said], 1.0]],
        'errors': {'before': after, 'after': ERRORS}, 'seconds': 2.0,
        'closing': {'before': 3.0, 'after': 1.02, 'count': 200}, **extra})


def null(verdict='no_gap', said=()) -> Case:
    return case('null', (), said, verdict, ranking={'nothing': 0.98}, sets=[[[], 0.98]])


@pytest.mark.parametrize(('hits', 'count', 'low', 'high'),
                         [(0, 300, 0.0, 0.0126), (8, 10, 0.490, 0.943), (5, 5, 0.566, 1.0)])
def test_wilson(hits: int, count: int, low: float, high: float) -> None:
    """Newcombe, *Two-sided confidence intervals for the single proportion*, Stat. Med. 17 (1998)."""
    assert wilson(hits, count) == pytest.approx((low, high), abs=6e-4)


def test_perfect_answers() -> None:
    outside = case('outside', ('stick_slip',), (), 'unexplained', ranking={'unknown': 0.99},
                   sets=[[['unknown'], 0.99]])
    pair = case('pair', ('backlash', 'psd_gain'), (('backlash', 0.9), ('psd_gain', 0.8)))
    figures = score([case(), pair, outside, null()])['figures']
    assert figures['false_alarms']['hits'] == 0
    for key in ('detection', 'first_right', 'set_coverage', 'outside_unknown', 'pair_exact', 'en_at_most_1'):
        assert figures[key]['value'] == 1.0, key
    assert figures['outside_misnamed']['value'] == 0.0
    assert figures['mean_probability']['value'] == pytest.approx(0.99)
    assert figures['set_size']['value'] == 1.0
    assert figures['where_f1']['value'] == 1.0


def test_wrong_answers() -> None:
    outside = case('outside', ('stick_slip',), (('backlash', 0.9),), 'explained')
    wrong = case(said=(('psd_gain', 0.7), ('backlash', 0.3)), sets=[[['psd_gain'], 0.7], [['backlash'], 0.3]])
    figures = score([wrong, outside, null('explained', (('backlash', 0.9),))])['figures']
    assert figures['false_alarms']['hits'] == 1
    assert figures['first_right']['value'] == 0.0
    assert figures['set_coverage']['value'] == 1.0
    assert figures['set_size']['value'] == 2.0
    assert figures['outside_misnamed']['value'] == 1.0


def test_faint_effects_do_not_count_but_stand_in_the_curve() -> None:
    result = score([case(visibility=3.5, verdict='no_gap', said=())])
    assert result['figures']['detection']['count'] == 0
    assert result['curve'][0]['detection'] == {'value': 0.0, 'hits': 0, 'count': 1,
                                               'interval': pytest.approx([0.0, 0.793], abs=1e-3)}


def test_an_effect_of_which_the_truth_does_not_tell_how_well_it_is_seen_does_not_count() -> None:
    """As in sets that were sealed while lost samples hid how well a clock is seen that is off."""
    assert score([case(visibility=None)])['figures']['detection']['count'] == 0


def test_what_competes_with_the_leader() -> None:
    one = case(said=(('backlash', 0.9),), sets=[[['backlash'], 0.6], [['backlash', 'psd_gain'], 0.2],
                                                [['count_slip'], 0.17], [['psd_zero_offset'], 0.03]])
    assert credible_set(one) == {'backlash', 'count_slip'}
    late = case(names=('clock_skew',), said=(('clock_skew', 0.99),), sets=[[[], 1.0]])
    assert credible_set(late) == {'clock_skew'}


def test_cells_without_setup_are_spread() -> None:
    total = cells([{'channel': 'spot_x', 'share': 0.6}, {'channel': 'spot_y', 'setup': 'ppp', 'share': 0.4}],
                  ['ppp', 'npp'])
    assert total == {('spot_x', 'ppp'): 0.3, ('spot_x', 'npp'): 0.3, ('spot_y', 'ppp'): 0.4}
    assert covering({('a', 'b'): 0.5, ('c', 'd'): 0.42, ('e', 'f'): 0.08}) == {('a', 'b'), ('c', 'd')}


def test_where_counts_what_is_missed() -> None:
    one = case()
    one.truth['shares'][0]['share'], one.truth['shares'][1]['share'] = 0.5, 0.5
    assert where_f1(one) == pytest.approx(2.0 / 3.0)


def test_closed_is_of_the_excess() -> None:
    assert closed(case()) == pytest.approx(1.0 - 0.02 / 2.0)
    assert np.isnan(closed(case(closing={'before': 1.1, 'after': 1.0, 'count': 200})))


def test_what_the_noise_that_fell_leaves_is_no_gap() -> None:
    answer = case(closing={'before': 3.0, 'after': 1.1, 'count': 200})
    assert closed(answer) == pytest.approx(0.95)
    assert closed(replace(answer, truth={**answer.truth, 'noise_chi2': 1.1})) == 1.0


def test_errors_are_compared_in_one_gauge() -> None:
    shifted = case(shift=2.0)
    np.testing.assert_allclose(normalised_errors(shifted, 'before'), 2.0)
    np.testing.assert_allclose(normalised_errors(shifted, 'after'), 0.0)
    figures = score([shifted])['figures']
    assert figures['bias_removed']['value'] == figures['bias_removed_median']['value'] == 1.0


def test_overconfidence_shows_in_the_calibration() -> None:
    right = [case(said=(('backlash', 0.9),)) for _ in range(6)]
    wrong = [case(names=('psd_gain',), said=(('backlash', 0.9),)) for _ in range(4)]
    assert calibration(right + wrong)['error']['value'] == pytest.approx(0.3)
