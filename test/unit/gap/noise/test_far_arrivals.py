"""Arrivals that tails take for noise: one is spoken of, many are a finding."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.estimate.noise import Law
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap import diagnose
from stepdiag_ros.gap.constants import SCATTER_ALARM
from stepdiag_ros.gap.inference.joint import fit_jointly
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.arrival_law import DOFS, reweighed
from stepdiag_ros.gap.noise.far_arrivals import FarArrivals
from stepdiag_ros.gap.preprocess.observe import observe


def off_by(log, amounts):
    """The log with its lengths off by ``amounts`` [m] at stops, by their number."""
    table, values = reduce_log(log), log.displacement.values.copy()
    for stop, amount in amounts.items():
        low, high = table.displacement_rows[stop]
        values[low:high] += amount
    return replace(log, displacement=replace(log.displacement, values=values))


@pytest.mark.long
def test_an_arrival_that_is_far_off_is_spoken_of_where_tails_take_it(case):
    """A count lost before the last stop of a run: nobody can tell it from an arrival that is off, and it is said."""
    log = case.untidy('{position: {dof: 3}}')
    table = reduce_log(log)
    stop = int(np.flatnonzero(table.run == table.run[0])[-1])
    far = off_by(log, {stop: 28e-6})
    said = [next((w for w in diagnose(one, [kind() for kind in all_effects().values()]).warnings
                  if 'would look the same' in w), '') for one in (log, far)]
    assert not said[0] and f'{table.run_ids[table.run[stop]]} stop {table.index[stop]}' in said[1]


def test_more_arrivals_far_off_than_tails_reach_are_a_finding(case):
    """A law of tails that takes them all only says how far they are off."""
    log, rng = case.untidy('{position: {dof: 3}}'), np.random.default_rng(4)
    moved = np.flatnonzero(reduce_log(log).axis < 3)
    amounts = dict(zip(rng.choice(moved, 9, replace=False), rng.uniform(4e-5, 2e-4, 9), strict=True))
    both = (FarArrivals.of(in_tails(one)).beyond_tails() for one in (log, off_by(log, amounts)))
    evidence, words = zip(*both, strict=True)
    assert evidence[0] < 3.0 and evidence[1] > SCATTER_ALARM
    assert 'which no noise does' in words[1]


def in_tails(log):
    """The fit of the machine alone in a noise whose errors have the wildest tails that are noise."""
    observation = observe(log)
    noise = replace(noise_of(observation), position_law=Law(min(DOFS), 0.0))
    return fit_jointly(observation, [], reweighed(observation, noise, observation.table))
