"""A further run joins its log."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.joined import joined
from stepdiag_ros.model.log import CalibrationLog, Samples, ScalarSeries
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
seed: 3
machine: {name: small, volume: [0.5, 0.4, 0.3], tool: [0.0, 0.0, -0.12]}
plan: {steps: 3, repeats: 1}
setups:
  ppp: {standoff: 0.3}
  npp: {standoff: 0.3, psd_offset: [0.02, 0.0]}
  lin_x: {standoff: 0.4, length: 0.5, stops: 3}
misalignments: {drawn: {laser: 4e-4, mirror: 3e-4}}
sampling: {interferometer: 50, psd: 50, in_motion: true}
"""
HOUR_NS = 3_600_000_000_000


@pytest.fixture(scope='module')
def cell():
    return parse_cell(CELL)


@pytest.fixture(scope='module')
def whole(cell):
    return simulate_log(cell)


def _only(log: CalibrationLog, setups: tuple[str, ...]) -> CalibrationLog:
    """What was measured in some of the setups, as a log of its own would hold it."""
    def samples(of: Samples) -> Samples:
        keep = np.isin(of.setup, [of.setup_names.index(name) for name in setups])
        number = np.array([setups.index(name) if name in setups else -1 for name in of.setup_names])
        return Samples(of.time_ns[keep], of.values[keep], of.health[keep], of.refractive_index[keep], setups,
                       number[of.setup[keep]], of.block[keep])
    steps = log.steps
    keep = np.isin(steps.setup, [steps.setup_names.index(name) for name in setups])
    runs = np.unique(steps.run[keep])
    cut = {name: getattr(steps, name)[keep]
           for name in ('time_ns', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')}
    number = np.array([setups.index(name) if name in setups else -1 for name in steps.setup_names])
    span = cut['time_ns'].min(), cut['time_ns'].max()

    def during(series: ScalarSeries) -> ScalarSeries:
        mine = (series.time_ns >= span[0]) & (series.time_ns <= span[1])
        return ScalarSeries(series.time_ns[mine], series.value[mine], series.variance[mine])
    air = {key: during(series) for key, series in log.environment.items()}
    return replace(log, steps=replace(steps, run_ids=tuple(steps.run_ids[run] for run in runs),
                                      run=np.searchsorted(runs, steps.run[keep]), setup_names=setups,
                                      setup=number[steps.setup[keep]], **cut),
                   displacement=samples(log.displacement), spot=samples(log.spot), environment=air)


def _later(log: CalibrationLog, by_ns: int = HOUR_NS) -> CalibrationLog:
    def moved(part):
        return replace(part, time_ns=part.time_ns + by_ns)
    return replace(log, steps=moved(log.steps), displacement=moved(log.displacement), spot=moved(log.spot),
                   environment={key: moved(series) for key, series in log.environment.items()}, source='later')


def test_what_was_cut_is_whole_again(whole):
    again = joined(_only(whole, ('ppp', 'npp')), _only(whole, ('lin_x',)))
    table, expected = reduce_log(again), reduce_log(whole)
    assert table.run_ids == expected.run_ids and table.setup_names == expected.setup_names
    for name in ('run', 'setup', 'done_ns', 'commanded', 'displacement', 'spot', 'intensity'):
        np.testing.assert_array_equal(getattr(table, name), getattr(expected, name))
    assert len(np.unique(again.spot.block)) == len(np.unique(whole.spot.block))
    assert set(again.environment) == set(whole.environment) and again.environment
    assert all(np.all(np.diff(series.time_ns) > 0) for series in again.environment.values())


def test_a_diagonal_once_more_is_a_mounting_of_its_own(whole):
    further = _later(_only(whole, ('npp',)))
    again = joined(joined(whole, further), _later(further))
    table = reduce_log(again)
    assert table.setup_names == ('ppp', 'npp', 'lin_x', 'npp.2', 'npp.3')
    assert again.description.setups['npp.2'].psd_offset == (0.02, 0.0)
    assert set(again.description.setups) == {'ppp', 'npp', 'lin_x', 'npp.2', 'npp.3'}
    assert {'npp.2/0/+', 'npp.3/0/-'} <= set(table.run_ids) and len(set(table.run_ids)) == len(table.run_ids)
    mine, other = table.setup == 1, table.setup == 3
    np.testing.assert_array_equal(table.displacement[mine], table.displacement[other])


@pytest.mark.parametrize(('change', 'words'), [
    (lambda log: replace(log, description=replace(log.description, machine=replace(
        log.description.machine, chain='XFYZ'))), 'machine.chain'),
    (lambda log: replace(log, description=replace(log.description, plan=replace(
        log.description.plan, steps=9))), 'plan.steps'),
    (lambda log: replace(log, displacement=Samples.empty(3)), '3 beams'),
    (lambda log: _later(log, -2 * HOUR_NS), 'earlier log first')])
def test_what_does_not_belong_together_is_told(whole, change, words):
    with pytest.raises(StepdiagError, match=words):
        joined(whole, change(_later(whole)))
