"""stepdiag info, recover and import, as a person calls them."""

import json
import shutil
from pathlib import Path

import pytest

from stepdiag_ros.bag.codec import encode_string
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.cli.main import main

CSV = 'cycle,direction,target_mm,measured_mm\n1,1,0,0.001\n1,1,10,10.002\n1,-1,10,10.004\n1,-1,0,0.003\n'


@pytest.fixture
def imported(tmp_path, capsys) -> Path:
    """A bag made by `stepdiag import`."""
    (tmp_path / 'axis_y.csv').write_text(CSV)
    assert main(['import', str(tmp_path / 'axis_y.csv'), '--to', str(tmp_path / 'bag')]) == 0
    said = capsys.readouterr().out
    assert 'guessed from the file name' in said and 'times are made up' in said
    return tmp_path / 'bag'


def test_import_json(tmp_path, capsys):
    (tmp_path / 'axis_y.csv').write_text(CSV)
    assert main(['import', str(tmp_path / 'axis_y.csv'), '--to', str(tmp_path / 'bag'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['readings'] == 4 and any('axis Y' in note for note in found['notes'])


def test_import_keeps_its_choices_in_the_bag(imported):
    text = (imported / 'metadata.yaml').read_text()
    assert 'imported_from: axis_y.csv' in text and 'times are made up' in text


def test_info(imported, capsys):
    assert main(['info', str(imported)]) == 0
    said = capsys.readouterr().out
    for part in ('/import/sequencer/step', 'lin_y', '2 of 2', 'not there: psd/spot', 'CRCs checked'):
        assert part in said


def test_info_json(imported, capsys):
    assert main(['info', str(imported), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    machine, = found['machines']
    assert machine['namespace'] == '/import' and machine['dwells']['count'] == 4
    assert {t['name']: t['messages'] for t in found['topics']}['/import/sequencer/step'] == 12
    assert [r['stops_seen'] for r in machine['runs']] == [2, 2] and found['damage'] == []


def test_info_of_a_field_log(shared, capsys):
    assert main(['info', str(shared / 'field_logs' / 'open' / 'log_05'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    machine, = found['machines']
    assert machine['samples']['displacement'] == {'samples': 26580, 'blocks': 1072, 'sample_rate_hz': 50.0}
    assert len(machine['runs']) == 28 and all(r['missing'] == [] for r in machine['runs'])
    assert all(t['lost'] is None for t in found['topics'])    # this maker numbers nothing


def test_torn_bag_is_told_and_mended(imported, capsys):
    file, = imported.glob('*.mcap')
    data = file.read_bytes()
    file.write_bytes(data[:-200])
    assert main(['info', str(imported)]) == 0
    said = capsys.readouterr().out
    assert 'damaged:' in said and f'stepdiag recover {imported}' in said and '2 of 2' in said
    assert main(['recover', str(imported)]) == 0
    said = capsys.readouterr().out
    assert '17 messages recovered into' in said    # 1 description, 12 steps, 4 readings
    assert main(['info', f'{imported}_recovered', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['damage'] == []
    assert main(['recover', str(imported)]) == 2
    assert 'exists already' in capsys.readouterr().err


def test_recover_json(imported, tmp_path, capsys):
    assert main(['recover', str(imported), '--to', str(tmp_path / 'new'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['target'] == str(tmp_path / 'new')
    assert {t['topic']: (t['recovered'], t['lost']) for t in found['topics']}['/import/sequencer/step'] == (12, 0)


def test_info_without_description_says_what_is_there(imported, tmp_path, capsys):
    """A bag that cannot be evaluated still shows what it holds."""
    with BagWriter(tmp_path / 'odd', live=False) as bag:
        bag.add_topic('/m/cell_description', 'std_msgs/msg/String')
        bag.write('/m/cell_description', encode_string('schema: 7'), 1, 1, 1)
    assert main(['info', str(tmp_path / 'odd')]) == 0
    said = capsys.readouterr().out
    assert 'cannot be evaluated' in said and 'schema is 7' in said
    with BagWriter(tmp_path / 'else', live=False) as bag:
        bag.add_topic('/chatter', 'std_msgs/msg/String')
    assert main(['info', str(tmp_path / 'else')]) == 0
    assert 'No machine' in capsys.readouterr().out


@pytest.mark.parametrize('arguments', [
    ['info', 'nowhere'], ['recover', 'nowhere'], ['import', 'nowhere.csv', '--to', 'x', '--axis', 'x'],
    ['info', '{bag}', '--namespace', 'other'], ['import', '{bag}/../axis_y.csv', '--to', '{bag}'],
    ['import', '{bag}/../axis_y.csv', '--to', '{bag}2', '--namespace', '/']])
def test_bad_input_is_one_line_and_status_2(imported, capsys, arguments):
    assert main([a.format(bag=imported) for a in arguments]) == 2
    outcome = capsys.readouterr()
    assert outcome.err.startswith('stepdiag: ') and outcome.err.count('\n') == 1 and outcome.out == ''


def test_several_machines(imported, tmp_path, capsys):
    both = tmp_path / 'both'
    both.mkdir()
    for name in ('left', 'right'):
        main(['import', str(tmp_path / 'axis_y.csv'), '--to', str(tmp_path / name), '--namespace', name])
        file, = (tmp_path / name).glob('*.mcap')
        shutil.move(file, both / f'{name}.mcap')
    capsys.readouterr()
    assert main(['info', str(both), '--json']) == 0
    assert [m['namespace'] for m in json.loads(capsys.readouterr().out)['machines']] == ['/left', '/right']
    assert main(['info', str(both), '--json', '--namespace', 'right']) == 0
    assert [m['namespace'] for m in json.loads(capsys.readouterr().out)['machines']] == ['/right']
