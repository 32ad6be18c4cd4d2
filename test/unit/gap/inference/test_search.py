"""What a set's members explain of the rest, and the size that an unknown profile is held to."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Form
from stepdiag_ros.effects.count_slip import CountSlip
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import IMITATION_PENALTY, LARGE_EVIDENCE, MEMBER_ALARM
from stepdiag_ros.gap.inference import search as search_module
from stepdiag_ros.gap.inference.candidates import BEYOND, Candidate, Member, Screen
from stepdiag_ros.gap.inference.evidence import SIZES
from stepdiag_ros.gap.inference.joint import solve, tuned
from stepdiag_ros.gap.inference.parity import Parity
from stepdiag_ros.gap.inference.search import HOPELESS, EffectSet, joined, log_prior, probabilities, search
from test.unit.gap.inference.white_space import white_space

N = 400
NONE = EffectSet((), 0.0)


def space(data: np.ndarray) -> Parity:
    """White data, the last quarter of the spot."""
    return white_space(data, of_spot=N // 4)


def form(label: str, columns: np.ndarray, scale: np.ndarray, process: bool = False) -> Form:
    """Columns (k, n) as a form with one channel."""
    return Form(label, columns[:, :, None], tuple(str(i) for i in range(len(columns))), scale,
                process=process)


@pytest.fixture
def wide() -> Form:
    """A process of forty columns that go on far below the noise."""
    rng = np.random.default_rng(1)
    columns = np.linalg.qr(rng.normal(size=(N, 40)))[0].T
    return form('wide', columns, np.arange(1, 41) ** -2.0, process=True)


def test_members_explain_as_much_as_their_size_allows(wide):
    screen = Screen(space(np.zeros(N)), [Candidate('wide', '', wide)], 1e9)
    columns = screen.columns_of(0)[:N] * 5.0
    basis = screen.explained([Member('wide', 0, 10.0, 5.0)]).basis[:N]
    np.testing.assert_allclose(np.eye(N) - basis @ basis.T,
                               np.linalg.inv(np.eye(N) + columns @ columns.T), atol=0.02)


def test_an_unknown_profile_does_not_swallow_another_effect(wide):
    """The other effect lies where the profile could go, but only if it were far rougher than it is."""
    rng = np.random.default_rng(2)
    other = form('other', wide.columns[30:40, :, 0].sum(axis=0, keepdims=True), np.full(1, 3.0))
    profile = np.tensordot(wide.columns[:, :, 0].T, wide.scale * rng.normal(size=40) * 30.0, axes=1)
    data = profile + 4.0 * other.columns[0, :, 0] + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('wide', '', wide), Candidate('other', '', other)], 1e9)
    first = screen.by_cause()['wide']
    assert first.size < SIZES[-1] * 1.01
    assert screen.by_cause([first])['other'].log_bayes > 20.0
    # Were the profile free, it could be all of it.
    free = Member('wide', 0, first.log_bayes, 1e6)
    assert screen.by_cause([free])['other'].log_bayes < 1.0


def test_the_joint_fit_holds_a_process_to_the_size_it_shows(wide):
    rng = np.random.default_rng(3)
    columns = wide.columns[:, :, 0].T * wide.scale
    truth = 300.0 * rng.normal(size=40)
    bigger = Form('wide', wide.columns, wide.names, wide.scale * 100.0, process=True)
    data = columns @ truth + rng.normal(size=N)
    (_, held), = tuned(space(data), [(None, bigger)])
    assert held.held == pytest.approx(3.0, rel=0.9)
    found, = solve(space(data), [(None, held)])
    loose, = solve(space(data), [(None, bigger)])
    error = np.sum((columns @ (found.coefficients / wide.scale - truth)) ** 2)
    assert error < np.sum((columns @ (loose.coefficients / wide.scale - truth)) ** 2)


def test_a_pair_is_found_although_a_rich_form_of_the_first_swallows_the_second():
    rng = np.random.default_rng(4)
    a, b, *more = np.linalg.qr(rng.normal(size=(N, 12)))[0].T
    lean = form('lean', a[None], np.ones(1))
    rich = form('rich', np.stack([a, 0.98 * b + 0.2 * more[0], *more[1:]]), np.ones(11))
    other = form('other', b[None], np.ones(1))
    screen = Screen(space(14.0 * a + 14.0 * b + rng.normal(size=N)),
                    [Candidate('A', '', lean), Candidate('A', '', rich), Candidate('B', '', other)], 1e9)
    first = screen.by_cause()['A']
    assert screen.candidates[first.candidate].form is rich
    assert screen.by_cause([first])['B'].log_bayes < 3.0
    best = search(screen)[0]
    assert best.key == {'A', 'B'}
    assert {screen.candidates[m.candidate].form.label for m in best.members} == {'lean', 'other'}


def test_what_happens_twice_is_found_though_each_time_it_explains_less_than_a_rich_form():
    rng = np.random.default_rng(6)
    once, again, *more = np.linalg.qr(rng.normal(size=(N, 6)))[0].T
    slips = [Candidate('slip', '', form(str(k), column[None], np.ones(1))) for k, column in enumerate((once, again))]
    rich = form('rich', np.stack([0.8 * once + 0.8 * again, *more]), np.ones(5))
    data = 40.0 * (once + again) + rng.normal(size=N)
    screen = Screen(space(data), [*slips, Candidate('rich', '', rich)], 1e9, frozenset({'slip'}))
    alone = screen.by_cause()
    assert alone['rich'].log_bayes > alone['slip'].log_bayes + HOPELESS
    best = search(screen)[0]
    assert best.names == ('slip', 'slip')


def test_an_effect_of_gross_evidence_is_carried_on_in_further_forms_of_its_own():
    """By its first form alone it is hopeless beside another that imitates nearly all that its two do."""
    rng = np.random.default_rng(7)
    one, two, slip = np.linalg.qr(rng.normal(size=(N, 3)))[0].T
    whole = one + 0.3 * two
    like = whole + 0.08 * slip
    data = 80.0 * whole + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('true', '', form('one', one[None], np.ones(1))),
                                  Candidate('true', '', form('two', two[None], np.ones(1))),
                                  Candidate('like', '', form('like', like[None], np.ones(1)))], 1e9)
    alone = screen.by_cause()
    assert alone['true'].log_bayes > LARGE_EVIDENCE
    assert alone['like'].log_bayes > alone['true'].log_bayes + HOPELESS
    best = search(screen)[0]
    assert best.names == ('true', 'true')


def test_gross_effects_behind_others_meet_their_partners_although_those_take_further_forms():
    """Two imitators lead, one of them in three compositions; the true pair begins two hundred behind."""
    rng = np.random.default_rng(12)
    one, two, aside, askew, *more = np.linalg.qr(rng.normal(size=(N, 6)))[0].T
    truth = 80.0 * one + 30.0 * two
    like = [one + 0.35 * two + 0.29 * aside, one + 0.35 * two + 0.29 * askew]
    forms = {'like': [like[0], *more], 'alike': like[1:], 'first': [one], 'second': [two]}
    candidates = [Candidate(name, '', form(f'{name} {k}', (column / np.linalg.norm(column))[None], np.ones(1)))
                  for name, columns in forms.items() for k, column in enumerate(columns)]
    screen = Screen(space(truth + 5.0 * sum(more) + rng.normal(size=N)), candidates, 1e9)
    alone = screen.by_cause()
    assert min(alone['like'].log_bayes, alone['alike'].log_bayes) > alone['first'].log_bayes + 2.0 * HOPELESS
    assert search(screen)[0].key >= {'first', 'second'}


def test_three_forms_of_a_rich_effect_do_not_crowd_out_what_one_form_explains_in_company():
    """Together they explain a sixth more than one of the true pair alone, which itself leads all that has one form."""
    rng = np.random.default_rng(15)
    one, two, *askew = np.linalg.qr(rng.normal(size=(N, 5)))[0].T
    truth = 80.0 * one + 50.0 * two
    rich = [truth / np.linalg.norm(truth) + np.sqrt(0.6) * aside for aside in askew]
    candidates = [Candidate(name, '', form(f'{name} {k}', (column / np.linalg.norm(column))[None], np.ones(1)))
                  for name, columns in {'rich': rich, 'first': [one], 'second': [two]}.items()
                  for k, column in enumerate(columns)]
    screen = Screen(space(truth + rng.normal(size=N)), candidates, 1e9)
    assert search(screen)[0].names == ('first', 'second')


def test_much_leaner_forms_are_a_cause_beside_gross_evidence_too():
    """Forty coefficients that imitate two effects of one each, which save more than a form may leave over."""
    rng = np.random.default_rng(9)
    rich = np.linalg.qr(rng.normal(size=(N, 40)))[0].T
    one, two = rich[:4].sum(axis=0, keepdims=True), rich[4:].sum(axis=0, keepdims=True)
    candidates = [Candidate('true', '', form('rich', rich, np.ones(40))),
                  Candidate('true', '', form('lean', one, np.ones(1))),
                  Candidate('other', '', form('rest', two, np.ones(1)))]
    best = search(Screen(space(10.0 * (one[0] + two[0]) + rng.normal(size=N)), candidates, 1e9))[0]
    assert best.log_bayes > LARGE_EVIDENCE
    assert best.names == ('other', 'true')


@pytest.mark.parametrize('size, named', [(3.0, True), (0.0, False)])
def test_a_name_is_held_to_what_its_controls_show_beside_it(size, named):
    """Of readings that scatter more than thought any rich form explains some; of a swing only its own does."""
    rng = np.random.default_rng(11)
    rich = np.linalg.qr(rng.normal(size=(N, 11 * 20)))[0].T.reshape(11, 20, N)
    data = rng.normal(size=N) * (1.0 if named else 2.0) + size * rich[0].sum(axis=0)
    candidates = [Candidate('swing', '', form('swing', rich[0], np.ones(20)))]
    controls = [Candidate(UNKNOWN, 'swing', form(f'negative control {k}', rich[k], np.ones(20)), negative_control=True)
                for k in range(1, 11)]
    alone = Screen(space(data), candidates, 1e9).by_cause()['swing']
    beside = Screen(space(data), [*candidates, *controls], 1e9).by_cause()['swing']
    assert alone.log_bayes > MEMBER_ALARM
    assert beside.log_bayes == alone.log_bayes
    assert (not beside.refused) is named
    assert named or 'negative controls' in beside.refused


@pytest.mark.parametrize('exact', [True, False])
def test_what_a_large_effect_may_leave_over_is_no_further_effect(exact):
    """A further effect of ten standard deviations lies where the first, of three hundred, may be off by a twentieth."""
    rng = np.random.default_rng(5)
    place = np.sign(rng.normal(size=N))
    large = rng.normal(size=N)
    large /= np.linalg.norm(large)
    faint = large * place - large * float(large @ (large * place))
    faint /= np.linalg.norm(faint)
    data = 300.0 * large + 10.0 * faint + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('large', '', form('large', large[None], np.full(1, 30.0))),
                                  Candidate('faint', '', form('faint', faint[None], np.ones(1)))], 1e9,
                    modulations=None if exact else place[None])
    found = search(screen)
    assert found[0].key == ({'large', 'faint'} if exact else {'large'})
    pair, = (s for s in found if s.key == {'large', 'faint'})
    assert bool(pair.refused) is not exact
    names, _, weights = probabilities(found, 2)
    assert len(weights) == len(found) and sum(weights) == pytest.approx(1.0)
    assert names['large'] == pytest.approx(1.0)


def test_by_how_much_a_wrong_form_falls_behind_saturates():
    """It is off by a tenth: odds that grow without bound where forms are exact, and hardly where they are not."""
    rng = np.random.default_rng(6)
    place = np.sign(rng.normal(size=N))
    right = rng.normal(size=N)
    wrong = right * (1.0 + 0.1 * place)
    noise = rng.normal(size=N)

    def behind(size: float, functions: np.ndarray | None) -> float:
        data = size * right / np.linalg.norm(right) + noise
        forms = {name: form(name, (column / np.linalg.norm(column))[None], np.full(1, size))
                 for name, column in (('right', right), ('wrong', wrong))}
        screen = Screen(space(data), [Candidate(name, '', f) for name, f in forms.items()], 1e9, modulations=functions)
        alone = screen.by_cause()
        return joined(screen, NONE, alone['right']).log_bayes - joined(screen, NONE, alone['wrong']).log_bayes

    assert behind(1000.0, None) > 50.0 * behind(100.0, None) > 50.0
    assert 0.0 < behind(1000.0, place[None]) < 5.0
    assert behind(4000.0, place[None]) == pytest.approx(behind(1000.0, place[None]), abs=0.5)


def test_profiles_that_share_columns_are_judged_as_if_each_were_alone(wide):
    """Also where the screen is extended by them, and given a set that one of them is in."""
    rng = np.random.default_rng(4)
    smooth = replace(wide, label='smooth', scale=wide.scale**2)
    candidates = [Candidate('rough', '', wide), Candidate('smooth', '', smooth),
                  Candidate('other', '', form('other', rng.normal(size=(2, N)), np.ones(2)))]
    data = np.tensordot(wide.columns[:, :, 0].T, 9.0 * smooth.scale * rng.normal(size=40), axes=1) + rng.normal(size=N)
    together = Screen(space(data), candidates, 1e9)
    grown = Screen(space(data), candidates[2:], 1e9).extended(candidates[:2])
    for name, candidate in (('rough', candidates[0]), ('smooth', candidates[1])):
        alone = Screen(space(data), [candidate], 1e9).by_cause()[name].log_bayes
        assert together.by_cause()[name].log_bayes == pytest.approx(alone, rel=1e-9)
        assert grown.by_cause()[name].log_bayes == pytest.approx(alone, rel=1e-9)
    given = together.by_cause([Member('smooth', 1, 10.0, 3.0)])
    same = grown.by_cause([Member('smooth', 2, 10.0, 3.0)])
    for name, member in given.items():
        assert same[name].log_bayes == pytest.approx(member.log_bayes, rel=1e-9)


def test_what_is_not_asked_for_is_not_judged(wide):
    screen = Screen(space(np.zeros(N)), [Candidate('wide', '', wide), Candidate('other', '', wide)], 1e9)
    assert set(screen.by_cause((), lambda effect: effect == 'other')) == {'other'}
    assert np.flatnonzero(np.isfinite(screen.judge_all((), []).log_bayes)).tolist() == [1]
    assert set(screen.by_cause()) == {'wide', 'other'}


def test_forms_of_two_sources_are_not_of_one_effect():
    """A beam has one dead path; that another effect has a source of its own is another matter."""
    rng = np.random.default_rng(4)
    columns = np.linalg.qr(rng.normal(size=(N, 3)))[0].T
    here, there, laser = (replace(form(label, columns[[i]], np.ones(1)), source=label)
                          for i, label in enumerate(('here', 'there', 'laser')))
    data = 30.0 * columns.sum(axis=0) + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('air', '', here), Candidate('air', '', there),
                                  Candidate('fringes', '', laser)], 1e9)
    further = screen.by_cause([Member('air', 0, 10.0)])
    assert further['fringes'].log_bayes > 20.0
    assert 'air' not in further or further['air'].log_bayes < 1.0


def test_a_family_of_its_own_is_not_thinned_by_others():
    """What it weighs is that of a name, however many shapeless families there are in addition."""
    rng = np.random.default_rng(5)
    cause = form('cause', rng.normal(size=(1, N)), np.ones(1))
    data = cause.columns[0, :, 0] + rng.normal(size=N)
    others = [Candidate('?', f'shapeless {k}', form(f'{k}', rng.normal(size=(3, N)), np.ones(3)), 8.0)
              for k in range(12)]

    def evidence(own: bool) -> float:
        lean = [Candidate('?', 'lean', cause, 1.0, own=own), Candidate('name', '', cause)]
        found = Screen(space(data), [*lean, *others], 1e9).by_cause()
        return found[BEYOND if own else '?'].log_bayes - found['name'].log_bayes

    assert evidence(own=True) == pytest.approx(0.0, abs=1e-6)
    assert evidence(own=False) == pytest.approx(-np.log(13.0), abs=1e-6)


@pytest.mark.parametrize(('one', 'other'), [(9.0, 6.5), (6.5, 9.0)])
def test_what_a_set_must_bring_does_not_depend_on_the_order_of_names(one, other):
    """Names of a set have no order: each is held against the set without it.  Evidence stays what it is."""
    sets = [EffectSet(tuple(Member(name, 0, 0.0) for name in names), size)
            for names, size in (('a', one), ('b', other), ('ab', 10.0))]
    earned = {s.key: s for s in search_module._each_earned({s.key: s for s in sets})}
    assert earned[frozenset('ab')].log_bayes == 10.0
    assert 'further effect needs' in earned[frozenset('ab')].refused
    assert not earned[frozenset('a')].refused and not earned[frozenset('b')].refused


def test_what_has_no_name_may_do_what_an_effect_does_and_more():
    """Two jumps that are no counts beside a large bend without a name: one cause without a name, not two."""
    rng = np.random.default_rng(5)
    place = np.linspace(-1.0, 1.0, N)
    steps = [(np.arange(N) >= at).astype(float) for at in (N // 3, N // 2)]
    data = 12.0 * place**2 + 16.9 * steps[0] - 14.7 * steps[1] + rng.normal(size=N)
    slips = [Candidate('count_slip', '', form(f'from stop {k} on', 1e7 * step[None], np.full(1, 1e-6)))
             for k, step in enumerate(steps)]
    bend = Candidate(UNKNOWN, 'bend', form('bend', place[None]**2, np.full(1, 10.0)))
    screen = Screen(space(data), [*slips, bend], 1e9, frozenset({'count_slip'}), effects={'count_slip': CountSlip()})
    found = search(screen)
    assert found[0].key == {UNKNOWN} and len(found[0].members) == 3
    assert probabilities(found, 19)[0].get('count_slip', 0.0) < 0.1


@pytest.mark.parametrize(('outlier', 'low', 'high'), [(False, 0.3, 0.5), (True, 0.95, 1.01)])
def test_a_name_beside_a_pattern_without_one_may_be_part_of_it(outlier, low, high):
    """One cause that no form describes may need two of them, and the name is said as what it is, possible; beside an
    arrival that is off a name stays one."""
    rng = np.random.default_rng(8)
    columns = np.linalg.qr(rng.normal(size=(N, 21)))[0].T
    names = [Candidate(f'effect {k}', '', form(f'{k}', columns[[k]], np.full(1, 10.0))) for k in range(20)]
    other = Candidate(UNKNOWN, 'cell', replace(form('cell', columns[[20]], np.full(1, 10.0)), of_one_arrival=outlier),
                      own=True)
    data = 15.0 * columns[0] + 15.0 * columns[20] + rng.normal(size=N)
    found = search(Screen(space(data), [*names, other], 1e9))
    likely, _, _ = probabilities(found, 20)
    assert likely[UNKNOWN] > 0.99 and low < likely['effect 0'] < high and 'effect 0' in found[0].key
    alone = search(Screen(space(data - 15.0 * columns[20]), [*names, other], 1e9))
    assert probabilities(alone, 20)[0]['effect 0'] > 0.99


@pytest.mark.parametrize(('jump', 'counted'), [(5 * 316.4e-9, True), (1.69e-6, False)])
def test_a_slip_is_a_whole_number_of_counts(jump, counted):
    """A jump known to a few nanometres that is no multiple of λ/4 is no slip; what jumps then has no name."""
    rng = np.random.default_rng(3)
    step = (np.arange(N) >= N // 2).astype(float)
    data = jump / 1e-7 * step + rng.normal(size=N)
    slip = form('from stop 5 on', 1e7 * step[None], np.full(1, 1e-6))
    screen = Screen(space(data), [Candidate('count_slip', '', slip)], 1e9, effects={'count_slip': CountSlip()})
    found = search(screen)
    assert found[0].key == ({'count_slip'} if counted else {UNKNOWN})
    names, _, _ = probabilities(found, 19)
    assert names['count_slip'] > 0.9 if counted else names['count_slip'] < 0.5
    unmodelled, = (s for s in found if s.key == {UNKNOWN})
    assert log_prior(unmodelled, 19) == pytest.approx(log_prior(EffectSet(found[0].members, 0.0), 19) - (
        IMITATION_PENALTY if counted else 0.0))
