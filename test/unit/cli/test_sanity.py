"""A log with a mistake of commissioning, through the commands: text, JSON and exit status agree, nothing is
diagnosed."""

import dataclasses
import json
from pathlib import Path

import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """``(sane, flipped)``: the log of the demo's cell, and the same with the displacement's sign turned."""
    folder = tmp_path_factory.mktemp('bags')
    log = simulate_log(load_cell(DEMO), rate=200.0, in_motion=False)
    write_log(log, folder / 'sane')
    turned = dataclasses.replace(log.displacement, values=-log.displacement.values)
    write_log(dataclasses.replace(log, displacement=turned), folder / 'flipped')
    return folder / 'sane', folder / 'flipped'


def test_a_sane_log_is_ok(bags, capsys):
    assert main(['evaluate', str(bags[0]), '--json']) == 0
    document = json.loads(capsys.readouterr().out)
    assert document['status'] == 'ok' and document['sanity'] == []


def test_evaluate_says_on_which_methods_the_log_is_hard(bags, capsys):
    """The angles of the demo's machine mislead the vector method and the lengths of the diagonals."""
    assert main(['evaluate', str(bags[0]), '--json']) == 0
    cautions = json.loads(capsys.readouterr().out)['cautions']
    assert [('vector method' in c, 'squareness_diagonals' in c) for c in cautions] == [(True, False), (False, True)]
    assert main(['evaluate', str(bags[0])]) == 0
    text = capsys.readouterr().out
    assert all(f'caution, for other methods than this one: {c}' in text for c in cautions)


def test_a_mistake_is_not_ok_in_text_json_and_exit_status(bags, capsys):
    assert main(['evaluate', str(bags[1]), '--json']) == 1
    document = json.loads(capsys.readouterr().out)
    assert document['status'].startswith('not ok') and [f['name'] for f in document['sanity']] == ['sign']
    assert main(['evaluate', str(bags[1])]) == 1
    text = capsys.readouterr().out
    assert document['status'] in text and 'Not sane: ' in text and 'turn the sign of the displacement' in text


def test_nothing_is_diagnosed_before_a_mistake_is_put_right(bags, tmp_path, capsys):
    assert main(['gap', str(bags[1]), '--out', str(tmp_path)]) == 0
    text = capsys.readouterr().out
    document = json.loads((tmp_path / 'flipped' / 'gap.json').read_text())
    assert 'the log is not sane' in text and 'turn the sign of the displacement' in text
    assert document['verdict'] == 'unexplained' and document['effects'] == []
    assert [f['name'] for f in document['sanity']] == ['sign']
    assert 'turn the sign of the displacement' in (tmp_path / 'flipped' / 'index.html').read_text()
