"""The 21 errors beside the effects: averaged over forms, with what forms leave uncertain."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.standing import with_standing
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.inference.averaged import WITHIN, averaged_solution, compositions
from stepdiag_ros.gap.inference.candidates import Candidate, Screen
from stepdiag_ros.gap.inference.joint import fit_jointly, refitted
from stepdiag_ros.gap.inference.projection import Projection
from stepdiag_ros.gap.inference.search import EffectSet
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.arrival_law import as_it_is
from stepdiag_ros.gap.preprocess.observe import observe, sane_fit
from stepdiag_ros.model.machine import CURVES
from stepdiag_ros.virtual.cell import parse_cell


@pytest.fixture
def found(lost_motion):
    return lost_motion


def test_without_an_effect_the_errors_are_those_of_the_fit(unaffected):
    null = unaffected
    fit, table = null.joint.fit, null.joint.observation.table
    plain = with_standing(solution_of(fit, table), fit, table)
    assert np.array_equal(null.solution.value, plain.value)
    assert np.array_equal(null.solution.covariance, plain.covariance)


def test_the_form_that_was_chosen_is_among_the_compositions(found):
    chosen = {m.candidate for m in found.raw[0].members}
    assert any({m.candidate for m in c.members} == chosen for c in compositions(found.screen, found.raw[0]))


@pytest.mark.long
def test_a_form_that_explains_part_of_two_effects_does_not_drive_out_the_set(case):
    """Forms are exchanged beside the others, not gathered from none: alone a free profile may explain more."""
    both = case.diagnose(effect_class('non_rigid_coupling')(motion='EYY', by='Z', amp=8e-5),
                         effect_class('backlash')(B=[1e-6, 1e-6, 2e-6]))
    assert {m.effect for m in both.raw[0].members} == {'non_rigid_coupling', 'backlash'}
    found = compositions(both.screen, both.raw[0])
    assert {m.candidate for m in both.raw[0].members} in [{m.candidate for m in c.members} for c in found]
    assert all(c.log_bayes > both.raw[0].log_bayes - WITHIN for c in found)


def test_what_has_no_name_is_weighed_against_the_names_that_may_stand_for_it(found):
    best, screen = found.raw[0], found.screen
    member = best.members[0]
    same = screen.candidates[member.candidate]
    screen = screen.extended([replace(same, effect=UNKNOWN, family='like it')])
    unmodelled = replace(member, effect=UNKNOWN, candidate=len(screen.candidates) - 1, penalty=0.0)
    names = {m.effect for c in compositions(screen, replace(best, members=(unmodelled,))) for m in c.members}
    assert names == {UNKNOWN, member.effect}


@pytest.mark.long
def test_beside_a_motion_that_bends_others_may_bend_unseen(case):
    """A coupling that a log sees says that there may be others, as large, that it does not see."""
    bent = case.diagnose(effect_class('non_rigid_coupling')(motion='EZX', by='Y', amp=1.5e-5))
    (active,) = bent.joint.active
    assert active.effect.name == 'non_rigid_coupling' and active.form.beside is not None
    alone = replace(bent.joint, active=(replace(active, form=replace(active.form, beside=None)),))
    rigid = [replace(c, form=replace(c.form, beside=None)) for c in bent.screen.candidates]
    bare = Screen(bent.screen.parity, rigid, bent.screen.noise_dof, bent.screen.repeatable, bent.screen.modulations)
    more, less = bent.solution.sigma, averaged_solution(alone, bare, bent.raw[0]).sigma
    assert np.linalg.norm(more) > np.linalg.norm(less) and np.any(more > 1.5 * less)


def test_what_drifted_before_the_log_began_is_uncertain(case):
    """As large a change of all lengths as the air makes in the log is in the errors, and no reading shows it."""
    drift = effect_class('air_refraction_drift')(dT=4.0, dP=0.0, tau=300.0)
    found = diagnose(case.log(drift), [drift])
    (active,) = found.joint.active
    assert active.effect.name == 'air_refraction_drift'
    index = np.abs(active.coefficients).max()
    for name, length in (('EXX', 0.5), ('EYY', 0.4), ('EZZ', 0.3)):
        assert found.solution.sigma[found.solution.names.index((name, 5))] > 0.8 * index * length


@pytest.mark.parametrize('name', ['air_refraction_drift', 'scale_thermal_expansion', 'squareness_drift'])
def test_a_drift_stays_uncertain_before_the_log_however_it_is_tuned(case, name):
    for form in effect_class(name)().appearance(case.observe().view):
        for one in (form, *([form.retune(form.shape)] if form.retune else [])):
            assert one.beside is not None and 'before the log' in one.beside.label
            assert one.beside.columns.shape[1:] == one.columns.shape[1:]


def test_a_form_that_the_log_cannot_tell_from_the_chosen_one_counts(found):
    """The same form, but for something that the fit would take for an error of the machine."""
    joint, (active,) = found.joint, found.joint.active
    place = joint.fit.parameters.slice('EAX').start
    absorbed = joint.fit.jacobian.toarray()[:, place].reshape(active.form.columns.shape[1:])
    much = 1e-5 / np.abs(active.coefficients).max()
    other = replace(active.form, label='other', columns=active.form.columns + much * absorbed)
    alone = averaged_solution(joint, found.screen, found.raw[0])
    both = averaged_solution(joint, found.screen.extended([Candidate(active.effect.name, '', other)]), found.raw[0])
    row = both.names.index(('EAX', 1))
    gap = abs(both.value[row] - alone.value[row])
    assert 'EAX' in CURVES and gap > 1e-6
    assert both.sigma[row] > 0.5 * gap > 5.0 * alone.sigma[row]


def test_of_a_correction_the_share_stays_uncertain_that_the_log_would_let_pass(found):
    """A hundredfold gap leaves a form less room to be wrong unseen."""
    large = found.solution
    true_fit = solution_of(found.joint.fit, found.joint.observation.table)
    assert np.all(large.sigma >= 0.999 * true_fit.sigma)
    assert large.sigma.max() < 0.5 * np.abs(large.value).max()


@pytest.mark.long
def test_errors_are_as_uncertain_as_tails_leave_them(case):
    """By drawing: arrivals of Student's t with four degrees of freedom.  With the weights that the log itself gave its
    arrivals taken for known, the squares of what the errors are off by were 1.4 times their variances."""
    square, given = [], []
    for seed in range(12):
        observation = observe(case.untidy('{position: {dof: 4}, angle: {dof: 4}}', seed=seed))
        true = to_reference_lines(parse_cell(case.text.replace('seed: 11', f'seed: {seed}')).geometry)
        space = Projection.of(observation.table, observation.fit, noise_of(observation))
        noise, _ = as_it_is(space, observation.table)
        fit = sane_fit(observation.log, observation.table, observation.fit.theta, noise)
        joint = fit_jointly(refitted(observation, fit), [], noise)
        found = averaged_solution(joint, None, EffectSet((), 0.0))
        alone = with_standing(solution_of(joint.fit, observation.table), joint.fit, observation.table)
        off = found.value - [
            true.square[name] if name in true.square else true.curves[name](found.positions[name][knot])
            for name, knot in found.names]
        for squares, solution in ((square, found), (given, alone)):
            variance = np.diag(solution.covariance)
            squares.append(np.mean(off[variance > 1e-24]**2 / variance[variance > 1e-24]))
    assert np.mean(given) > 1.3 and 0.8 < np.mean(square) < 1.2
