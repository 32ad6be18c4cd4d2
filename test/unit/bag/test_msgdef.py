"""Schemas: one source of truth, parsing, hashes."""

import json
import sys
from pathlib import Path

import pytest
import yaml

from stepdiag_ros.bag.msgdef import SEQUENCE, Field, contract_fields, parse, schema_text
from stepdiag_ros.bag.schemas import DEFINITIONS, TOPICS, split_topic
from stepdiag_ros.bag.typehash import rihs01
from stepdiag_ros.errors import StepdiagError

ROOT = Path(__file__).resolve().parents[3]


def without_comments(text: str) -> list[str]:
    lines = (' '.join(line.split('#', 1)[0].split()) for line in text.splitlines())
    return [line.replace(' = ', '=') for line in lines if line]


@pytest.mark.parametrize('name', ['ClockOffset', 'ClockStep', 'Displacement', 'SampleTiming', 'SpotPosition', 'Step'])
def test_built_in_definitions_are_those_of_msg_defs(name):
    text = (ROOT / 'msg_defs' / 'msg' / f'{name}.msg').read_text()
    assert without_comments(DEFINITIONS[f'stepdiag_msgs/msg/{name}']) == without_comments(text)


@pytest.mark.parametrize('name', sorted(n for n in DEFINITIONS if not n.startswith('stepdiag_msgs')))
def test_standard_definitions_are_those_of_jazzy(name):
    stores = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    store = stores.get_typestore(stores.Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(name, ros_version=2)
    assert parse(name, text) == parse(name, schema_text(name))


@pytest.mark.parametrize('name', sorted(set(TOPICS.values())))
def test_hashes_are_those_of_rosbags(name):
    stores = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    store = stores.get_typestore(stores.Stores.ROS2_JAZZY)
    for mine, text in DEFINITIONS.items():
        if mine.startswith('stepdiag_msgs'):
            store.register(stores.get_types_from_msg(text, mine))
    assert rihs01(name) == store.hash_rihs01(name)


def test_hashes_are_those_of_the_field_logs(shared):
    file = shared / 'field_logs' / 'open' / 'log_05' / 'metadata.yaml'
    for entry in yaml.safe_load(file.read_text())['rosbag2_bagfile_information']['topics_with_message_count']:
        about = entry['topic_metadata']
        assert rihs01(about['type']) == about['type_description_hash'], about['name']


def test_hash_knows_arrays_bounds_and_empty_messages():
    stores = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    text = ('uint8 LIMIT=3\nstring<=7 name\nfloat32[3] fixed\nint16[<=9] bounded\nbool[] flags "x"\n'
            'string[] names\nInner[] more\nbyte b\n')
    mine = {'pkg/msg/Outer': text, 'pkg/msg/Inner': ''}
    store = stores.get_typestore(stores.Stores.EMPTY)
    for name, definition in (('pkg/msg/Inner', ''), ('pkg/msg/Outer', text.replace(' "x"', ''))):
        store.register(stores.get_types_from_msg(definition, name))
    assert rihs01('pkg/msg/Outer', mine) == store.hash_rihs01('pkg/msg/Outer')


def test_hashes_are_those_that_ros_ships():
    """Every message of the installed ROS 2 distribution, which brings its hashes along."""
    share = Path(sys.prefix) / 'share'
    definitions = {f'{f.parts[-3]}/msg/{f.stem}': f.read_text() for f in share.glob('*/msg/*.msg')}
    hashes = {h['type_name']: h['hash_string'] for f in share.glob('*/msg/*.json')
              for h in json.loads(f.read_text())['type_hashes']}
    known = definitions.keys() & hashes.keys()
    if 'std_msgs/msg/Header' not in known:
        pytest.skip(f'the ROS 2 message packages are not installed in {share}')
    assert [name for name in sorted(known) if rihs01(name, definitions) != hashes[name]] == []


def test_unknown_types_are_named():
    with pytest.raises(StepdiagError, match='pkg/msg/Nothing'):
        rihs01('pkg/msg/Nothing')
    with pytest.raises(StepdiagError, match='pkg/msg/Nothing'):
        schema_text('pkg/msg/Nothing')


def test_parse_flattens_and_passes_over_comments_constants_and_defaults():
    text = ('# a comment\nuint8 A=1 # constant\nint32 count 5   # default\nfloat64[] values\n'
            'float64[<=4] few\nint8[3] fixed\nHeader header\nPart part\nstring<=8 short "x"\n'
            + '=' * 80 + '\nMSG: std_msgs/Header\nuint32 seq\n' + '=' * 80 + '\nMSG: pkg/Part\nbool flag\n')
    assert parse('pkg/msg/Whole', text) == (
        Field('count', 'int32'), Field('values', 'float64', SEQUENCE), Field('few', 'float64', SEQUENCE),
        Field('fixed', 'int8', 3), Field('header.seq', 'uint32'), Field('part.flag', 'bool'),
        Field('short', 'string'))


def test_definitions_that_contain_each_other_end():
    text = 'pkg/A a\n' + '=' * 80 + '\nMSG: pkg/A\npkg/A a\n'
    with pytest.raises(ValueError, match='contain each other'):
        parse('pkg/msg/Whole', text)


def test_contract_layout():
    assert [str(f) for f in contract_fields('stepdiag_msgs/msg/Displacement')] == [
        'int32', 'uint32', 'string', 'float64', 'uint8', 'float64[]', 'float64', 'uint8[]']


def test_topics_are_found_below_any_namespace():
    assert split_topic('/hall/cell1/psd/spot') == ('/hall/cell1', 'psd/spot')
    assert split_topic('/psd/spot') == ('', 'psd/spot')
    assert split_topic('psd/spot') == ('', 'psd/spot')
    assert split_topic('/cell1/mypsd/spot') is None
    assert split_topic('/cell1/diagnostics') is None
