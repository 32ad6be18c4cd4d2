"""A cell along the moves of its own log shows what it showed, and along others' what they allow."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.model.log import MOVE
from stepdiag_ros.virtual.replay import Replay, began

from ..conftest import small_cell

QUIET = {'displacement': 0.0, 'spot': 0.0, 'position_repeatability': 0.0, 'angle_repeatability': 0.0}


@pytest.fixture(scope='module')
def log():
    return _simulated({'servo_settling': {'amp': 5e-6, 'tau': 0.2},
                       'structural_thermal_drift': {'amp': [3e-5, -2e-5, 4e-5], 'tau': 300.0}})


def _simulated(effects):
    from stepdiag_ros.model.description import Noise
    from stepdiag_ros.virtual.offline import simulate_log
    cell = small_cell(effects)
    cell = replace(cell, description=replace(cell.description, noise=Noise(**QUIET)))
    return cell, simulate_log(cell)


def _run_of(log):
    dwells = np.flatnonzero(log.steps.phase == 1)
    place = np.searchsorted(log.steps.time_ns[dwells], log.displacement.time_ns, side='right') - 1
    return log.steps.run[dwells][place]


def test_its_own_log_comes_out_again(log):
    cell, log = log
    replay = Replay(cell, log.steps, began(cell, log))
    length, spot = replay.seen(replay.world(), log.displacement.time_ns, _run_of(log))
    assert np.abs(length - log.displacement.values).max() < 1e-12
    assert np.abs(spot - log.spot.values).max() < 1e-12


def test_drifts_begin_with_the_environments_record_or_a_mounting_before_the_first_move(log):
    cell, log = log
    assert began(cell, log) == began(cell, replace(log, environment={})) \
        == min(int(s.time_ns[0]) for s in log.environment.values())


def test_a_slower_machine_arrives_when_its_log_says(log):
    """Twice as much time between the events: the axes creep from the dwell's begin as before."""
    cell, log = log
    steps = log.steps
    slow = replace(steps, time_ns=steps.time_ns[0] + 2 * (steps.time_ns - steps.time_ns[0]))
    creep = [e for e in Replay(cell, slow, 0).world().effects if e.name == 'servo_settling']
    both = []
    for events in (steps, slow):
        replay = Replay(cell, events, int(events.time_ns[0]) - 20_000_000_000)
        # A run that begins where the last ended counts from what is left there, which takes its time.
        dwells = np.flatnonzero((events.phase == 1) & (events.axis < 3) & (events.repeat == 0) & (events.direction > 0))
        time, run = events.time_ns[dwells] + 50_000_000, events.run[dwells]
        both.append(replay.seen(replay.world(creep), time, run)[0] - replay.seen(replay.world([]), time, run)[0])
    assert np.abs(both[0]).max() > 1e-6
    assert np.abs(both[0] - both[1]).max() < 1e-8


def test_moves_that_the_log_does_not_time_are_over_before_the_dwell(log):
    cell, log = log
    steps = log.steps
    kept = np.ones(len(steps), bool)
    kept[np.flatnonzero((steps.phase == MOVE) & (steps.axis == 255))] = False
    less = replace(steps, **{name: getattr(steps, name)[kept] for name in (
        'time_ns', 'run', 'setup', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')})
    replay = Replay(cell, less, began(cell, log))
    length, _ = replay.seen(replay.world([]), log.displacement.time_ns, _run_of(log))
    bare = _simulated({})[1]
    assert np.abs(length - bare.displacement.values).max() < 1e-7
