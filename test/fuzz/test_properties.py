"""What every reader of foreign text promises: a value, or the one error that its callers know."""

import json
import random
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.bag.msgdef import parse
from stepdiag_ros.devices.jsonstream import JsonStream
from stepdiag_ros.devices.t7 import PacketStream
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import strict_yaml
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.guard.show import UNFIT, escaped
from stepdiag_ros.model.description import Description
from stepdiag_ros.virtual.cell import parse_cell

sys.path.insert(0, str(Path(__file__).parent))
import inputs

import bags

quickly = settings(max_examples=150, deadline=None, derandomize=True, database=None,
                   suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(
    [10 ** 400, -1, 1e300, float('nan'), float('inf'), '2020-01-01', '1e300'])
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
                      max_leaves=12)


def refuse(word: str):
    raise AssertionError(f'{word} is not JSON')


@quickly
@given(values | st.builds(np.float64, st.floats()) | st.builds(np.array, st.lists(st.floats())))
def test_json_is_always_json(value):
    json.loads(to_json({'value': value}), parse_constant=refuse)


@quickly
@given(st.text())
def test_nothing_that_moves_a_cursor_is_shown(text):
    assert not UNFIT.search(escaped(text)) and escaped('a µ\tχ²\n') == 'a µ\tχ²\n'


@quickly
@given(st.text() | values.map(str) | values.map(lambda v: to_json(v)))
def test_yaml_of_strangers(text):
    try:
        strict_yaml.load(text, 'here')
    except StepdiagError as error:
        assert str(error).startswith('here') and '\n' not in str(error)


@quickly
@given(st.sampled_from(['machine', 'plan', 'setups', 'noise', 'schema']), st.sampled_from(
    ['', 'volume', 'tool', 'name', 'chain', 'steps', 'order', 'repeats', 'ppp', 'lin_x', 'spot']), values)
def test_descriptions_with_a_value_exchanged(key, inner, value):
    document = strict_yaml.load(bags.PLAIN, 'plain')
    if inner and isinstance(document.get(key), dict):
        document[key][inner] = value
    else:
        document[key] = value
    try:
        Description.from_dict(document, 'here')
    except StepdiagError as error:
        assert str(error).startswith('here') and '\n' not in str(error)


@pytest.mark.parametrize('seed', range(150))
def test_cell_files_with_values_exchanged(seed):
    try:
        parse_cell(inputs.odd_yaml(random.Random(seed), bags.CELL), 'here')
    except StepdiagError as error:
        assert '\n' not in str(error)


@pytest.mark.parametrize('seed', range(150))
def test_tables_with_something_odd(tmp_path, seed):
    file = tmp_path / 'stage_x.csv'
    file.write_bytes(inputs.odd_table(random.Random(seed)).encode('utf-8', 'surrogatepass'))
    try:
        import_csv(file)
    except StepdiagError as error:
        assert '\n' not in str(error)


@quickly
@given(st.text() | st.lists(st.sampled_from(['uint8 x', 'a/B c', 'string[] d', 'float64[3] e', '=' * 80, 'MSG: a/B', '# f',
                                             'uint8 G=1', 'Header h', 'uint8[<=9] i', 'wstring j'])).map('\n'.join))
def test_message_definitions(text):
    try:
        assert len(parse('a/msg/A', text)) <= 1001
    except ValueError:
        pass


@quickly
@given(st.lists(st.binary() | values.map(lambda v: to_json(v).encode()) | st.sampled_from([b'{', b'[', b'}', b'"', b'\\'])))
def test_json_streams(pieces):
    stream = JsonStream()
    try:
        for piece in pieces:
            stream.feed(piece)
    except ValueError:
        pass


@quickly
@given(st.lists(st.binary(max_size=64)))
def test_packet_streams(pieces):
    stream = PacketStream()
    try:
        for piece in pieces:
            stream.feed(piece)
    except ValueError:
        pass
