"""``stepdiag map``: from a log to the deviation at any point."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.prediction import deviation
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).parents[3] / 'cells' / 'demo.yaml'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp('map') / 'demo'
    write_log(simulate_log(load_cell(DEMO), rate=500.0, in_motion=False), folder)
    return folder


def test_points_of_ones_own_agree_with_the_truth(bag, capsys):
    assert main(['map', str(bag), '--at', '0.11,0.07,0.05', '--at', '0.2,0.16,0.12', '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    cell = load_cell(DEMO)
    want = deviation(to_reference_lines(cell.geometry), cell.description.machine, np.array(answer['position_m']))
    off, sigma = np.array(answer['deviation_m']) - want, np.array(answer['sigma_m'])
    assert np.all(np.abs(off) < 4.0 * sigma)
    command = np.array(answer['command_m'])
    np.testing.assert_allclose(command - answer['position_m'], -np.array(answer['deviation_m']), atol=3e-9)


def test_what_may_not_be_acted_on_gives_no_command(tmp_path, capsys):
    cell = load_cell(DEMO)
    log = simulate_log(replace(cell, air=replace(cell.air, compensated=False, sensors=())), rate=100.0, in_motion=False)
    write_log(log, tmp_path / 'vacuum')
    table = tmp_path / 'map.csv'
    assert main(['map', str(tmp_path / 'vacuum'), '--grid', '2', '--csv', str(table)]) == 0
    out = capsys.readouterr().out
    assert 'no command is given: the lengths are not corrected for air' in out and 'cancelled' not in out
    assert 'command' not in table.read_text().splitlines()[0]
    assert main(['map', str(tmp_path / 'vacuum'), '--at', '0.1,0.1,0.1', '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer['command_m'] is None and min(answer['sigma_m'][0]) > 1e-6


def test_table_and_picture(bag, tmp_path, capsys):
    table, picture = tmp_path / 'map.csv', tmp_path / 'map.png'
    assert main(['map', str(bag), '--grid', '4', '--csv', str(table), '--out', str(picture)]) == 0
    out = capsys.readouterr().out
    assert 'largest at' in out and str(table) in out and str(picture) in out
    with table.open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 64
    largest = max(np.linalg.norm([float(row[f'd{c}_m']) for c in 'xyz']) for row in rows)
    assert f'largest {largest * 1e6:.2f} µm' in out
    assert 0.02 < np.mean(imread(picture)[..., :3].min(axis=2) < 0.95) < 0.6


@pytest.mark.parametrize(('options', 'complaint'), [
    (['--at', '1,2'], '--at is'),
    (['--at', 'a,b,c'], '--at is'),
    (['--tool', '0,0,nan'], '--tool is'),
    (['--grid', '1'], '--grid is 1'),
    (['--out', 'map.txt'], 'unknown kind of picture'),
    (['--at', '0,0,0', '--out', 'map.png'], 'draws the grid'),
    (['--method', 'body_diagonal'], 'no errors to predict with'),
    (['--method', 'magic'], 'not known'),
    (['--csv', '/nonexistent/folder/map.csv'], 'cannot be written'),
])
def test_bad_requests_are_one_line(bag, options, complaint, capsys):
    assert main(['map', str(bag), *options]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert len(error.strip().splitlines()) == 1
