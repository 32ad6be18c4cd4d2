"""Counts that were lost are adopted where they were lost: in motion or in a dwell, once or more often, of one beam."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from stepdiag_ros.effects import all_effects, effect_class
from stepdiag_ros.effects.count_slip import QUARTER
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.twin.adopt import CLOSED, adopt
from stepdiag_ros.twin.against import without_known
from stepdiag_ros.twin.lost_counts import _course
from stepdiag_ros.virtual.offline import simulate_log
from stepdiag_ros.virtual.replay import began

from ..conftest import small_cell, times_left

JUMP = 16.0 * QUARTER


def kinds():
    return [all_effects()[name]() for name in ('count_slip', 'backlash')]


def test_a_slip_at_rest_and_one_in_motion_are_a_course(tmp_path):
    cell = small_cell({}, 0.3)
    bare = simulate_log(cell)
    table, start = reduce_log(bare), began(cell, bare)
    at_rest, run = 21, int(table.run[21])
    moving = int(np.flatnonzero(table.run == run + 2)[5])
    times = [(0.6 * table.done_ns[at_rest] + 0.4 * table.dwell_ns[at_rest] - start) * 1e-9,
             (0.5 * table.done_ns[moving - 1] + 0.5 * table.dwell_ns[moving] - start) * 1e-9]
    course = {'seconds': sorted(t + d for t in times for d in (0.0, 1e-5)),
              'values': [[0.0] * 3, [JUMP] * 3, [JUMP] * 3, [-JUMP] * 3]}
    log = simulate_log(replace(cell, effects={'count_slip': {'course': course}}))
    found = diagnose(log, kinds())
    assert [one.name for one in found.effects] == ['count_slip'], found.unmodelled
    adopted = adopt(found)
    written = adopted.cell['effects']['count_slip']['course']
    lost = np.array(written['values'])[:, 0]
    np.testing.assert_allclose(lost, [0.0, JUMP, JUMP, -JUMP], atol=3e-7)
    period = float(np.median(np.diff(log.displacement.time_ns))) * 1e-9
    assert written['seconds'][0] == pytest.approx(times[0], abs=period)
    stood = (table.done_ns[moving - 1] - start) * 1e-9, (table.dwell_ns[moving] - start) * 1e-9
    assert stood[0] < written['seconds'][2] < stood[1]
    assert times_left(adopted.notes) <= CLOSED
    assert any(note.startswith('count_slip: when it was lost is taken over') for note in adopted.notes)
    path = tmp_path / 'adopted.yaml'
    path.write_text(yaml.safe_dump(adopted.cell))
    known, _ = without_known(log, path)
    assert diagnose(known, kinds()).verdict == 'no_gap'


def test_a_slip_of_one_beam_is_of_that_beam():
    cell = small_cell({'count_slip': {'jump': [0.0, JUMP, 0.0], 'arrival': 30.0}}, 0.1)
    setups = {name: replace(setup, beams=((0.0, 0.0), (0.01, 0.0), (0.0, 0.01)))
              for name, setup in cell.description.setups.items()}
    found = diagnose(simulate_log(replace(cell, description=replace(cell.description, setups=setups))), kinds())
    adopted = adopt(found)
    written = adopted.cell['effects']['count_slip']
    assert written['arrival'] == 30.0
    np.testing.assert_allclose(written['jump'], [0.0, JUMP, 0.0], atol=3e-7)
    assert times_left(adopted.notes) <= CLOSED


def test_one_number_is_of_all_beams():
    np.testing.assert_array_equal(effect_class('count_slip')(jump=JUMP).jump, [JUMP] * 3)


def test_beams_that_lose_count_at_once_are_one_step():
    course = _course(np.array([9.0, 4.0, 4.0]), [np.array([0.0, 0.0, 1e-6]), np.array([2e-6, 0.0, 0.0]),
                                                 np.array([0.0, 3e-6, 0.0])])
    assert len(course.seconds) == 4 and (np.diff(course.seconds) > 0.0).all()
    np.testing.assert_allclose(course.values, [[0, 0, 0], [2e-6, 3e-6, 0], [2e-6, 3e-6, 0], [2e-6, 3e-6, 1e-6]])
