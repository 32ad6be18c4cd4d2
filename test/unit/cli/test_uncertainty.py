"""``stepdiag uncertainty``: table, JSON, Monte Carlo, complaints."""

import json
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).parents[3] / 'cells' / 'demo.yaml'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp('uncertainty') / 'demo'
    write_log(simulate_log(load_cell(DEMO), rate=300.0, in_motion=False), folder)
    return str(folder)


def test_json_adds_up(bag, capsys):
    assert main(['uncertainty', bag, '--at', '0.1,0.08,0.06', '--json', '--draws', '40']) == 0
    answer = json.loads(capsys.readouterr().out)
    for name in ('EXX', 'EAY'):
        parts = np.array([line['errors'][name] for line in answer['contributors']])
        np.testing.assert_allclose(np.sqrt((parts**2).sum(0)), answer['errors'][name]['sigma'], rtol=1e-6)
        drawn = np.array(answer['monte_carlo']['sigma'][name])[1:]
        assert np.all((0.6 < drawn / np.array(answer['errors'][name]['sigma'])[1:])
                      & (drawn / np.array(answer['errors'][name]['sigma'])[1:] < 1.5))
    at = np.array([line['at_points_m'] for line in answer['contributors']])[:, 0]
    covariance = np.array(answer['points']['covariance_m2'][0])
    np.testing.assert_allclose((at**2).sum(0), np.diag(covariance), rtol=1e-6)


def test_the_table_and_a_budget_of_ones_own(bag, tmp_path, capsys):
    assert main(['uncertainty', '--print-budget']) == 0
    mine = tmp_path / 'mine.yaml'
    mine.write_text(capsys.readouterr().out.replace('value: 2.5e-8', 'value: 2.5e-5'))
    assert main(['uncertainty', bag, '--budget', str(mine)]) == 0
    out = capsys.readouterr().out
    wavelength = next(line for line in out.splitlines() if line.startswith('EXX'))
    assert 'wavelength 5.00' in wavelength           # 0.2 m × 25 µm/m
    assert 'combined' in out and 'expanded' in out


def test_other_methods_are_drawn(bag, capsys):
    assert main(['uncertainty', bag, '--method', 'step_diagonal', '--draws', '5']) == 0
    assert '5 draws through step_diagonal' in capsys.readouterr().out


@pytest.mark.parametrize(('arguments', 'said'), [
    (['--budget', 'nowhere.yaml'], 'nowhere.yaml: cannot be read'),
    (['--at', '1,2'], "--at is '1,2'"),
    (['--draws', '1'], '--draws is 1'),
    (['--method', 'step_diagonal'], 'give --draws'),
    (['--method', 'nothing', '--draws', '3'], 'not known; choose from'),
    (['--method', 'iso230_2', '--draws', '3'], 'gives no error curves'),
])
def test_complaints_are_one_line(bag, capsys, arguments, said):
    assert main(['uncertainty', bag, *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count('\n') == 1


def test_no_log(capsys):
    assert main(['uncertainty']) == 2
    assert 'no log given' in capsys.readouterr().err
