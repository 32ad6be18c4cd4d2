"""`stepdiag improve` and `stepdiag linuxcnc` refuse in one line what they cannot do, and write nothing then."""

import argparse
import os
from pathlib import Path

import pytest

from stepdiag_ros.cli.improve import _agreed
from stepdiag_ros.cli.main import main
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import configuration, install

CELL = Path(__file__).resolve().parents[3] / 'cells' / 'linuxcnc.yaml'


def refused(capsys, *words) -> str:
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert said.startswith('stepdiag: ') and said.count('\n') == 1
    return said


@pytest.mark.parametrize('old, new, complaint', [
    (', config: control}', '}', 'instruments.cnc.config is missing'),
    ('control: linuxcnc, ', '', "instruments.cnc.control is 'virtual'"),
    ('  origin: [0.05, -0.03, -0.15] # machine', '  # machine', 'machine.origin is missing')])
def test_what_the_cell_does_not_say_is_asked_for(tmp_path, capsys, old, new, complaint):
    cell = tmp_path / 'cell.yaml'
    text = CELL.read_text()
    assert old in text
    cell.write_text(text.replace(old, new))
    assert complaint in refused(capsys, 'improve', cell, '--out', tmp_path / 'out')
    assert [path.name for path in tmp_path.iterdir()] == ['cell.yaml']


def test_nothing_to_undo(tmp_path, capsys):
    (tmp_path / 'cell.yaml').write_text(CELL.read_text())
    assert 'nothing to undo' in refused(capsys, 'improve', tmp_path / 'cell.yaml', '--undo')


def test_a_folder_with_something_in_it_is_left_alone(tmp_path, capsys):
    (tmp_path / 'cell.yaml').write_text(CELL.read_text())
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'thesis.txt').write_text('mine')
    assert 'is not empty' in refused(capsys, 'improve', tmp_path / 'cell.yaml', '--out', tmp_path / 'out')


def test_the_watchdog_goes_in_and_comes_out(tmp_path, capsys, monkeypatch):
    configuration.write(tmp_path, configuration.simulated('mill', (0.2, 0.1, 0.1), (0.0, 0.0, 0.0), 0.1, 1.0))
    ini = tmp_path / 'machine.ini'
    before = ini.read_text()
    monkeypatch.setattr(install, 'installed', lambda component: False)
    assert 'sudo stepdiag linuxcnc install' in refused(capsys, 'linuxcnc', 'watch', tmp_path)
    assert ini.read_text() == before
    monkeypatch.setattr(install, 'installed', lambda component: True)
    assert main(['linuxcnc', 'watch', str(tmp_path), '--port', '5123']) == 0
    assert 'HEART_PORT = 5123' in ini.read_text() and (tmp_path / 'stepdiag' / 'heart.py').is_file()
    assert main(['linuxcnc', 'unwatch', str(tmp_path)]) == 0
    assert 'HEART_PORT' not in ini.read_text() and not (tmp_path / 'stepdiag' / 'heart.py').exists()


def test_a_folder_without_an_ini_file_is_no_configuration(tmp_path, capsys):
    assert '0 INI files' in refused(capsys, 'linuxcnc', 'watch', tmp_path)


@pytest.mark.parametrize(('answer', 'agreed'), [('y', True), ('yes', True), ('', False), ('n', False), ('sure', False)])
def test_nothing_is_written_unless_somebody_agrees(tmp_path, monkeypatch, capsys, answer, agreed):
    """At a terminal of its own; what is not yes is no."""
    asks, answers = os.openpty()
    os.write(asks, f'{answer}\n'.encode())
    with os.fdopen(answers) as terminal:
        monkeypatch.setattr('sys.stdin', terminal)
        assert _agreed(argparse.Namespace(yes=False, json=False), tmp_path) is agreed
    os.close(asks)
    assert 'Write these files?' in capsys.readouterr().out


def test_where_nobody_can_be_asked_nothing_is_written(tmp_path, monkeypatch):
    with open(os.devnull) as nobody:
        monkeypatch.setattr('sys.stdin', nobody)
        with pytest.raises(StepdiagError, match='nobody can be asked'):
            _agreed(argparse.Namespace(yes=False, json=False), tmp_path)
        assert _agreed(argparse.Namespace(yes=True, json=True), tmp_path)
