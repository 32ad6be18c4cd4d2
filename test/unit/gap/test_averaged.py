"""The 21 errors beside the effects: averaged over forms, with what forms leave uncertain."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.standing import with_standing
from stepdiag_ros.gap.averaged import averaged_solution, compositions
from stepdiag_ros.gap.screen import Candidate
from stepdiag_ros.model.machine import CURVES


@pytest.fixture(scope='module')
def found(case):
    return case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6]))


def test_without_an_effect_the_errors_are_those_of_the_fit(case):
    null = case.diagnose()
    fit, table = null.joint.fit, null.joint.observation.table
    plain = with_standing(solution_of(fit, table), fit, table)
    assert np.array_equal(null.solution.value, plain.value)
    assert np.array_equal(null.solution.covariance, plain.covariance)


def test_the_form_that_was_chosen_is_among_the_compositions(found):
    chosen = {m.candidate for m in found.raw[0].members}
    assert any({m.candidate for m in c.members} == chosen for c in compositions(found.screen, found.raw[0]))


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
