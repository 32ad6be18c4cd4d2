"""read_log: what it reads, what it refuses, what it leaves out and says."""

import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from stepdiag_ros.bag.codec import (
    encode_displacement,
    encode_scalar,
    encode_spot,
    encode_step,
    encode_string,
)
from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.msgdef import schema_text
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.recover import recover
from stepdiag_ros.bag.schemas import DESCRIPTION, DISPLACEMENT, SPOT, STEP, TOPICS
from stepdiag_ros.bag.summary import summarise
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import DWELL, CalibrationLog
from stepdiag_ros.model.path import stops

SECOND = 1_000_000_000


def one_line(error: pytest.ExceptionInfo) -> str:
    text = str(error.value)
    assert '\n' not in text
    return text


def only_file(bag: Path) -> Path:
    file, = bag.glob('*.mcap')
    return file


def warned(log: CalibrationLog, *parts: str) -> bool:
    return any(all(part in warning for part in parts) for warning in log.warnings)


# What it reads

def test_field_logs_are_whole(shared: Path):
    for place in sorted((shared / 'field_logs').glob('*/log_*')):
        log = read_log(place)
        assert (len(log.steps), len(log.displacement), len(log.spot)) == (1272, 26580, 26580), place
        assert [w for w in log.warnings if 'CRC' not in w] == [], place


def test_field_log_has_the_numbers_of_a_general_reader(shared: Path):
    rosbags = pytest.importorskip('rosbags.highlevel', reason='rosbags is not installed')
    place = shared / 'field_logs' / 'open' / 'log_05'
    log = read_log(place)
    displacement, times, spots, steps = [], [], [], []
    with rosbags.AnyReader([place]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic.endswith(DISPLACEMENT):
                displacement.append(message.displacement)
                stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
                times.append(stamp + np.rint(np.arange(len(message.displacement))
                                             * message.sample_period * 1e9).astype(np.int64))
            elif connection.topic.endswith(SPOT):
                spots.append(np.stack([message.x, message.y], axis=1))
            elif connection.topic.endswith(STEP):
                steps.append((message.run_id, message.index, message.axis, message.phase,
                              message.commanded.z))
    assert np.array_equal(log.displacement.values[:, 0], np.concatenate(displacement))
    assert np.array_equal(log.displacement.time_ns, np.concatenate(times))
    assert np.array_equal(log.spot.values, np.concatenate(spots))
    s = log.steps
    assert steps == [(s.run_ids[s.run[k]], s.index[k], s.axis[k], s.phase[k], s.commanded[k, 2])
                     for k in range(len(s))]


def test_bare_file_and_metadata_path_are_read_like_the_directory(tmp_path, small_log, differs):
    bag = write_log(small_log, tmp_path / 'bag')
    assert differs(read_log(bag), read_log(only_file(bag))) == []
    assert differs(read_log(bag), read_log(bag / 'metadata.yaml')) == []


@pytest.mark.parametrize('compression', ['none', 'zstd', 'lz4'])
def test_compressions(tmp_path, small_log, differs, compression):
    assert differs(small_log, read_log(write_log(small_log, tmp_path / 'bag', compression=compression))) == []


def test_several_files_of_one_bag(tmp_path, small_log, differs):
    """Split as rosbag2 splits: each file has its own channels and only some topics."""
    whole = write_log(small_log, tmp_path / 'whole')
    first = write_log(replace(small_log, spot=replace_none(small_log)), tmp_path / 'first')
    split = tmp_path / 'split'
    split.mkdir()
    only_file(first).rename(split / 'split_0.mcap')
    with BagWriter(tmp_path / 'second', live=False) as bag:
        bag.add_topic('/cell1/psd/spot', TOPICS[SPOT])
        for k in range(0, len(small_log.spot), 5):
            rows = slice(k, k + 5)
            stamp = int(small_log.spot.time_ns[k])
            bag.write('/cell1/psd/spot', encode_spot(
                stamp, small_log.spot.setup_names[small_log.spot.setup[k]], 0.02,
                small_log.spot.values[rows, 0], small_log.spot.values[rows, 1],
                small_log.spot.health[rows]), stamp, stamp, k // 5 + 1)
    only_file(tmp_path / 'second').rename(split / 'split_1.mcap')
    info = yaml.safe_load((whole / 'metadata.yaml').read_text())
    info['rosbag2_bagfile_information']['relative_file_paths'] = ['split_0.mcap', 'split_1.mcap']
    (split / 'metadata.yaml').write_text(yaml.safe_dump(info))
    assert differs(small_log, read_log(split)) == []


def replace_none(log: CalibrationLog):
    return type(log.spot).empty(2)


def two_machines(tmp_path: Path, log: CalibrationLog) -> Path:
    """Both machines of the two logs in one folder of files."""
    both = tmp_path / 'both'
    both.mkdir()
    for name in ('left', 'right'):
        only_file(write_log(log, tmp_path / name, namespace=f'/hall/{name}')).rename(both / f'{name}.mcap')
    return both


def test_several_machines_need_a_choice(tmp_path, small_log, differs):
    both = two_machines(tmp_path, small_log)
    with pytest.raises(StepdiagError) as error:
        read_log(both)
    assert '/hall/left, /hall/right' in one_line(error) and '--namespace' in str(error.value)
    with pytest.raises(StepdiagError, match=r'no machine middle.*/hall/left, /hall/right'):
        read_log(both, 'middle')
    for spelling in ('/hall/right', 'hall/right', '/hall/right/'):
        log = read_log(both, spelling)
        assert log.namespace == '/hall/right'
        assert differs(small_log, log) == []


def raw_bag(path: Path, messages: list[tuple[str, bytes, int, int]], types: dict[str, tuple] | None = None,
            prefix: str = '/cell1') -> Path:
    """A bag of given messages: (relative topic, CDR, log time, sequence)."""
    with BagWriter(path, live=False) as bag:
        for relative in dict.fromkeys(m[0] for m in messages):
            given = (types or {}).get(relative)
            if given:
                bag.add_topic(f'{prefix}/{relative}', given[0], schema_text=given[1], type_hash='')
            else:
                bag.add_topic(f'{prefix}/{relative}', TOPICS[relative])
        for relative, data, log_time, sequence in messages:
            bag.write(f'{prefix}/{relative}', data, log_time, log_time, sequence)
    return path


def messages_of(log: CalibrationLog, order: str = '<') -> list[tuple[str, bytes, int, int]]:
    """Every message of a small log, plainly encoded, in order of time."""
    found = [(DESCRIPTION, encode_string(log.description.to_yaml(), order), int(log.steps.time_ns[0]), 1)]
    s = log.steps
    for k in range(len(s)):
        t = int(s.time_ns[k])
        found.append((STEP, encode_step(t, s.run_ids[s.run[k]], s.setup_names[s.setup[k]], s.repeat[k],
                                        s.direction[k], s.index[k], s.axis[k], s.commanded[k],
                                        s.phase[k], order=order), t, k + 1))
    for number, k in enumerate(range(0, len(log.displacement), 5), 1):
        d, p, rows = log.displacement, log.spot, slice(k, k + 5)
        t = int(d.time_ns[k])
        name = d.setup_names[d.setup[k]]
        found.append((DISPLACEMENT, encode_displacement(t, name, 0.02, d.values[rows], 1.00027,
                                                        d.health[rows], order), t, number))
        found.append((SPOT, encode_spot(t, name, 0.02, p.values[rows, 0], p.values[rows, 1],
                                        p.health[rows], order), t, number))
    for topic, key in (('environment/air_temperature', 'air_temperature'),
                       ('environment/air_pressure', 'air_pressure'), ('environment/humidity', 'humidity')):
        for k, t in enumerate(log.environment[key].time_ns):
            found.append((topic, encode_scalar(int(t), 'air', log.environment[key].value[k], 1e-4, order),
                          int(t), k + 1))
    for k, t in enumerate(log.environment['scale_temperature/x'].time_ns):
        for number, axis in enumerate('xyz'):
            value = log.environment[f'scale_temperature/{axis}'].value[k]
            found.append(('environment/scale_temperature', encode_scalar(int(t), axis, value, 1e-4, order),
                          int(t), 3 * k + number + 1))
    return sorted(found, key=lambda m: m[2])


@pytest.mark.parametrize('order', ['<', '>'])
def test_either_byte_order(tmp_path, small_log, differs, order):
    bag = raw_bag(tmp_path / 'bag', messages_of(small_log, order))
    assert differs(small_log, read_log(bag)) == []


def test_blocks_of_differing_length_and_beams(tmp_path, small_log):
    """Each block another length, two setups with another number of beams."""
    rng = np.random.default_rng(2)
    messages = [m for m in messages_of(small_log) if m[0] != DISPLACEMENT]
    expected = []
    stamps = small_log.displacement.time_ns[::5]
    for number, stamp in enumerate(int(s) for s in stamps):
        setup = 'ppp' if number < 8 else 'lin_x'
        beams = 1 if setup == 'ppp' else 3
        values = rng.normal(size=(number % 4 + 1, beams))
        expected.append(np.hstack([values, np.full((len(values), 3 - beams), np.nan)]))
        messages.append((DISPLACEMENT, encode_displacement(stamp, setup, 0.001, values, 1.0,
                                                           np.full(len(values), 90)), stamp, number + 1))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert np.array_equal(log.displacement.values, np.concatenate(expected), equal_nan=True)
    assert np.array_equal(log.displacement.block, np.repeat(np.arange(10), [len(e) for e in expected]))
    assert not warned(log, 'NaN')


def test_sample_time_is_rounded_not_cut(tmp_path, small_log):
    """Cutting 0.007 s times 147 would lose a nanosecond."""
    t = int(small_log.displacement.time_ns[0])
    assert int(147 * 0.007 * SECOND) == 1_028_999_999
    messages = [m for m in messages_of(small_log) if m[0] != DISPLACEMENT]
    messages.append((DISPLACEMENT, encode_displacement(t, 'ppp', 0.007, np.zeros(200), 1.0, np.full(200, 9)), t, 1))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert np.array_equal(log.displacement.time_ns - t, np.arange(200) * 7_000_000)


def test_extended_message_is_read(tmp_path, small_log, differs):
    """A lab's own field at the end of a contract message does no harm."""
    messages = [(topic, data + b'\x07' if topic == STEP else data, t, n)
                for topic, data, t, n in messages_of(small_log)]
    head, tail = schema_text(TOPICS[STEP]).split('=' * 80, 1)
    text = '# extended by the lab\n' + head + 'uint8 operator_id # who\n' + '=' * 80 + tail
    bag = raw_bag(tmp_path / 'bag', messages, {STEP: (TOPICS[STEP], text)})
    assert differs(small_log, read_log(bag)) == []


# What it refuses

def test_no_bag(tmp_path):
    with pytest.raises(StepdiagError, match='does not exist'):
        read_log(tmp_path / 'nothing')
    (tmp_path / 'folder').mkdir()
    with pytest.raises(StepdiagError, match=r'neither metadata\.yaml nor a \.mcap'):
        read_log(tmp_path / 'folder')


def test_empty_file(tmp_path):
    file = tmp_path / 'empty.mcap'
    file.touch()
    with pytest.raises(StepdiagError, match=r'empty\.mcap: is empty \(0 bytes\)'):
        read_log(file)


def test_not_an_mcap(tmp_path):
    file = tmp_path / 'text.mcap'
    file.write_text('this is no recording at all, only text')
    with pytest.raises(StepdiagError, match='is not an MCAP file'):
        read_log(file)


@pytest.mark.parametrize('keep', [0.2, 0.5, 0.9, 0.999])
def test_truncated_file(tmp_path, small_log, keep):
    bag = write_log(small_log, tmp_path / 'bag')
    file = only_file(bag)
    data = file.read_bytes()
    file.write_bytes(data[:int(len(data) * keep)])
    with pytest.raises(StepdiagError) as error:
        read_log(bag)
    assert f'stepdiag recover {bag}' in one_line(error) and file.name in str(error.value)


def test_every_flipped_byte_is_noticed(tmp_path, small_log, differs):
    """Each byte of the file in turn: an error, or the very same log."""
    bag = write_log(small_log, tmp_path / 'bag')
    file = only_file(bag)
    data = file.read_bytes()
    for place in range(0, len(data), 61):
        flipped = bytearray(data)
        flipped[place] ^= 0x10
        file.write_bytes(flipped)
        try:
            log = read_log(bag)
        except StepdiagError as error:
            assert '\n' not in str(error) and file.name in str(error), place
        else:
            assert differs(small_log, log) == [], place


def test_flipped_byte_without_data_crc_is_found_in_its_chunk(tmp_path, small_log):
    """Files of rosbag2 carry chunk CRCs only."""
    bag = write_log(small_log, tmp_path / 'bag', compression='none')
    file = only_file(bag)
    data = bytearray(file.read_bytes())
    end = struct.unpack_from('<Q', data, len(data) - 28)[0]    # summary start: DataEnd lies before
    data[end - 4:end] = bytes(4)
    file.write_bytes(data)
    read_log(bag)
    data[len(data) // 3] ^= 1
    file.write_bytes(data)
    with pytest.raises(StepdiagError, match=r'chunk \d+ at byte \d+ fails its CRC'):
        read_log(bag)


def test_any_damage_is_a_line_or_a_log(tmp_path, small_log):
    """Random bytes in a file without CRCs: every outcome is a log or one line, for all commands."""
    bag = write_log(small_log, tmp_path / 'bag', compression='none')
    with open(only_file(bag), 'rb') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    whole = bytearray(only_file(bag).read_bytes())
    end = struct.unpack_from('<Q', whole, len(whole) - 28)[0]
    for place in (end - 4, len(whole) - 12, *(c.chunk_start_offset + 33 for c in chunks)):
        whole[place:place + 4] = bytes(4)
    file = tmp_path / 'damaged.mcap'
    file.write_bytes(whole)
    assert warned(read_log(file), 'no CRCs')
    random = np.random.default_rng(5)
    read = 0
    for number in range(60):
        data = whole.copy()
        for place in random.integers(8, len(data), 1 + number % 4):
            data[place] = random.integers(256)
        if number % 10 == 0:
            data = data[:random.integers(len(data))]
        file.write_bytes(data)
        for command in (read_log, summarise, lambda f: recover(f, tmp_path / f'mended_{number}')):  # noqa: B023
            try:
                command(file)
                read += 1
            except StepdiagError as error:
                assert '\n' not in str(error), number
    assert read > 60


def test_flipped_byte_outside_the_chunks(tmp_path, small_log):
    """The metadata record stands in no chunk: the CRC of the data section guards it."""
    bag = write_log(small_log, tmp_path / 'bag')
    data = bytearray(only_file(bag).read_bytes())
    data[data.index(b'serialized_metadata') + 40] ^= 1
    only_file(bag).write_bytes(data)
    with pytest.raises(StepdiagError, match='CRC of its data section'):
        read_log(bag)


def test_chunk_that_is_no_longer_one(tmp_path, small_log):
    """An opcode flipped in a file without CRCs: the counts do not agree."""
    bag = write_log(small_log, tmp_path / 'bag')
    file = only_file(bag)
    data = bytearray(file.read_bytes())
    end = struct.unpack_from('<Q', data, len(data) - 28)[0]
    data[end - 4:end] = bytes(4)
    with open(file, 'rb') as stream:
        chunk, = make_reader(stream).get_summary().chunk_indexes
    assert data[chunk.chunk_start_offset] == 6
    data[chunk.chunk_start_offset] = 0x7F
    file.write_bytes(data)
    with pytest.raises(StepdiagError, match=r'announces \d+ messages and holds 0'):
        read_log(bag)


def test_file_without_crcs_says_so(shared):
    log = read_log(shared / 'field_logs' / 'open' / 'log_05')
    assert warned(log, 'no CRCs')


@pytest.mark.parametrize('relative', [STEP, DISPLACEMENT, DESCRIPTION])
def test_missing_topic(tmp_path, small_log, relative):
    bag = raw_bag(tmp_path / 'bag', [m for m in messages_of(small_log) if m[0] != relative])
    with pytest.raises(StepdiagError) as error:
        read_log(bag)
    assert f'topic /cell1/{relative} ({TOPICS[relative]}) is missing' in one_line(error)


def test_missing_description_can_be_given(tmp_path, small_log, differs):
    bag = raw_bag(tmp_path / 'bag', [m for m in messages_of(small_log) if m[0] != DESCRIPTION])
    assert differs(small_log, read_log(bag, description=small_log.description)) == []


def test_missing_spot_is_a_warning(tmp_path, small_log):
    log = read_log(raw_bag(tmp_path / 'bag', [m for m in messages_of(small_log) if m[0] != SPOT]))
    assert len(log.spot) == 0 and warned(log, '/cell1/psd/spot is missing')


def test_bag_of_something_else(tmp_path):
    with BagWriter(tmp_path / 'bag', live=False) as bag:
        bag.add_topic('/chatter', 'std_msgs/msg/String')
        bag.write('/chatter', encode_string('hello'), 1, 1, 1)
    with pytest.raises(StepdiagError, match=r'holds no topic of a calibration log \(it holds /chatter\)'):
        read_log(tmp_path / 'bag')


def test_mistyped_topic(tmp_path, small_log):
    messages = [m for m in messages_of(small_log) if m[0] != DISPLACEMENT]
    messages.append((DISPLACEMENT, encode_string('x'), messages[-1][2], 1))
    name = 'std_msgs/msg/String'
    bag = raw_bag(tmp_path / 'bag', messages, {DISPLACEMENT: (name, schema_text(name))})
    with pytest.raises(StepdiagError) as error:
        read_log(bag)
    assert 'topic /cell1/interferometer/displacement has type std_msgs/msg/String, ' \
        'the contract wants stepdiag_msgs/msg/Displacement' in one_line(error)


@pytest.mark.parametrize(('old', 'new', 'complaint'), [
    ('float64[] displacement', 'float32[] displacement', 'field displacement of its .* is float32.*float64'),
    ('uint8 beams\n', '', 'has no field beams'),
    ('float64[] displacement', 'what is this', 'not a message definition'),
    ('MSG: std_msgs/Header', 'MSG: std_msgs/Other', 'definition of std_msgs/Header is missing')])
def test_mistyped_field(tmp_path, small_log, old, new, complaint):
    text = schema_text(TOPICS[DISPLACEMENT])
    assert old in text
    bag = raw_bag(tmp_path / 'bag', messages_of(small_log),
                  {DISPLACEMENT: (TOPICS[DISPLACEMENT], text.replace(old, new))})
    with pytest.raises(StepdiagError, match=complaint) as error:
        read_log(bag)
    assert '/cell1/interferometer/displacement' in one_line(error)


def test_description_that_is_no_description(tmp_path, small_log):
    messages = [(t, encode_string('setups: [') if t == DESCRIPTION else d, at, n)
                for t, d, at, n in messages_of(small_log)]
    with pytest.raises(StepdiagError, match=r'/cell1/cell_description.*not valid YAML'):
        read_log(raw_bag(tmp_path / 'bag', messages))


def test_descriptions_that_differ(tmp_path, small_log):
    messages = messages_of(small_log)
    again = encode_string(small_log.description.to_yaml())
    messages.append((DESCRIPTION, again, messages[-1][2], 2))
    assert len(read_log(raw_bag(tmp_path / 'same', messages)).steps) == len(small_log.steps)
    other = encode_string(small_log.description.to_yaml().replace('small', 'large'))
    messages.append((DESCRIPTION, other, messages[-1][2], 3))
    with pytest.raises(StepdiagError, match='2 descriptions that differ'):
        read_log(raw_bag(tmp_path / 'other', messages))


def test_foreign_storage_and_missing_file(tmp_path, small_log):
    bag = write_log(small_log, tmp_path / 'bag')
    file = bag / 'metadata.yaml'
    text = file.read_text()
    file.write_text(text.replace('storage_identifier: mcap', 'storage_identifier: sqlite3'))
    with pytest.raises(StepdiagError, match=r'stored as sqlite3.*ros2 bag convert'):
        read_log(bag)
    file.write_text(text.replace("compression_mode: ''", 'compression_mode: MESSAGE'))
    with pytest.raises(StepdiagError, match='compressed one by one'):
        read_log(bag)
    file.write_text(text.replace('bag_0.mcap', 'bag_0.mcap.zstd'))
    with pytest.raises(StepdiagError, match=r'bag_0\.mcap\.zstd is compressed as a whole'):
        read_log(bag)
    file.write_text(text)
    only_file(bag).unlink()
    with pytest.raises(StepdiagError, match=r'bag_0\.mcap and there is no .mcap file'):
        read_log(bag)


# What it leaves out and says

def test_unknown_setup_in_step_and_frame(tmp_path, small_log):
    messages = messages_of(small_log)
    t = int(small_log.steps.time_ns[-1]) + SECOND
    messages.append((STEP, encode_step(t, 'qqq/0/+', 'qqq', 0, 1, 0, 255, (0, 0, 0), DWELL), t, 99))
    messages.append((DISPLACEMENT, encode_displacement(t, 'npp', 0.02, np.zeros(3), 1.0, np.full(3, 9)), t, 99))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert len(log.steps) == len(small_log.steps)
    assert len(log.displacement) == len(small_log.displacement)
    assert warned(log, "left out 1 event(s) of unknown setup 'qqq'", 'ppp, lin_x')
    assert warned(log, "left out 1 block(s) of unknown setup 'npp'")


def test_all_setups_unknown_is_an_error(tmp_path, small_log):
    text = small_log.description.to_yaml()
    only = '\n'.join(line for line in text.splitlines()).replace('ppp:', 'nnp:').replace('lin_x:', 'lin_y:')
    messages = [(t, encode_string(only) if t == DESCRIPTION else d, at, n)
                for t, d, at, n in messages_of(small_log)]
    with pytest.raises(StepdiagError, match=r"sequencer/step holds nothing.*unknown setup 'ppp'"):
        read_log(raw_bag(tmp_path / 'bag', messages))


@pytest.mark.parametrize('bad', [np.nan, np.inf])
def test_nan_in_samples(tmp_path, small_log, bad):
    messages = messages_of(small_log)
    number = next(k for k, m in enumerate(messages) if m[0] == DISPLACEMENT)
    d = small_log.displacement
    values = d.values[:5].copy()
    values[[1, 3]] = bad
    messages[number] = (DISPLACEMENT, encode_displacement(int(d.time_ns[0]), 'ppp', 0.02, values, 1.00027,
                                                          d.health[:5]), messages[number][2], 1)
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    keep = np.ones(len(d), bool)
    keep[[1, 3]] = False
    assert np.array_equal(log.displacement.values, d.values[keep])
    assert np.array_equal(log.displacement.time_ns, d.time_ns[keep])
    assert warned(log, 'displacement: left out 2 of 50 samples that are NaN, infinite or far beyond any reading')


@pytest.mark.parametrize('bad', [np.nan, np.inf, 1e300])
def test_a_stop_without_a_possible_position_is_at_the_plans(tmp_path, small_log, bad):
    commanded, index = small_log.steps.commanded.copy(), small_log.steps.index.copy()
    at = 4
    commanded[at, 1] = bad
    spoilt = replace(small_log, steps=replace(small_log.steps, commanded=commanded))
    log = read_log(raw_bag(tmp_path / 'bag', messages_of(spoilt)))
    setup = log.steps.setup_names[log.steps.setup[at]]
    np.testing.assert_array_equal(log.steps.commanded[at], stops(log.description, setup).positions[index[at]])
    assert warned(log, 'sequencer/step: 1 event(s) carry a commanded position', "the plan's position stands")
    index[at] = 100
    spoilt = replace(spoilt, steps=replace(spoilt.steps, index=index))
    log = read_log(raw_bag(tmp_path / 'no_index', messages_of(spoilt)))
    assert len(log.steps) == len(index) - 1 and np.isfinite(log.steps.commanded).all()
    assert warned(log, 'sequencer/step: left out 1 event(s)', 'no index of the plan')


def test_nan_in_environment(tmp_path, small_log):
    messages = messages_of(small_log)
    t = messages[-1][2] + 1
    messages.append(('environment/humidity', encode_scalar(t, 'air', np.nan), t, 5))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert len(log.environment['humidity'].value) == 4
    assert warned(log, 'environment/humidity: left out 1 value(s)')


def test_a_topic_of_which_nothing_is_left_is_none(tmp_path, small_log):
    """Pressure in hPa: whoever asks for it must not find a series without a reading."""
    messages = [(topic, encode_scalar(t, 'air', 1013.25, 1.0), t, number) if topic == 'environment/air_pressure'
                else (topic, data, t, number) for topic, data, t, number in messages_of(small_log)]
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert 'air_pressure' not in log.environment and 'air_temperature' in log.environment
    assert warned(log, 'environment/air_pressure: left out', 'check the unit')


def test_the_air_after_the_last_stop_changes_nothing(tmp_path, small_log, differs):
    """An evaluation at the end of a calibration and one of the bag, which went on, are the same."""
    end, messages = int(small_log.steps.time_ns[-1]), messages_of(small_log)
    before = [m for m in messages if not m[0].startswith('environment') or m[2] <= end]
    late = [(topic, encode_scalar(end + 10**9, 'air', 300.0, 1e-4), end + 10**9, 99)
            for topic in ('environment/air_temperature', 'environment/air_pressure')]
    cut, whole = raw_bag(tmp_path / 'cut', before), raw_bag(tmp_path / 'whole', before + late)
    assert differs(read_log(cut), read_log(whole)) == []


def test_scale_of_no_axis(tmp_path, small_log):
    messages = messages_of(small_log)
    t = messages[-1][2] + 1
    messages.append(('environment/scale_temperature', encode_scalar(t, 'w', 20.0), t, 13))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert warned(log, "frame_id 'w'", 'must be x, y or z')
    assert 'scale_temperature/w' not in log.environment


def test_time_running_backwards_is_put_in_order(tmp_path, small_log, differs):
    messages = messages_of(small_log)
    distances = [m for m in messages if m[0] == DISPLACEMENT]
    others = [m for m in messages if m[0] != DISPLACEMENT]
    log = read_log(raw_bag(tmp_path / 'bag', others + distances[::-1]))
    assert differs(small_log, log) == []
    assert warned(log, 'interferometer/displacement: time runs backwards 9 time(s)')


def test_overlapping_blocks_are_put_in_order(tmp_path, small_log):
    messages = [m for m in messages_of(small_log) if m[0] != DISPLACEMENT]
    t = int(small_log.displacement.time_ns[0])
    for number, shift in enumerate((0, 10_000_000)):
        messages.append((DISPLACEMENT, encode_displacement(t + shift, 'ppp', 0.02, np.arange(5.0) + number / 2,
                                                           1.0, np.full(5, 50)), t + shift, number + 1))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert np.array_equal(log.displacement.values[:, 0], np.arange(10) / 2)
    assert warned(log, 'overlap in time')


def test_messages_that_come_twice(tmp_path, small_log, differs):
    messages = messages_of(small_log)
    step = next(m for m in messages if m[0] == STEP)
    block = next(m for m in messages if m[0] == SPOT)
    log = read_log(raw_bag(tmp_path / 'bag', messages + [step, block]))
    assert warned(log, 'sequencer/step: left out 1 event(s) that the log holds twice')
    assert warned(log, 'psd/spot: left out 1 block(s) that the log holds twice')
    # The numbers of the blocks after the doubled one are higher by one; all else is the same.
    assert [d for d in differs(small_log, log) if d != 'spot.block'] == []


def test_doubled_stop(tmp_path, small_log):
    messages = messages_of(small_log)
    t = int(small_log.steps.time_ns[-1]) + SECOND
    messages.append((STEP, encode_step(t, 'lin_x/0/+', 'lin_x', 0, 1, 1, 0, (0.8, 0, 0), DWELL), t, 99))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert warned(log, 'run lin_x/0/+', 'stop(s) 1 visited more than once')
    assert len(log.steps) == len(small_log.steps) + 1


def test_missing_stop_run_and_repeat(tmp_path, small_log):
    s = small_log.steps
    keep = ~((s.run == 0) & (s.index == 2)) & (s.run != 2)
    cut = replace(s, run_ids=s.run_ids[:2], **{k: getattr(s, k)[keep] for k in (
        'time_ns', 'run', 'setup', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')})
    plan = replace(small_log.description.plan, repeats=2)
    log = replace(small_log, steps=cut, description=replace(small_log.description, plan=plan))
    read = read_log(write_log(log, tmp_path / 'bag'))
    assert warned(read, 'run ppp/0/+', '1 of 4 stops missing: 2')
    assert warned(read, 'setup lin_x is described but has no run')
    assert warned(read, 'setup ppp: 1 of 2 planned repeats')


def test_stop_beyond_the_plan(tmp_path, small_log):
    messages = messages_of(small_log)
    t = int(small_log.steps.time_ns[-1]) + SECOND
    messages.append((STEP, encode_step(t, 'lin_x/0/+', 'lin_x', 0, 1, 7, 0, (0.8, 0, 0), DWELL), t, 99))
    assert warned(read_log(raw_bag(tmp_path / 'bag', messages)), 'stop(s) 7 beyond the 2 of the plan')


@pytest.mark.parametrize(('field', 'value', 'what'), [
    ('phase', 9, 'phase is none'), ('axis', 7, 'axis is none'), ('direction', 0, 'neither +1 nor -1')])
def test_step_that_means_nothing(tmp_path, small_log, field, value, what):
    given = {'repeat': 0, 'direction': 1, 'index': 1, 'axis': 0, 'commanded_m': (0, 0, 0),
             'phase': DWELL, field: value}
    messages = messages_of(small_log)
    t = int(small_log.steps.time_ns[-1]) + SECOND
    messages.append((STEP, encode_step(t, 'lin_x/0/+', 'lin_x', **given), t, 99))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert len(log.steps) == len(small_log.steps) and warned(log, 'left out 1 event(s)', what)


def test_wrong_counts_in_metadata(tmp_path, small_log, differs):
    bag = write_log(small_log, tmp_path / 'bag')
    file = bag / 'metadata.yaml'
    info = yaml.safe_load(file.read_text())
    info['rosbag2_bagfile_information']['topics_with_message_count'][1]['message_count'] = 12345
    file.write_text(yaml.safe_dump(info))
    log = read_log(bag)
    assert warned(log, 'metadata.yaml says 12345', 'sequencer/step', 'the bag holds 30')
    assert differs(small_log, log) == []


@pytest.mark.parametrize('text', ['', 'rosbag2_bagfile_information: 7', 'a: [', '- 1\n- 2\n'])
def test_metadata_that_is_none(tmp_path, small_log, differs, text):
    bag = write_log(small_log, tmp_path / 'bag')
    (bag / 'metadata.yaml').write_text(text)
    log = read_log(bag)
    assert differs(small_log, log) == [] and warned(log, 'metadata.yaml cannot be read')


def test_no_metadata(tmp_path, small_log, differs):
    bag = write_log(small_log, tmp_path / 'bag')
    (bag / 'metadata.yaml').unlink()
    log = read_log(bag)
    assert differs(small_log, log) == [] and warned(log, 'metadata.yaml is missing')


def test_zero_signal_quality_is_kept_and_counted(tmp_path, changed, small_log):
    health = small_log.displacement.health.copy()
    health[[4, 7, 8]] = 0.0
    log = read_log(write_log(changed('displacement', health=health), tmp_path / 'bag'))
    assert np.array_equal(log.displacement.health, health)
    assert warned(log, '3 of 50 samples in the dwells have signal quality 0')


def test_a_beam_that_is_gone_between_the_dwells_is_nothing_to_say(tmp_path, changed, small_log):
    health, time = small_log.displacement.health.copy(), small_log.steps.time_ns.copy()
    health[0] = 0.0
    time[np.flatnonzero(small_log.steps.phase == DWELL)[0]] += 1        # the first sample is of the move before
    assert not warned(read_log(write_log(replace(
        changed('displacement', health=health), steps=replace(small_log.steps, time_ns=time)), tmp_path / 'bag')),
        'signal quality 0')


def test_dwell_without_samples(tmp_path, small_log):
    messages = messages_of(small_log)
    number = [k for k, m in enumerate(messages) if m[0] == DISPLACEMENT][3]
    del messages[number]
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert warned(log, '1 of 10 dwells hold no displacement sample: ppp/0/+ stop 3')
    assert not warned(log, 'no spot sample')


@pytest.mark.parametrize(('change', 'what'), [
    ({'quality': np.full(4, 9)}, 'disagree in length'),
    ({'refractive_index': 0.0}, 'refractive index'),
    ({'refractive_index': np.nan}, 'refractive index'),
    ({'sample_period_s': 0.0}, 'sample period'),
    ({'sample_period_s': 1e300}, 'sample period'),
    ({'sample_period_s': np.nan}, 'sample period')])
def test_block_that_cannot_be(tmp_path, small_log, change, what):
    messages = messages_of(small_log)
    t = int(small_log.steps.time_ns[-1]) + SECOND
    given = {'sample_period_s': 0.02, 'displacement_m': np.zeros(5), 'refractive_index': 1.0,
                 'quality': np.full(5, 9)} | change
    messages.append((DISPLACEMENT, encode_displacement(t, 'ppp', **given), t, 11))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert len(log.displacement) == 50 and warned(log, 'left out 1 block(s)', what)


def test_spot_lengths_that_disagree(tmp_path, small_log):
    messages = messages_of(small_log)
    t = messages[-1][2] + SECOND
    messages.append((SPOT, encode_spot(t, 'ppp', 0.02, np.zeros(5), np.zeros(4), np.zeros(5)), t, 11))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert len(log.spot) == 50 and warned(log, 'psd/spot: left out 1 block(s)', 'disagree in length')


def test_empty_block_is_no_fault(tmp_path, small_log, differs):
    messages = messages_of(small_log)
    t = messages[-1][2] + SECOND
    messages.append((DISPLACEMENT, encode_displacement(t, 'ppp', 0.02, np.zeros(0), 1.0, np.zeros(0)), t, 11))
    assert differs(small_log, read_log(raw_bag(tmp_path / 'bag', messages))) == []


def test_message_that_is_cut(tmp_path, small_log, differs):
    messages = messages_of(small_log)
    last = [m for m in messages if m[0] == SPOT][-1]
    messages.append((SPOT, last[1][:-8], last[2] + SECOND, 11))
    messages.append((STEP, b'\x00\x01', last[2] + SECOND, 99))
    log = read_log(raw_bag(tmp_path / 'bag', messages))
    assert differs(small_log, log) == []
    assert warned(log, 'psd/spot: left out 1 block(s) that do not hold their type')
    assert warned(log, 'sequencer/step: left out 1 message(s) that do not hold their type')


def test_gaps_in_sequence_numbers_are_losses(tmp_path, small_log):
    messages = list(messages_of(small_log))
    gone = [k for k, m in enumerate(messages) if m[0] == SPOT][4:7]
    log = read_log(raw_bag(tmp_path / 'bag', [m for k, m in enumerate(messages) if k not in gone]))
    assert warned(log, 'psd/spot: 3 message(s) were lost before the recorder')


def test_unnumbered_messages_are_not_losses(tmp_path, small_log, differs):
    log = read_log(raw_bag(tmp_path / 'bag', [(t, d, at, 0) for t, d, at, _ in messages_of(small_log)]))
    assert differs(small_log, log) == [] and not warned(log, 'lost')


def test_publisher_that_began_anew_is_not_a_loss(tmp_path, small_log):
    messages = [(t, d, at, n - 5 if t == SPOT and n > 5 else n) for t, d, at, n in messages_of(small_log)]
    assert not warned(read_log(raw_bag(tmp_path / 'bag', messages)), 'lost')


def test_order_is_stamp_then_sequence(tmp_path, small_log):
    """Events of one stamp stand in the order of their numbers, whatever the log's order."""
    messages = [m for m in messages_of(small_log) if m[0] != STEP]
    t = int(small_log.steps.time_ns[0])
    sent = [(STEP, encode_step(t, 'lin_x/0/+', 'lin_x', 0, 1, k, 0, (0, 0, 0), DWELL), t, 10 + k) for k in (1, 0)]
    log = read_log(raw_bag(tmp_path / 'bag', messages + sent))
    assert log.steps.index.tolist() == [0, 1]


def test_reading_needs_no_ros(small_log, tmp_path):
    """bag/ must work where neither rclpy nor stepdiag_msgs is installed."""
    bag = write_log(small_log, tmp_path / 'bag')
    code = ('import sys; sys.modules["rclpy"] = sys.modules["stepdiag_msgs"] = None\n'
            'from stepdiag_ros.bag.reader import read_log\n'
            f'print(len(read_log({str(bag)!r}).steps))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == '30'


