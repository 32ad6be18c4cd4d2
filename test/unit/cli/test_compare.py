"""``stepdiag compare`` on a simulated log."""

import json
from pathlib import Path

import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.methods import METHODS

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope='module')
def simulated(tmp_path_factory):
    """A bag of the demo cell in two steps, and its truth."""
    place = tmp_path_factory.mktemp('compare')
    bag, truth, cell = place / 'demo', place / 'truth.json', place / 'demo.yaml'
    cell.write_text((ROOT / 'cells' / 'demo.yaml').read_text(encoding='utf-8').replace('steps: 4', 'steps: 2'),
                    encoding='utf-8')
    assert main(['simulate', str(cell), '--out', str(bag), '--truth', str(truth),
                 '--dwell-only', '--rate', '200']) == 0
    return bag, truth


def test_table_and_picture(simulated, tmp_path, capsys):
    bag, truth = simulated
    picture = tmp_path / 'compare.png'
    assert main(['compare', str(bag), '--truth', str(truth), '--out', str(picture)]) == 0
    out = capsys.readouterr().out
    assert 'Largest deviation from truth' in out
    for name in METHODS:
        assert name in out
    assert picture.stat().st_size > 20_000


@pytest.mark.long
def test_json(simulated, capsys):
    bag, truth = simulated
    assert main(['compare', str(bag), '--truth', str(truth), '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['reference'] == 'truth'
    worst = data['largest_deviation']
    assert max(v for n, v in worst['enhanced_dahlem'].items() if n[0] == 'E') < 5e-6
    assert worst['step_diagonal']['EXX'] > 3 * worst['enhanced_dahlem']['EXX']
    assert 'multilateration' in data['not_run']


@pytest.mark.long
def test_without_truth_the_enhanced_method_is_the_reference(simulated, capsys):
    assert main(['compare', str(simulated[0])]) == 0
    assert 'Largest deviation from enhanced' in capsys.readouterr().out


def test_bad_input_is_one_line(simulated, tmp_path, capsys):
    bag, _ = simulated
    assert main(['compare', str(bag), '--truth', str(tmp_path / 'none.json')]) == 2
    assert 'none.json: cannot be read' in capsys.readouterr().err
    assert main(['compare', str(bag), '--out', str(tmp_path / 'no' / 'where.png')]) == 2
    assert 'cannot be written' in capsys.readouterr().err
