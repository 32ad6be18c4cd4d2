"""The further run: what it is expected to bring."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.estimate.noise import arrivals
from stepdiag_ros.estimate.reduce import PIECES
from stepdiag_ros.gap.alternatives.known_physics import Beyond
from stepdiag_ros.gap.experiment_design.discrimination import apart, distance, evidence_of, expected_evidence, predicted
from stepdiag_ros.gap.experiment_design.extended_log import ExtendedLog, Known, Run, with_run
from stepdiag_ros.gap.experiment_design.next_run import GREY, PATIENT_S, recommend
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.model.log import NONE, STOOD
from stepdiag_ros.model.path import stops


@pytest.fixture(scope='module')
def small_offset(case):
    """A small offset of the detector's zero, fitted, and two sets of effects that could make it."""
    observation = case.observe(effect_class('psd_zero_offset')(x=2e-5, y=-2e-5))
    first = {name: (effect_class(name)(), effect_class(name)().appearance(observation.view)[0])
             for name in ('psd_zero_offset', 'psd_gain')}
    return fit_jointly(observation, [first['psd_zero_offset']], noise_of(observation)), first


def _only(*members):
    """A set of effects that acts in one way."""
    return [(1.0, list(members))]


def test_a_run_is_recommended_that_tells_two_effects_apart(small_offset):
    joint, first = small_offset
    run = recommend(joint, [_only(first['psd_zero_offset']), _only(first['psd_gain'])])
    assert run.between == ('psd_gain', 'psd_zero_offset')
    assert run.setup.name.endswith('.2') and run.evidence > 0.5
    said = run.to_json_dict()
    assert said['setup'] == run.setup.name and 'psd_gain and psd_zero_offset' in said['text']


def test_a_run_is_recommended_against_a_cause_without_a_name(small_offset):
    joint, first = small_offset
    bent = Beyond(), Beyond().appearance(joint.observation.view)[0]
    run = recommend(joint, [_only(first['psd_zero_offset']), _only(bent)])
    assert run.between == ('psd_zero_offset', 'unknown')
    assert run.error < 0.45 and 'psd_zero_offset and something else' in run.text


def test_no_run_tells_an_effect_from_itself(small_offset):
    joint, first = small_offset
    assert recommend(joint, [_only(first['psd_gain']), _only(first['psd_gain'])]) is None
    assert recommend(joint, [_only(first['psd_gain'])]) is None


def test_a_drift_without_a_like_in_the_extended_log_is_not_predicted(small_offset):
    joint, first = small_offset
    effect, form = first['psd_zero_offset']
    strange = replace(form, label='strange', columns=np.random.default_rng(1).normal(size=form.columns.shape))
    assert recommend(joint, [_only(first['psd_gain']), _only((effect, strange))]) is None


def _worth(joint, sets, run):
    """How well one run tells two sets apart."""
    extended = ExtendedLog(joint, run, Known(joint))
    one, other = (extended.forecast(members) for members in sets)
    return apart([(1.0, one)], [(1.0, other)])


def _explained_by(case, effect, models):
    """A log with an effect, fitted with the first of some forms, and all of them as sets of one."""
    observation = observe(case.log(effect))
    sets = []
    for name, label in models:
        one = effect_class(name)()
        sets.append([(one, next(form for form in one.appearance(observation.view) if form.label == label))])
    joint = fit_jointly(observation, sets[0], noise_of(observation))
    return joint, sets


@pytest.fixture(scope='module')
def creep_or_beam(case):
    """A mount that creeps, fitted, and the beam that could turn instead."""
    return _explained_by(case, effect_class('mirror_mount_creep')(amp=[2e-5, -1e-5], tau=40.0), [
        ('mirror_mount_creep', 'each mounting nearly the same amount, many time constants'),
        ('beam_pointing_drift', 'smooth')])


@pytest.fixture(scope='module')
def gain_or_light(case):
    """A gain, fitted, and the background that could be instead."""
    return _explained_by(case, effect_class('psd_gain')(x=-0.2, y=-0.2), [
        ('psd_gain', 'alike in x and y'), ('ambient_light', 'linear')])


@pytest.mark.parametrize('more', [
    {'again_after': 600.0},  # how little a mount that stands still moves is predicted; the beam goes on
    {'watch': 120.0}])  # what relaxes is seen, while nothing moves, at the sensors' noise, not at that of arrivals
def test_waiting_tells_creep_from_a_turning_beam(creep_or_beam, more):
    joint, sets = creep_or_beam
    run = Run(replace(joint.observation.log.description.setups['ppp'], name='ppp.2'))
    assert _worth(joint, sets, replace(run, **more)) > _worth(joint, sets, run) + 1.0


def test_what_only_time_can_tell_is_measured_after_a_wait(creep_or_beam):
    joint, sets = creep_or_beam
    found = recommend(joint, [[(1.0, members)] for members in sets])
    span = np.ptp(joint.observation.table.time_s)
    assert span <= found.run.wait < span + 60.0 and found.run.watch >= PATIENT_S
    assert found.to_json_dict()['wait_s'] == found.run.wait and found.text.startswith('Leave the cell as it is for')


def test_less_light_tells_background_from_a_gain(gain_or_light):
    joint, sets = gain_or_light
    run = Run(replace(joint.observation.log.description.setups['ppp'], name='ppp.2'), mirror_turn_rad=(4e-4, -4e-4))
    assert _worth(joint, sets, replace(run, light=GREY)) > 10.0 * _worth(joint, sets, run) > 0.0


def test_a_run_left_standing_is_measured_twice(small_offset):
    joint, _ = small_offset
    table = joint.observation.table
    rows = np.flatnonzero(table.setup == 0)
    setup = replace(joint.observation.log.description.setups['ppp'], name='ppp.2')
    longer, _ = with_run(table, Run(setup, light=GREY, again_after=600.0), joint.observation.log.description, 0)
    new = longer.setup == len(table.setup_names)
    assert longer.setup_names[-1] == 'ppp.2' and new.sum() == 2 * len(rows)
    assert sorted(set(longer.repeat[new])) == [0, 1, 2, 3] and len(set(longer.run_ids)) == len(longer.run_ids)
    first, second = np.split(np.flatnonzero(new), 2)
    assert longer.dwell_ns[second[0]] - longer.done_ns[first[-1]] == 600_000_000_000
    later, _ = with_run(table, Run(setup, wait=900.0), joint.observation.log.description, 0)
    assert later.dwell_ns[len(table)] - longer.dwell_ns[len(table)] == 900_000_000_000
    np.testing.assert_allclose(longer.intensity[new], GREY * np.tile(table.intensity[rows], 2))


def test_evidence_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(3)

    def drawn():
        return predicted(rng.normal(size=9), rng.normal(size=(9, 2)))
    a, b = drawn(), drawn()
    whole = [np.eye(9) + f.spread @ f.spread.T for f in (a, b)]
    ratio, shift = np.linalg.solve(whole[1], whole[0]), a.mean - b.mean
    plain = 0.5 * (np.trace(ratio) - 9 - np.linalg.slogdet(ratio)[1] + shift @ np.linalg.solve(whole[1], shift))
    assert evidence_of(a, b) == pytest.approx(plain) and evidence_of(a, a) == pytest.approx(0.0, abs=1e-9)
    middle = 0.5 * (whole[0] + whole[1])
    logs = [np.linalg.slogdet(v)[1] for v in (middle, *whole)]
    assert distance(a, b) == pytest.approx(0.125 * shift @ np.linalg.solve(middle, shift)
                                            + 0.5 * logs[0] - 0.25 * logs[1] - 0.25 * logs[2])
    assert apart([(0.5, a), (0.5, b)], [(0.5, b), (0.5, a)]) <= 1e-9
    # A mixture that holds the other's forecast as well is distinguished from it by no more than its share.
    assert 0.0 < expected_evidence([(1.0, a)], [(0.5, a), (0.5, b)]) <= np.log(2.0) + 1e-9


def test_forms_that_come_with_less_light_do_not_shift_the_others(gain_or_light):
    """The sum signal takes part in a form only where it moves: with a grey filter it does."""
    joint, sets = gain_or_light
    view, effect = joint.observation.view, sets[1][0][0]
    cycle = next(form for form in effect.appearance(view) if 'period_s' in form.shape)
    run = Run(replace(joint.observation.log.description.setups['ppp'], name='ppp.2'), light=GREY)
    extended = ExtendedLog(joint, run, Known(joint))
    assert len(effect.appearance(extended.view)) > len(effect.appearance(view))
    assert extended._laid(effect, cycle).shape == cycle.shape


def test_a_run_is_watched_as_a_log_would_show_it(small_offset):
    """The stops predicted of a long first dwell are those that such a log is cut into."""
    joint, _ = small_offset
    log = joint.observation.log
    setup = replace(log.description.setups['ppp'], name='ppp.2')
    table, like = with_run(joint.observation.table, Run(setup, watch=60.0), log.description, 0)
    new = np.flatnonzero(table.setup == len(joint.observation.table.setup_names))
    stood = table.axis[new] == STOOD
    assert stood.sum() == PIECES and not stood[0] and stood[1:PIECES + 1].all() and len(like) == len(new)
    assert np.array_equal(table.dwell_ns[new[1:PIECES]], table.done_ns[new[:PIECES - 1]])
    assert table.done_ns[new[PIECES - 1]] - table.dwell_ns[new[0]] == 60_000_000_000
    assert len({tuple(number) for number in arrivals(table)[new[:PIECES + 1]]}) == 1
    first, further = np.unique(table.run[new])[:2]
    assert table.dwell_ns[table.run == further].min() > table.done_ns[table.run == first].max()


def test_a_line_that_the_log_does_not_hold_is_a_run_like_others(small_offset):
    joint, _ = small_offset
    log = joint.observation.log
    setup = replace(log.description.setups['ppp'], name='lin_y.1', length=0.2, stops=5)
    description = replace(log.description, setups={**log.description.setups, 'lin_y.1': setup})
    old = joint.observation.table
    without = replace(old, setup_names=tuple('lin_x.2' if name == 'lin_y' else name for name in old.setup_names))
    table, like = with_run(without, Run(setup, known=False), description, 3)
    new = np.flatnonzero(table.setup == len(old.setup_names))
    path = stops(description, 'lin_y.1')
    passes = 2 * description.plan.repeats
    assert len(new) == passes * 5 and (like == 3).all() and len(set(table.run_ids)) == len(table.run_ids)
    np.testing.assert_allclose(table.commanded[new[:10]], np.concatenate([path.positions, path.positions[::-1]]))
    assert sorted(set(table.direction[new])) == [-1, 1] and set(table.axis[new]) == {1, NONE}
    assert (np.diff(table.dwell_ns[new]) > 0).all()
