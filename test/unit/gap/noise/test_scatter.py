"""Scatter without a pattern: arrivals that are off until the next move."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.gap.inference.evidence import judge
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.scatter import _mixture, _scores, outliers, scattered_arrivals
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log


def test_a_wide_share_of_scores_is_evidence_and_noise_is_not():
    rng = np.random.default_rng(4)
    quiet = [_mixture(rng.standard_normal(130), side) for _ in range(20) for side in (0.0, -1.0)]
    assert max(quiet) < 4.0
    score = rng.standard_normal(130)
    score[:20] -= 4.0 * rng.exponential(1.0, 20)
    assert _mixture(score, -1.0) > _mixture(score, 0.0) > 10.0
    assert _mixture(score, 1.0) < _mixture(score, 0.0)


def test_repeats_raised_by_what_is_off_do_not_hide_it():
    rng = np.random.default_rng(5)
    score = 0.4 * rng.standard_normal(260)
    score[:15] += 3.5 * rng.standard_normal(15)
    assert _mixture(score, 0.0) > 20.0


@pytest.fixture(scope='module')
def joint(case):
    observation = observe(case.log())
    return fit_jointly(observation, [], noise_of(observation))


def test_scores_are_white_however_many_steps_a_run_has(case):
    """They had a third of noise's variance at 100 steps, for what lies close together was left out: an alarm."""
    text = case.text.replace('steps: 5', 'steps: 40')
    observation = observe(simulate_log(parse_cell(text)))
    joint = fit_jointly(observation, [], noise_of(observation))
    view, space = joint.observation.view, joint.parity
    for axis in range(3):
        mine = np.flatnonzero((view.axis == axis) & (view.approach[:, axis] != 0))
        run = space.run_of_stop[mine]
        score = np.concatenate([_scores(joint, axis, mine[run == k], k, space.data) for k in np.unique(run)])
        assert abs(np.mean(score**2) - 1.0) < 5.0 * np.sqrt(2.0 / len(score))
    assert scattered_arrivals(joint)[0] < 4.0


def test_short_arrivals_are_seen_in_the_data(joint):
    evidence, _ = scattered_arrivals(joint)
    assert evidence < 6.0
    view, space = joint.observation.view, joint.parity
    rng = np.random.default_rng(6)
    short = np.where(rng.random(len(view.time)) < 0.2, rng.exponential(4.0, len(view.time)), 0.0)
    column = view.zeros(1)
    for axis in range(3):
        mine = view.axis == axis
        column[0, mine] = -(view.by_shift[axis] * (view.approach[:, axis] * short)[:, None])[mine]
    rest = space.data.copy()
    rest[:space.stops] += space.stop_part(column * joint.noise.position)[:, 0]
    evidence, words = scattered_arrivals(joint, rest)
    assert evidence > 12.0 and 'random' in words


def test_short_arrivals_compete_as_one_form(joint):
    assert outliers(joint) is None
    view, space = joint.observation.view, joint.parity
    off = np.flatnonzero((view.axis == 1) & (view.approach[:, 1] != 0))[3::9]
    column = view.zeros(1)
    column[0, off] = -8.0 * joint.noise.position * view.by_shift[1, off] * view.approach[off, 1, None]
    rest = space.data.copy()
    rest[:space.stops] += space.stop_part(column)[:, 0]
    form, ways = outliers(replace(joint, parity=replace(space, data=rest)))
    assert 'short' in form.label
    picked = set(np.flatnonzero(np.any(form.columns, axis=(0, 2))))
    assert set(off) <= picked and len(picked) <= len(off) + 3
    assert ways > 2.0 * len(off)


def test_a_step_that_stays_is_no_outlier(joint):
    view, space = joint.observation.view, joint.parity
    run = np.flatnonzero(view.run == 2)
    slip = view.zeros(1)
    slip[0, run[len(run) // 2:], :view.beams] = 6.0 * joint.noise.position
    slip = space.stop_part(slip)[:, 0]
    rest = space.data.copy()
    rest[:space.stops] += slip
    found = outliers(replace(joint, parity=replace(space, data=rest)))
    explained = 0.0 if found is None else _evidence(space, rest, found[0]) - found[1]
    assert explained < 0.5 * float(slip @ slip) - 12.0


def _evidence(space, data, form):
    columns = space.project(form)
    return judge((columns.T @ columns)[None], (columns.T @ data)[None], float(data @ data), sum(space.dof),
                 100.0)[0].log_bayes
