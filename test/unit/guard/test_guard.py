"""Limits, files, YAML, JSON and text: what stands between the program and the outside."""

import io
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import open_regular, read_text
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.guard.show import SafeStream

SOURCES = Path(__file__).resolve().parents[3] / 'stepdiag_ros'


def test_what_is_no_number_is_null():
    text = to_json({'a': math.nan, 'b': [math.inf, -math.inf, 1.5], 'c': np.float32(0.5),
                    'd': np.array([np.nan, 2.0]), 'e': np.int64(3), 'f': Path('x'), 'g': (True, np.bool_(False), None)})
    assert json.loads(text) == {'a': None, 'b': [None, None, 1.5], 'c': 0.5, 'd': [None, 2.0], 'e': 3, 'f': 'x',
                                'g': [True, False, None]}


def test_every_command_writes_json_in_the_one_way():
    """Python's own writer puts NaN and Infinity into documents, which no other language reads."""
    own = {'guard/jsontext.py', 'bag/typehash.py', 'virtual/interferometer_server.py'}
    found = {str(file.relative_to(SOURCES)) for file in SOURCES.rglob('*.py')
             if re.search(r'json\.dumps?\(', file.read_text(encoding='utf-8'))}
    assert found == own


def test_yaml_of_strangers_is_read_in_the_one_way():
    """Of files that the program writes for itself alone it may read more."""
    own = {'guard/strict_yaml.py', 'twin/adopt.py', 'virtual/faults.py', 'virtual/cell_process.py', 'nodes/bringup.py'}
    found = {str(file.relative_to(SOURCES)) for file in SOURCES.rglob('*.py')
             if re.search(r'(?<!strict_)yaml\.(safe_load|load|compose)\(', file.read_text(encoding='utf-8'))}
    assert found == own


@pytest.mark.parametrize(('text', 'said'), [
    ('a: &x 1\nb: *x', 'here:1: has an anchor'), ('- ' * 100, 'nested more than'),
    ('a: !!python/name:os.system', 'tag'),
    ('a: "\\e[31m"', 'control character'), ('a: ' + '9' * 50, 'has 50 digits'), ('? {a: 1}\n: 2', 'unhashable'),
    ('a: !!bool maybe', 'not valid YAML')])
def test_yaml_that_is_refused(text, said):
    with pytest.raises(StepdiagError) as caught:
        strict_yaml.load(text, 'here')
    assert said in str(caught.value) and str(caught.value).startswith('here')


def test_yaml_that_is_read():
    assert strict_yaml.load('{a: 2020-01-01, b: [1, 0.5, true, null, "x"], <<: 1}', 'here') == {
        'a': '2020-01-01', 'b': [1, 0.5, True, None, 'x'], '<<': 1}


def test_pipes_devices_and_great_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    for path in (tmp_path / 'pipe', '/dev/zero', tmp_path):
        with pytest.raises(StepdiagError, match='no regular file'):
            open_regular(path)
    (tmp_path / 'great').write_bytes(b'x' * 11)
    with pytest.raises(StepdiagError, match='has 11 bytes, a table has at most 10'):
        read_text(tmp_path / 'great', 10, 'table')


def test_names_from_outside_move_no_cursor(tmp_path, capsys):
    assert main(['info', str(tmp_path / 'a\x1b[2J\x1b]0;owned\x07')]) == 2
    error = capsys.readouterr().err
    assert '\x1b' not in error and '\x07' not in error and '\\x1b[2J' in error


def test_the_bar_s_own_control_sequences_pass():
    stream = io.StringIO()
    safe = SafeStream(stream)
    safe.control('\r\x1b[K')
    safe.write('\x1b[31mred\n')
    assert stream.getvalue() == '\r\x1b[K\\x1b[31mred\n'


def test_a_bag_may_unpack_to_many_times_its_size_and_a_small_one_to_more():
    assert limits.unpacked_most(0) == limits.UNPACKED_LEAST
    assert limits.unpacked_most(1 << 30) == limits.UNPACKED_TIMES << 30
