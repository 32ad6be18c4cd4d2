"""Which of noise and effects a log shows: what decides between the noises that were tried."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.gap.inference import noise_or_effects
from stepdiag_ros.gap.inference.candidates import Candidate, Member
from stepdiag_ros.gap.inference.joint import fit_jointly, freed, size_of
from stepdiag_ros.gap.inference.noise_or_effects import (
    ONE_ARRIVAL,
    Settled,
    _against,
    _of_the_law,
    _patterns,
    left,
    settle_in_noise,
    total_evidence,
)
from stepdiag_ros.gap.inference.search import EffectSet, log_prior
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.arrival_law import suspicion

SLIP = EffectSet((Member('count_slip', 0, 28.9),), 28.9)


def settled(alone, acting):
    """What was found in one noise, of given total log evidence without and with the slip."""
    screen = SimpleNamespace(candidates=[SimpleNamespace(effect='count_slip')])
    return Settled(SimpleNamespace(total=alone, active=()), SimpleNamespace(total=acting, active=(1,)),
                   [SLIP, EffectSet((), 0.0)], screen)


@pytest.fixture
def stated_evidence(monkeypatch):
    monkeypatch.setattr(noise_or_effects, 'total_evidence', lambda joint, sets, screen: joint.total)


def test_columns_made_of_readings_are_corrected_in_every_noise(case):
    """A swing with the reading itself takes noise away with it: its evidence beside another noise's pays for that."""
    observation = case.observe()
    noise = noise_of(observation)
    shape = observation.view.reading.shape
    phase = np.random.default_rng(5).uniform(-np.pi, np.pi, shape)
    length = np.arange(shape[1]) == 0
    made = Form('swing', (np.sin(phase) * length)[None], ('a',), np.full(1, 3e-8),
                by_reading=(1e7 * np.cos(phase) * length)[None])
    screen = SimpleNamespace(candidates=[Candidate('cyclic_nonlinearity', '', made)])
    chosen = [EffectSet((Member('cyclic_nonlinearity', 0, 10.0),), 10.0)]
    joint = fit_jointly(observation, [(Effect(), made)], noise)
    active = replace(joint.active[0], coefficients=np.array([3e-8]))
    of_readings, of_others = (total_evidence(replace(joint, active=(replace(active, form=form),)), chosen, screen)
                              for form in (active.form, replace(active.form, by_reading=None)))
    cost = joint.parity.log_jacobian(3e-8 * made.by_reading[0])
    assert of_readings - of_others == pytest.approx(cost, abs=1e-6) and cost < -0.5


def test_a_walk_costs_as_much_as_it_is_far(case):
    """Forty numbers drawn anew: the evidence of the fit that has them is that of the readings' covariance with them."""
    observation, rng = case.observe(), np.random.default_rng(6)
    noise, shape = noise_of(observation), np.zeros((40, *observation.view.reading.shape))
    shape[:, :, -2:] = rng.standard_normal((*shape.shape[:2], 2))
    walk = Form('walk', shape, tuple(str(i) for i in range(40)), np.full(40, 3e-8), process=True)
    drawn = np.tensordot(3e-8 * rng.standard_normal(40), shape, axes=1)
    table = replace(observation.table, spot=observation.table.spot + drawn[:, -2:])
    observation = replace(observation, table=table)
    joint, alone = (fit_jointly(observation, chosen, noise) for chosen in ([(Effect(), walk)], []))
    screen = SimpleNamespace(candidates=[Candidate('unknown', '', walk)])
    one, none = EffectSet((Member('unknown', 0, 10.0),), 10.0), EffectSet((), 0.0)
    space, form = alone.parity, joint.active[0].form
    columns = space.project(form) * size_of(form)
    normal, along = np.eye(40) + columns.T @ columns, columns.T @ space.data
    exactly = 0.5 * float(along @ np.linalg.solve(normal, along) - np.linalg.slogdet(normal)[1])
    ahead = total_evidence(joint, [one], screen) - total_evidence(alone, [none], screen)
    assert exactly > 30.0
    assert ahead - log_prior(one, 1) + log_prior(none, 1) == pytest.approx(exactly, abs=2.0)


def test_a_form_that_is_not_quite_right_makes_no_law_of_the_noise(case):
    """A twentieth of an effect of hundreds of standard deviations, left by its form, is no tail of arrivals' errors."""
    observation = case.observe()
    noise, view = noise_of(observation), observation.view
    shape = np.zeros((1, *view.reading.shape))
    places = np.unique(np.column_stack([view.setup, view.commanded.round(6)]), axis=0, return_inverse=True)[1].ravel()
    shape[0, :, -2:] = np.random.default_rng(4).standard_normal((len(view.time), 2))[places]
    form = Form('made up', shape, ('a',), np.full(1, 1e-5))
    truly = 1e-5 * shape[0] * (1.0 + 0.05 * view.direction[:, None])
    table = replace(observation.table, spot=observation.table.spot + truly[:, -2:])
    joint = fit_jointly(replace(observation, table=table), [(Effect(), form)], noise)
    space = joint.parity.projection
    assert suspicion(space, freed(joint.observation.table, joint.active)) > 12.0
    assert suspicion(space, left(joint)) < 6.0
    exact = Form('as it is', truly[None] / 1e-5, ('a',), np.full(1, 1e-5))
    best = fit_jointly(replace(observation, table=table), [(Effect(), exact)], noise)
    chosen, screen = [EffectSet((Member('', 0, 10.0),), 10.0)], SimpleNamespace(candidates=[Candidate('', '', form)])
    behind = total_evidence(best, chosen, screen) - total_evidence(joint, chosen, screen)
    assert 0.0 < behind < 30.0


@pytest.mark.usefixtures('stated_evidence')
@pytest.mark.parametrize('acting', [settled(100.0, 50.0), settled(0.0, 55.0)])
def test_what_explains_less_than_the_noise_alone_is_gone(acting):
    """Also where it was found in the noise that wins."""
    nothing = settled(100.0, 50.0)
    found = _against(nothing, acting)
    assert found.joint is nothing.alone and not found.sets[0].members
    assert all(s.log_bayes < 0.0 for s in found.sets if s.members)


@pytest.mark.usefixtures('stated_evidence')
def test_an_effect_is_as_far_ahead_as_in_all():
    found = _against(settled(100.0, 50.0), settled(0.0, 120.0))
    assert found.joint.total == 120.0 and found.sets[0].members
    assert 0.0 < found.sets[0].log_bayes < 28.9


@pytest.mark.parametrize(('again', 'claimed'), [('shaped', 'again'), ('nothing', 'plain')])
def test_what_was_found_in_a_noise_that_its_rest_refutes_is_held_to_that_rest(monkeypatch, again, claimed):
    """Also where it explains more in all: a jump that is none beside tails.  Unless it is all that there is."""
    shaped, empty = [SimpleNamespace(form=SimpleNamespace(of_one_arrival=False))], []
    noise = SimpleNamespace(has_tails=False)

    def one(name, active, evidence):
        return SimpleNamespace(name=name, evidence=evidence, sets=[],
                               joint=SimpleNamespace(active=active, observation=None, parity=parity))

    parity = SimpleNamespace(projection=SimpleNamespace(in_noise=lambda noise: None))
    plain, alone = one('plain', shaped, 120.0), SimpleNamespace(parity=parity)
    in_noise = iter([one('alone', empty, 0.0), one('again', shaped if again == 'shaped' else empty, 110.0)])
    monkeypatch.setattr(noise_or_effects, 'Settled', lambda *parts: plain)
    for name, value in {'noise_of': noise, 'fit_jointly': alone, 'settle': (), 'suspicion': 50.0, '_settles': False,
                        'as_it_is': (noise, 40.0), '_without_outliers': plain.joint, 'left': None}.items():
        monkeypatch.setattr(noise_or_effects, name, lambda *given, value=value: value)
    monkeypatch.setattr(noise_or_effects, '_settled_in', lambda *given: next(in_noise))
    monkeypatch.setattr(noise_or_effects, '_against', lambda nothing, acting: acting)
    assert settle_in_noise(SimpleNamespace(table=None), {}).name == claimed


def found(label_and_single, sets):
    """What was found in one noise: forms by label, each with whether it does no more than one arrival's error."""
    forms = [SimpleNamespace(label=label, of_one_arrival=single) for label, single in label_and_single]
    screen = SimpleNamespace(candidates=[SimpleNamespace(effect='unknown', form=form) for form in forms])
    return Settled('alone', SimpleNamespace(active=tuple(SimpleNamespace(form=form) for form in forms)), sets, screen)


def test_one_arrival_that_is_off_is_a_tail_where_errors_have_tails():
    """It is not claimed, and says why; a pattern of several is."""
    alone, several = (EffectSet((Member('unknown', k, 21.0),), 21.0) for k in (0, 1))
    both = found((('one stop', True), ('jump', False)), [alone, several, EffectSet((), 0.0)])
    assert [a.form.label for a in _patterns(both)] == ['jump']
    left = _of_the_law(both)
    assert left.joint == 'alone' and [s.refused for s in left.sets] == ['', '', ONE_ARRIVAL]
    assert left.sets[-1].log_bayes == 21.0, 'evidence is not overwritten'
