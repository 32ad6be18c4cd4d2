"""The array decoder against an encoder that is not ours, and its own splits."""

import numpy as np
import pytest

from stepdiag_ros.bag import codec
from stepdiag_ros.bag.cdr import decode
from stepdiag_ros.bag.msgdef import Field, contract_fields, parse
from stepdiag_ros.bag.schemas import DEFINITIONS

STEP = 'stepdiag_msgs/msg/Step'


@pytest.fixture(scope='module')
def store():
    """rosbags' serialiser with our messages."""
    stores = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    store = stores.get_typestore(stores.Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        if name.startswith('stepdiag_msgs'):
            store.register(stores.get_types_from_msg(text, name))
    return store


def matrix(*messages: bytes) -> np.ndarray:
    return np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), -1)


@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize('setup', ['ppp', 'lin_x', '', 'a'])
def test_encoders_write_what_rosbags_writes(store, setup, order):
    """Every encoder, both byte orders, names of several lengths (which shift the alignment)."""
    types = store.types
    stamp = 1_790_000_000_123_456_789
    header = types['std_msgs/msg/Header'](
        types['builtin_interfaces/msg/Time'](stamp // 10**9, stamp % 10**9), setup)
    values, quality = np.arange(6.0), np.array([1, 2, 3], np.uint8)
    little = order == '<'

    def theirs(name, *fields):
        return bytes(store.serialize_cdr(types[name](*fields), name, little_endian=little))

    assert codec.encode_displacement(stamp, setup, 0.02, values.reshape(3, 2), 1.5, quality, order) == \
        theirs('stepdiag_msgs/msg/Displacement', header, 0.02, 2, values, 1.5, quality)
    assert codec.encode_spot(stamp, setup, 0.02, values, -values, 2 * values, order) == \
        theirs('stepdiag_msgs/msg/SpotPosition', header, 0.02, values, -values, 2 * values)
    point = types['geometry_msgs/msg/Point'](0.1, 0.2, 0.3)
    assert codec.encode_step(stamp, 'ppp/0/+', setup, 3, -1, 7, 255, (0.1, 0.2, 0.3), 2, setup, order) == \
        theirs(STEP, header, 'ppp/0/+', setup, 3, -1, 7, 255, point, 2)
    assert codec.encode_temperature(stamp, setup, 20.5, 1e-4, order) == \
        theirs('sensor_msgs/msg/Temperature', header, 20.5, 1e-4)
    assert codec.encode_string('Grüße', order) == theirs('std_msgs/msg/String', 'Grüße')


@pytest.mark.parametrize('setup', ['ppp', 'lin_x', '', 'abcdefg'])
def test_empty_sequences_take_no_padding(store, setup):
    """Behind the length of an empty sequence the next field follows at once."""
    types = store.types
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](1, 2), setup)
    none = np.zeros(0)
    name = 'stepdiag_msgs/msg/SpotPosition'
    theirs = bytes(store.serialize_cdr(types[name](header, 0.5, none, none, np.arange(2.0)), name))
    mine = codec.encode_spot(1_000_000_002, setup, 0.5, none, none, np.arange(2.0))
    assert mine == theirs
    found, bad = decode(matrix(mine), contract_fields(name), frozenset({'x', 'intensity', 'sample_period'}))
    assert len(bad) == 0 and found[0].values['intensity'].tolist() == [[0.0, 1.0]]
    assert found[0].values['x'].shape == (1, 0)


def test_rows_of_one_length_and_several_layouts():
    """Names of 3 and 5 letters with 9 and 7 bytes after them: alike long, laid out apart."""
    fields = (Field('name', 'string'), Field('tail', 'uint8', -1))
    first = b'\x00\x01\x00\x00\x04\x00\x00\x00abc\x00\x04\x00\x00\x00\x01\x02\x03\x04'
    second = b'\x00\x01\x00\x00\x08\x00\x00\x00abcdefg\x00\x00\x00\x00\x00'
    assert len(first) == len(second)
    found, bad = decode(matrix(first, second, first), fields, frozenset({'name', 'tail'}))
    assert len(bad) == 0
    got = {tuple(d.rows): (d.values['name'].tolist(), d.values['tail'].tolist()) for d in found}
    assert got == {(0, 2): ([b'abc', b'abc'], [[1, 2, 3, 4]] * 2), (1,): ([b'abcdefg'], [[]])}


def test_byte_orders_may_mix():
    fields = (Field('value', 'uint16'),)
    found, _ = decode(matrix(b'\x00\x01\x00\x00\x34\x12', b'\x00\x00\x00\x00\x12\x34'), fields,
                      frozenset({'value'}))
    assert sorted(int(v) for d in found for v in d.values['value']) == [0x1234, 0x1234]


def test_xcdr2_aligns_to_four():
    """Plain CDR 2 puts a float64 behind an uint32 at 4 and not at 8."""
    fields = (Field('a', 'uint32'), Field('b', 'float64'))
    body = np.float64(2.5).tobytes()
    one, _ = decode(matrix(b'\x00\x01\x00\x00' + b'\x07\0\0\0' + bytes(4) + body), fields, frozenset({'b'}))
    two, _ = decode(matrix(b'\x00\x07\x00\x00' + b'\x07\0\0\0' + body), fields, frozenset({'b'}))
    assert one[0].values['b'][0] == two[0].values['b'][0] == 2.5


def test_fixed_arrays_and_what_is_not_wanted():
    fields = parse('pkg/msg/M', 'uint8 a\nint16[3] b\nstring skipped\nfloat32 c\nwstring never_reached\n')
    data = b'\x00\x01\x00\x00' + b'\x01\x00' + np.array([1, -2, 3], '<i2').tobytes() \
        + b'\x02\0\0\0z\0' + bytes(2) + np.float32(0.5).tobytes()
    found, bad = decode(matrix(data), fields, frozenset({'b', 'c'}))
    assert len(bad) == 0 and found[0].values.keys() == {'b', 'c'}
    assert found[0].values['b'].tolist() == [[1, -2, 3]] and found[0].values['c'].tolist() == [0.5]


@pytest.mark.parametrize('data', [
    b'\x00', b'\x00\x01\x00\x00', b'\x00\x09\x00\x00' + bytes(40),
    b'\x00\x01\x00\x00' + b'\xff\xff\xff\x7f' + bytes(40)])
def test_what_is_no_message_is_set_apart(data):
    found, bad = decode(matrix(data, data), (Field('s', 'string'),), frozenset({'s'}))
    assert found == [] and bad.tolist() == [0, 1]


def test_every_cut_of_a_message_is_set_apart():
    fields = contract_fields(STEP)
    whole = codec.encode_step(1, 'ppp/0/+', 'ppp', 0, 1, 2, 0, (0, 0, 0), 1)
    wanted = frozenset(f.path for f in fields)
    for length in range(len(whole)):
        found, bad = decode(matrix(whole[:length]) if length else np.zeros((1, 0), np.uint8), fields, wanted)
        assert (found, bad.tolist()) == ([], [0]), length
    found, bad = decode(matrix(whole), fields, wanted)
    assert len(found) == 1 and found[0].values['phase'].tolist() == [1]
