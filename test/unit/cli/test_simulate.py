"""``stepdiag simulate``: a cell file in, a bag out."""

import json
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'


def test_the_bag_holds_the_simulated_log(tmp_path, capsys):
    bag, stated = tmp_path / 'demo', tmp_path / 'truth.json'
    assert main(['simulate', str(DEMO), '--out', str(bag), '--truth', str(stated), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['runs'] == 28 and summary['stops'] == 232 and summary['machine'] == 'demo'
    log, expected = read_log(bag), simulate_log(load_cell(DEMO))
    assert log.description == expected.description
    np.testing.assert_array_equal(log.displacement.values, expected.displacement.values)
    np.testing.assert_array_equal(log.displacement.time_ns, expected.displacement.time_ns)
    np.testing.assert_array_equal(log.spot.values, expected.spot.values)
    np.testing.assert_array_equal(log.steps.time_ns, expected.steps.time_ns)
    np.testing.assert_array_equal(log.steps.commanded, expected.steps.commanded)
    assert set(log.environment) == set(expected.environment)
    assert json.loads(stated.read_text())['errors']['EXX']['value'][0] == 0.0


def test_options(tmp_path, capsys):
    bag = tmp_path / 'part'
    command = ['simulate', str(DEMO), '--out', str(bag), '--setups', 'lin_y', 'ppp', '--rate', '200',
               '--dwell-only', '--seed', '5']
    assert main(command) == 0
    assert 'runs' in capsys.readouterr().out
    log = read_log(bag)
    assert [run.split('/')[0] for run in log.steps.run_ids] == ['lin_y'] * 4 + ['ppp'] * 4
    assert main(command) == 2
    assert 'exists already' in capsys.readouterr().err
    assert main([*command, '--force']) == 0


@pytest.mark.parametrize(('arguments', 'words'), [
    (['{demo}', '--out', '{new}', '--setups', 'ppq'], "setup 'ppq'"),
    (['{demo}', '--out', '{new}', '--rate', '0'], '--rate is 0'),
    (['{tmp}/none.yaml', '--out', '{new}'], 'cannot be read'),
    (['{demo}', '--out', '{tmp}', '--force'], 'is no bag'),
])
def test_what_cannot_be(tmp_path, capsys, arguments, words):
    places = {'demo': DEMO, 'new': tmp_path / 'new', 'tmp': tmp_path}
    assert main(['simulate', *(a.format(**places) for a in arguments)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count('\n') == 1
    assert tmp_path.is_dir()
