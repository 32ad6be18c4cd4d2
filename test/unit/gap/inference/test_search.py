"""What a set's members explain of the rest, and the size that an unknown course is held to."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Form
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import GROSS_EVIDENCE, MEMBER_ALARM
from stepdiag_ros.gap.inference import search as search_module
from stepdiag_ros.gap.inference.candidates import Candidate, Member, Screen
from stepdiag_ros.gap.inference.evidence import SIZES
from stepdiag_ros.gap.inference.joint import solve, tuned
from stepdiag_ros.gap.inference.parity import Parity
from stepdiag_ros.gap.inference.search import HOPELESS, EffectSet, least_growth, search

N = 400


class White:
    """Readings that are white as they come."""

    rows, factor = np.arange(N), np.eye(N)

    def __call__(self, flat: np.ndarray) -> np.ndarray:
        return flat


def space(data: np.ndarray) -> Parity:
    """White data that no machine absorbs anything of; the last quarter is of the spot."""
    nothing = np.zeros((1, 1))
    return Parity(data, N, (N, 0), np.repeat([0, 1], [3 * N // 4, N // 4]), np.arange(N), 1.0, [White()],
                  np.zeros((N, 1)), nothing, nothing, np.zeros((N, 1, 3)))


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
    basis = screen.basis([Member('wide', 0, 10.0, 5.0)])[:N]
    np.testing.assert_allclose(np.eye(N) - basis @ basis.T,
                               np.linalg.inv(np.eye(N) + columns @ columns.T), atol=0.02)


def test_an_unknown_course_does_not_swallow_another_effect(wide):
    """The other effect lies where the course could go, but only if it were far rougher than it is."""
    rng = np.random.default_rng(2)
    other = form('other', wide.columns[30:40, :, 0].sum(axis=0, keepdims=True), np.full(1, 3.0))
    course = np.tensordot(wide.columns[:, :, 0].T, wide.scale * rng.normal(size=40) * 30.0, axes=1)
    data = course + 4.0 * other.columns[0, :, 0] + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('wide', '', wide), Candidate('other', '', other)], 1e9)
    first = screen.by_effect()['wide']
    assert first.size < SIZES[-1] * 1.01
    assert screen.by_effect([first])['other'].log_bayes > 20.0
    # Were the course free, it could be all of it.
    free = Member('wide', 0, first.log_bayes, 1e6)
    assert screen.by_effect([free])['other'].log_bayes < 1.0


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
    first = screen.by_effect()['A']
    assert screen.candidates[first.candidate].form is rich
    assert screen.by_effect([first])['B'].log_bayes < 3.0
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
    alone = screen.by_effect()
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
    alone = screen.by_effect()
    assert alone['true'].log_bayes > GROSS_EVIDENCE
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
    alone = screen.by_effect()
    assert min(alone['like'].log_bayes, alone['alike'].log_bayes) > alone['first'].log_bayes + 2.0 * HOPELESS
    assert search(screen)[0].key == {'first', 'second'}


def test_beside_gross_evidence_leaner_forms_are_no_cause(wide):
    """A rich form explains all; a lean one with another effect explains no more, only at less cost."""
    rng = np.random.default_rng(8)
    course = np.tensordot(wide.columns[:, :, 0].T, wide.scale * rng.normal(size=40) * 1000.0, axes=1)
    first = wide.columns[0, :, 0]
    parts = np.stack([first * (first @ course), course - first * (first @ course)])
    candidates = [Candidate('true', '', wide), Candidate('true', '', form('lean', parts[:1], np.ones(1))),
                  Candidate('other', '', form('rest', parts[1:], np.ones(1)))]
    screen = Screen(space(course + rng.normal(size=N)), candidates, 1e9)
    rich = screen.as_first(Member('true', 0, 0.0))
    lean = screen.as_first(Member('true', 1, 0.0))
    other = screen.by_effect([lean])['other']
    less, more = EffectSet((rich,), rich.log_bayes), EffectSet((lean, other), lean.log_bayes + other.log_bayes)
    assert rich.log_bayes > GROSS_EVIDENCE
    assert more.log_bayes > less.log_bayes + least_growth(less)
    assert not search_module._enough(screen, less, more)


def test_much_leaner_forms_are_a_cause_beside_gross_evidence_too():
    """Forty coefficients that imitate two effects of one each, which save more than a form may leave over."""
    rng = np.random.default_rng(9)
    rich = np.linalg.qr(rng.normal(size=(N, 40)))[0].T
    one, two = rich[:4].sum(axis=0, keepdims=True), rich[4:].sum(axis=0, keepdims=True)
    candidates = [Candidate('true', '', form('rich', rich, np.ones(40))),
                  Candidate('true', '', form('lean', one, np.ones(1))),
                  Candidate('other', '', form('rest', two, np.ones(1)))]
    best = search(Screen(space(10.0 * (one[0] + two[0]) + rng.normal(size=N)), candidates, 1e9))[0]
    assert best.log_bayes > GROSS_EVIDENCE
    assert best.names == ('other', 'true')


@pytest.mark.parametrize('size, named', [(3.0, True), (0.0, False)])
def test_a_name_is_held_to_what_its_decoys_show_beside_it(size, named):
    """Of readings that scatter more than thought any rich form explains some; of a swing only its own does."""
    rng = np.random.default_rng(11)
    rich = np.linalg.qr(rng.normal(size=(N, 11 * 20)))[0].T.reshape(11, 20, N)
    data = rng.normal(size=N) * (1.0 if named else 2.0) + size * rich[0].sum(axis=0)
    candidates = [Candidate('swing', '', form('swing', rich[0], np.ones(20)))]
    decoys = [Candidate(UNKNOWN, 'swing', form(f'decoy {k}', rich[k], np.ones(20)), decoy=True) for k in range(1, 11)]
    alone = Screen(space(data), candidates, 1e9).by_effect()['swing']
    beside = Screen(space(data), [*candidates, *decoys], 1e9).by_effect()['swing']
    assert alone.log_bayes > MEMBER_ALARM
    assert (beside.log_bayes == alone.log_bayes) is named
    assert (beside.log_bayes > MEMBER_ALARM) is named


@pytest.mark.parametrize('at, named', [(3 * N // 4, True), (0, False)])
def test_a_form_leaves_nothing_over_in_channels_where_it_explains_nothing(at, named):
    """A gross effect of the lengths and a faint one: beside it if of the spot, perhaps its own if of the lengths."""
    rng = np.random.default_rng(5)
    gross, faint = np.zeros(N), np.zeros(N)
    gross[:3 * N // 4] = rng.normal(size=3 * N // 4)
    faint[at:at + N // 4] = np.sign(rng.normal(size=N // 4))
    faint -= gross * (gross @ faint) / (gross @ gross)
    data = 3.0 * gross + 6.0 * faint / np.linalg.norm(faint)
    screen = Screen(space(data), [Candidate('gross', '', form('gross', gross[None], np.ones(1))),
                                  Candidate('faint', '', form('faint', faint[None], np.ones(1)))], 1e9)
    assert (search(screen)[0].key == {'gross', 'faint'}) == named


def test_courses_that_share_columns_are_judged_as_if_each_were_alone(wide):
    """Also where the screen is extended by them, and given a set that one of them is in."""
    rng = np.random.default_rng(4)
    smooth = replace(wide, label='smooth', scale=wide.scale**2)
    candidates = [Candidate('rough', '', wide), Candidate('smooth', '', smooth),
                  Candidate('other', '', form('other', rng.normal(size=(2, N)), np.ones(2)))]
    data = np.tensordot(wide.columns[:, :, 0].T, 9.0 * smooth.scale * rng.normal(size=40), axes=1) + rng.normal(size=N)
    together = Screen(space(data), candidates, 1e9)
    grown = Screen(space(data), candidates[2:], 1e9).extended(candidates[:2])
    for name, candidate in (('rough', candidates[0]), ('smooth', candidates[1])):
        alone = Screen(space(data), [candidate], 1e9).by_effect()[name].log_bayes
        assert together.by_effect()[name].log_bayes == pytest.approx(alone, rel=1e-9)
        assert grown.by_effect()[name].log_bayes == pytest.approx(alone, rel=1e-9)
    given = together.by_effect([Member('smooth', 1, 10.0, 3.0)])
    same = grown.by_effect([Member('smooth', 2, 10.0, 3.0)])
    for name, member in given.items():
        assert same[name].log_bayes == pytest.approx(member.log_bayes, rel=1e-9)


def test_what_is_not_asked_for_is_not_judged(wide):
    screen = Screen(space(np.zeros(N)), [Candidate('wide', '', wide), Candidate('other', '', wide)], 1e9)
    assert set(screen.by_effect((), lambda effect: effect == 'other')) == {'other'}
    assert set(screen.judge_all((), [])) == {1}
    assert set(screen.by_effect()) == {'wide', 'other'}


def test_forms_of_two_sources_are_not_of_one_effect():
    """A beam has one dead path; that another effect has a source of its own is another matter."""
    rng = np.random.default_rng(4)
    columns = np.linalg.qr(rng.normal(size=(N, 3)))[0].T
    here, there, laser = (replace(form(label, columns[[i]], np.ones(1)), source=label)
                          for i, label in enumerate(('here', 'there', 'laser')))
    data = 30.0 * columns.sum(axis=0) + rng.normal(size=N)
    screen = Screen(space(data), [Candidate('air', '', here), Candidate('air', '', there),
                                  Candidate('fringes', '', laser)], 1e9)
    further = screen.by_effect([Member('air', 0, 10.0)])
    assert further['fringes'].log_bayes > 20.0
    assert 'air' not in further or further['air'].log_bayes < 1.0


def test_a_family_of_its_own_is_not_thinned_by_others():
    """What it weighs is that of a name, however many shapeless families stand beside it."""
    rng = np.random.default_rng(5)
    cause = form('cause', rng.normal(size=(1, N)), np.ones(1))
    data = cause.columns[0, :, 0] + rng.normal(size=N)
    others = [Candidate('?', f'shapeless {k}', form(f'{k}', rng.normal(size=(3, N)), np.ones(3)), 8.0)
              for k in range(12)]

    def evidence(own: bool) -> float:
        lean = [Candidate('?', 'lean', cause, 1.0, own=own), Candidate('name', '', cause)]
        found = Screen(space(data), [*lean, *others], 1e9).by_effect()
        return found['?'].log_bayes - found['name'].log_bayes

    assert evidence(own=True) == pytest.approx(0.0, abs=1e-6)
    assert evidence(own=False) == pytest.approx(-np.log(13.0), abs=1e-6)


@pytest.mark.parametrize('count, named', [(1, False), (24, True), (40, True)])
def test_a_name_yields_to_a_leaner_pattern_and_holds_against_a_shapeless_one(wide, count, named):
    """A course leaves a twentieth of a gross disturbance, which one column without a name explains wholly, or many."""
    rng = np.random.default_rng(6)
    extra = np.linalg.qr(np.concatenate([wide.columns[:, :, 0], rng.normal(size=(count, N))]).T)[0].T[40:]
    course = np.tensordot(wide.columns[:, :, 0].T, wide.scale * rng.normal(size=40), axes=1)
    course *= np.sqrt(0.95) * 100.0 / np.linalg.norm(course)
    gross = course + np.sqrt(0.05) * 100.0 * extra[0]
    nameless = np.concatenate([gross[None] / 100.0, extra[1:]])
    pattern = Candidate(UNKNOWN, 'nameless', form('nameless', nameless, np.ones(count)), 8.0)
    screen = Screen(space(gross + rng.normal(size=N)), [Candidate('course', '', wide), pattern], 1e9)
    assert (search(screen)[0].key == {'course'}) == named


@pytest.mark.parametrize(('one', 'other'), [(9.0, 6.5), (6.5, 9.0)])
def test_what_a_set_must_bring_does_not_depend_on_the_order_of_names(monkeypatch, one, other):
    """Names of a set have no order: a set's own evidence is judged, not what an effect before has left of it."""
    monkeypatch.setattr(search_module, '_enough', lambda screen, less, more: more.log_bayes > less.log_bayes + 3.0)
    sets = [EffectSet(tuple(Member(name, 0, 0.0) for name in names), size)
            for names, size in (('a', one), ('b', other), ('ab', 10.0))]
    earned = {s.key: s.log_bayes for s in search_module._each_earned(None, {s.key: s for s in sets})}
    assert earned[frozenset('ab')] == 9.0
