"""A live run of setups with ways of their own: axes together, a face in turn; live, replayed, read: the same bits."""

import json

import numpy as np
import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.demo import same_result
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.log import NONE
from stepdiag_ros.nodes.replaying import assemble

SETUPS = """setups:
  body: {standoff: 0.20, psd_offset: [0.02, 0.0], from: [0.10, 0, 0], to: [0, 0.08, 0.06], steps: 2}
  face: {standoff: 0.20, psd_offset: [0.02, 0.0], from: [0, 0, 0], to: [0.10, 0.08, 0], moves: YX, repeats: 2}
  line: {standoff: 0.20, psd: false, from: [0, 0, 0], to: [0.10, 0, 0], targets: [0.03], overrun: 0.0005}
  grid: {station: [-0.1, -0.1, -0.1], tool: [0.02, 0.0, -0.1], from: [0, 0, 0], to: [0.10, 0.08, 0.06], moves: grid}
"""


@pytest.fixture(scope='module')
def live(module_domain, tmp_path_factory, write_cell, measured):
    """Outcome, feedback, live document and bag of one calibration."""
    from stepdiag_ros.nodes.bringup import Bringup
    folder = tmp_path_factory.mktemp('ways')
    path = write_cell(folder, name='ways')
    text = path.read_text(encoding='utf-8')
    begin, end = text.index('setups:'), text.index('geometry:')
    path.write_text(text[:begin] + SETUPS + text[end:], encoding='utf-8')
    with Bringup(path, bag_folder=folder, runtime=folder / 'run') as running:
        yield measured(running.operator, folder / 'whole')


def test_the_machine_goes_the_ways_of_the_cell_file(live):
    outcome, feedback, _, bag = live
    assert outcome.run_ids == ('body/0/+', 'body/0/-', 'face/0/+', 'face/0/-', 'face/1/+', 'face/1/-', 'line/0/+-',
                               'grid/0/+', 'grid/0/-')
    assert any(f.doing == 'axes together to stop 2 of 2' for f in feedback)
    log = read_log(bag)
    steps = log.steps
    body = (steps.run == steps.run_ids.index('body/0/+')) & (steps.phase == 1)
    np.testing.assert_allclose(steps.commanded[body], [[0.10, 0.0, 0.0], [0.05, 0.04, 0.03], [0.0, 0.08, 0.06]])
    assert set(steps.axis[body]) == {NONE}
    back = (steps.run == steps.run_ids.index('face/1/-')) & (steps.phase == 1)
    assert steps.axis[back].tolist() == [NONE, 0, 1] and steps.index[back].tolist() == [2, 1, 0]
    assert not [w for w in log.warnings if 'missing' in w or 'repeats' in w]


def test_an_end_is_approached_from_beyond_without_a_reset_and_without_a_detector(live):
    log = read_log(live[3])
    steps = log.steps
    line = (steps.run == steps.run_ids.index('line/0/+-')) & (steps.phase == 1)
    assert steps.direction[line].tolist() == [1, 1, 1, -1, -1, -1] and steps.index[line].tolist() == [0, 1, 2, 2, 1, 0]
    np.testing.assert_allclose(steps.commanded[line, 0], [0.0, 0.03, 0.1, 0.1, 0.03, 0.0])
    table = reduce_log(log)
    mine = table.setup == table.setup_names.index('line')
    # It went half a millimetre further and came back: the reading of the way there is in the bag.
    beam = log.displacement.values[log.displacement.setup == log.displacement.setup_names.index('line'), 0]
    assert np.nanmax(beam) > 0.1004 and np.isfinite(table.displacement[mine, 0]).all()
    assert not np.isfinite(table.spot[mine]).any()


def test_a_station_reads_the_distance_to_the_retroreflector(live):
    log = read_log(live[3])
    table = reduce_log(log)
    mine = (table.setup == table.setup_names.index('grid')) & (table.direction > 0)
    assert mine.sum() == 8 and not np.isfinite(table.spot[mine]).any()
    place = table.commanded[mine] + [0.02, 0.0, -0.1]
    distance = np.linalg.norm(place - [-0.1, -0.1, -0.1], axis=1)
    np.testing.assert_allclose(table.displacement[mine, 0], distance - distance[0], atol=5e-5)
    assert set(live[2]['stations']) == {'grid'}


def test_live_replayed_and_read_have_the_same_bits(live):
    _, _, document, bag = live
    offline = evaluate(read_log(bag)).to_json_dict()
    assert same_result(json.loads(json.dumps(document)), json.loads(json.dumps(offline)))
    assert same_result(evaluate(assemble(bag).build()).to_json_dict(), offline)
    assert [part['kind'] for part in offline['parts']] == ['body diagonal', 'face step diagonal', 'line',
                                                           'multilateration']
