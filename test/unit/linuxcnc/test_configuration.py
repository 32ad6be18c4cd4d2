"""INI files are edited in their own lines; a compensation goes in and comes out without a trace."""

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import configuration as c
from stepdiag_ros.linuxcnc.ini import get, put

INI = '''# a mill
[KINS]
KINEMATICS = trivkins coordinates=XYZ
JOINTS = 3
[HAL]
HALFILE = mill.hal
HALFILE = panel.hal
[JOINT_0]
HOME = 0
[JOINT_1]
HOME = 0
COMP_FILE = old_y.comp
[JOINT_2]
HOME = 0
'''


def test_a_key_is_put_replaced_and_taken_out():
    text = put(INI, 'JOINT_0', 'COMP_FILE', ['x.comp'])
    assert get(text, 'JOINT_0', 'COMP_FILE') == ['x.comp']
    text = put(text, 'JOINT_0', 'COMP_FILE', ['other.comp'])
    assert get(text, 'JOINT_0', 'COMP_FILE') == ['other.comp'] and 'x.comp' not in text
    assert put(text, 'JOINT_0', 'COMP_FILE', []) == INI
    assert get(put(INI, 'NEW', 'A', ['1']), 'NEW', 'A') == ['1']


def test_lists_keep_their_order():
    assert get(c.with_halfile(INI, 'more.hal'), 'HAL', 'HALFILE') == ['mill.hal', 'panel.hal', 'more.hal']
    assert get(c.with_halfile(INI, 'panel.hal', False), 'HAL', 'HALFILE') == ['mill.hal']


def test_the_volumetric_component_replaces_kinematics_and_is_taken_back():
    files = c.compensated(INI, volume='volume')
    ini = files['machine.ini']
    assert get(ini, 'KINS', 'KINEMATICS') == ['stepdiagkins file=stepdiag/volume.txt']
    assert get(ini, 'HAL', 'HALFILE')[-1] == 'stepdiag/volume.hal'
    assert get(ini, 'JOINT_1', 'COMP_FILE') == []
    assert 'stepdiagkins.enable' in files['stepdiag/volume.hal']
    back = c.compensated(ini, tables={'X': '0 0 0\n'})
    assert get(back['machine.ini'], 'KINS', 'KINEMATICS') == ['trivkins coordinates=XYZ']
    assert get(back['machine.ini'], 'HAL', 'HALFILE') == ['mill.hal', 'panel.hal']
    assert get(back['machine.ini'], 'JOINT_0', 'COMP_FILE') == ['stepdiag/x.comp']
    assert back['stepdiag/volume.txt'] is None


def test_no_move_begins_while_the_compensation_ramps_where_there_is_a_watchdog():
    watched = c.watched(INI, 5008)['machine.ini']
    assert 'stepdiagwatch.hold' in c.compensated(watched, volume='volume')['stepdiag/volume.hal']
    assert 'stepdiagwatch' not in c.compensated(INI, volume='volume')['stepdiag/volume.hal']
    assert 'stepdiag/watch.hal' not in c.unwatched(watched)['machine.ini']


def test_kinematics_of_its_own_are_not_replaced():
    with pytest.raises(StepdiagError, match='xyzac-trt-kins'):
        c.compensated(INI.replace('trivkins', 'xyzac-trt-kins'), volume='volume')


def test_files_are_written_whole_and_taken_away(tmp_path):
    c.write(tmp_path, {'a/b': 'text\n', 'run': '#!/bin/sh\n'})
    assert (tmp_path / 'a' / 'b').read_text() == 'text\n' and (tmp_path / 'run').stat().st_mode & 0o111
    c.write(tmp_path, {'a/b': None})
    assert not (tmp_path / 'a' / 'b').exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ['a', 'run']


def test_one_ini_file_alone(tmp_path):
    with pytest.raises(StepdiagError, match='0 INI files'):
        c.ini_file(tmp_path)
    (tmp_path / 'mill.ini').write_text(INI)
    assert c.ini_file(tmp_path).name == 'mill.ini'
