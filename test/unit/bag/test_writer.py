"""BagWriter and write_log."""

import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from stepdiag_ros.bag.codec import encode_string
from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.qos import LATCHED, RELIABLE, parse_qos, qos_profile, qos_yaml
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.scan import McapFile
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.bag.tables import collect
from stepdiag_ros.bag.typehash import rihs01
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import Samples

STRING = 'std_msgs/msg/String'


def only_file(bag: Path) -> Path:
    file, = bag.glob('*.mcap')
    return file


def information(bag: Path) -> dict:
    return yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


@pytest.mark.parametrize('block_samples', [None, 1, 3, 100])
def test_round_trip_is_bit_identical(tmp_path, small_log, differs, block_samples):
    log = read_log(write_log(small_log, tmp_path / 'bag', block_samples))
    # Smaller blocks are other blocks; every number is the same.
    blocks = [] if block_samples is None or block_samples >= 5 else ['displacement.block', 'spot.block']
    assert differs(small_log, log) == blocks
    assert log.warnings == ()


def test_round_trip_of_a_field_log(tmp_path, shared, differs):
    log = read_log(shared / 'field_logs' / 'open' / 'log_02')
    assert differs(log, read_log(write_log(log, tmp_path / 'bag'))) == []


def test_round_trip_of_uneven_times(tmp_path, small_log, changed, differs):
    """Samples at odd times: blocks are cut where one period does not describe them."""
    rng = np.random.default_rng(4)
    n = 50
    times = small_log.displacement.time_ns[0] + np.cumsum(rng.integers(1, 3_000_000, n))
    times[20:30] = times[20] + np.arange(10) * 333_333
    times[30:] += 10_000_000
    log = changed('displacement', time_ns=times)
    back = read_log(write_log(log, tmp_path / 'bag'))
    assert [d for d in differs(log, back) if d != 'displacement.block'] == []


@pytest.mark.parametrize('rate', [3000.0, 7.0, 44_100.0, 1e6 / 3])
def test_round_trip_of_rates_that_are_no_whole_nanoseconds(tmp_path, changed, differs, rate):
    """The times are rounded, and still one period describes a block: it is not cut."""
    times = 1_790_000_000_000_000_000 + np.rint(np.arange(50) * 1e9 / rate).astype(np.int64)
    log = changed('displacement', time_ns=times, block=np.zeros(50, np.intp), setup=np.zeros(50, np.intp))
    assert differs(log, read_log(write_log(log, tmp_path / 'bag'))) == []


def test_round_trip_of_several_beams(tmp_path, small_log, changed, differs):
    d = small_log.displacement
    values = np.hstack([d.values, d.values + 1.0, d.values + 2.0])
    values[d.setup == 1, 1:] = np.nan    # the linear setup has one beam
    log = changed('displacement', values=values)
    assert differs(log, read_log(write_log(log, tmp_path / 'bag'))) == []


def test_same_log_gives_same_bytes(tmp_path, small_log):
    first, second = (only_file(write_log(small_log, tmp_path / n / 'bag')).read_bytes() for n in 'ab')
    assert first == second


def test_log_without_spot_or_environment(tmp_path, small_log):
    log = replace(small_log, spot=Samples.empty(2), environment={})
    back = read_log(write_log(log, tmp_path / 'bag'))
    assert len(back.spot) == 0 and back.environment == {}


def test_what_a_recorder_must_write(tmp_path, small_log):
    """The list of the design, item by item."""
    bag = write_log(small_log, tmp_path / 'bag', custom_data={'operator': 'bench 3'})
    assert sorted(f.name for f in bag.iterdir()) == ['bag_0.mcap', 'metadata.yaml']
    info = information(bag)
    assert info['version'] == 9 and info['storage_identifier'] == 'mcap'
    assert info['relative_file_paths'] == ['bag_0.mcap'] and info['custom_data'] == {'operator': 'bench 3'}
    with open(bag / 'bag_0.mcap', 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == 'ros2'
        messages = list(reader.iter_messages(log_time_order=False))
        metadata = list(reader.iter_metadata())
    assert summary.attachment_indexes == [] and len(summary.chunk_indexes) >= 1
    assert summary.statistics.message_count == len(messages) == info['message_count']
    assert all(c.message_index_offsets for c in summary.chunk_indexes)
    assert [m.name for m in metadata] == ['rosbag2']
    assert yaml.safe_load(metadata[0].metadata['serialized_metadata'])['message_count'] == len(messages)
    listed = {t['topic_metadata']['name']: t for t in info['topics_with_message_count']}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        about = listed[channel.topic]['topic_metadata']
        assert channel.message_encoding == 'cdr' and schema.encoding == 'ros2msg'
        assert schema.name == about['type']
        assert channel.metadata['topic_type_hash'] == about['type_description_hash'] == rihs01(schema.name)
        # The same QoS in both places, a text here and a list there.
        assert yaml.safe_load(channel.metadata['offered_qos_profiles']) == about['offered_qos_profiles'] != []
        assert listed[channel.topic]['message_count'] == sum(c.id == channel.id for _, c, _ in messages)
    text = next(s.data.decode() for s in summary.schemas.values() if s.name.endswith('Step'))
    assert '\n' + '=' * 80 + '\nMSG: builtin_interfaces/Time\nint32 sec\n' in text
    sequences: dict[str, list[int]] = {}
    for _, channel, message in messages:
        sequences.setdefault(channel.topic, []).append(message.sequence)
        assert message.publish_time <= message.log_time
    assert all(s == list(range(1, len(s) + 1)) for s in sequences.values())


def test_log_time_is_receipt_and_publish_time_the_stamp(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/a', STRING)
        bag.write('/a', encode_string('x'), 2_000, 1_000, 2**32 + 7)
    with open(only_file(tmp_path / 'bag'), 'rb') as stream:
        (_, _, message), = make_reader(stream).iter_messages()
    assert (message.log_time, message.publish_time, message.sequence) == (2_000, 1_000, 7)
    info = information(tmp_path / 'bag')
    assert info['starting_time'] == {'nanoseconds_since_epoch': 2_000}
    assert info['duration'] == {'nanoseconds': 0}


def test_many_threads_lose_nothing(tmp_path):
    count, threads = 400, 6
    with BagWriter(tmp_path / 'bag', flush_period=0.01, sync_period=0.02) as bag:
        def work(number: int) -> None:
            bag.add_topic(f'/t{number}', STRING)
            for k in range(count):
                bag.write(f'/t{number}', encode_string(f'{number} {k}'), k + 1, k + 1, k + 1)
        workers = [threading.Thread(target=work, args=(n,)) for n in range(threads)]
        for w in workers:
            w.start()
        for w in workers:
            w.join()
        assert bag.counts == {f'/t{n}': count for n in range(threads)}
    file = McapFile(only_file(tmp_path / 'bag'))
    assert sum(len(s) for s in file.segments()) == count * threads and file.complete


def test_metadata_is_there_from_the_first_moment(tmp_path):
    bag = BagWriter(tmp_path / 'bag', live=False)
    assert information(tmp_path / 'bag')['message_count'] == 0
    bag.add_topic('/a', STRING, LATCHED)
    topic, = information(tmp_path / 'bag')['topics_with_message_count']
    assert topic['topic_metadata']['offered_qos_profiles'] == parse_qos(LATCHED, '/a')
    bag.close()


def test_flush_hands_everything_to_the_system(tmp_path):
    bag = BagWriter(tmp_path / 'bag', live=False)
    bag.add_topic('/a', STRING)
    for k in range(10):
        bag.write('/a', encode_string(str(k)), k + 1, k + 1, k + 1)
    bag.flush()
    torn = McapFile(only_file(tmp_path / 'bag'), tolerant=True)
    assert sum(len(s) for s in torn.segments()) == 10
    assert torn.faults == ['has no footer: its recording was not closed']
    bag.close()


def test_closing_twice_and_writing_after(tmp_path):
    bag = BagWriter(tmp_path / 'bag')
    bag.add_topic('/a', STRING)
    bag.close()
    bag.close()
    bag.flush()
    with pytest.raises(StepdiagError, match='the bag is closed'):
        bag.write('/a', b'', 1, 1, 1)


def test_existing_bag_is_not_overwritten(tmp_path, small_log):
    bag = write_log(small_log, tmp_path / 'bag')
    before = only_file(bag).read_bytes()
    with pytest.raises(StepdiagError, match='exists already'):
        write_log(small_log, bag)
    assert only_file(bag).read_bytes() == before
    (tmp_path / 'empty').mkdir()
    write_log(small_log, tmp_path / 'empty')    # an empty folder is a place like any other


def test_place_that_cannot_be_written(tmp_path):
    (tmp_path / 'file').write_text('x')
    with pytest.raises(StepdiagError, match='cannot be written'):
        BagWriter(tmp_path / 'file' / 'bag')


def test_full_disk_reaches_the_caller(tmp_path):
    """/dev/full takes nothing: the flush fails, the next write says so."""
    bag = BagWriter(tmp_path / 'bag', flush_period=0.01)
    bag.add_topic('/a', STRING)
    real = bag._stream.raw
    with open('/dev/full', 'wb', buffering=0) as full:
        saved = os.dup(real.fileno())
        os.dup2(full.fileno(), real.fileno())
        try:
            with pytest.raises(StepdiagError, match='cannot be written'):
                for k in range(1, 200_000):
                    bag.write('/a', encode_string('x' * 1000), k, k, k)
        finally:
            os.dup2(saved, real.fileno())
            os.close(saved)
    with pytest.raises(StepdiagError, match='stepdiag recover'):
        bag.close()
    bag.close()


def test_topic_mistakes(tmp_path):
    with BagWriter(tmp_path / 'bag', live=False) as bag:
        bag.add_topic('/a', STRING)
        bag.add_topic('/a', STRING)
        with pytest.raises(StepdiagError, match='/a is recorded as std_msgs/msg/String and was announced'):
            bag.add_topic('/a', 'sensor_msgs/msg/Temperature')
        with pytest.raises(StepdiagError, match='/b was not announced'):
            bag.write('/b', b'', 1, 1, 1)
        with pytest.raises(StepdiagError, match='topic /c: its QoS is no YAML list'):
            bag.add_topic('/c', STRING, 'reliable')
        with pytest.raises(StepdiagError, match='pkg/msg/Own'):
            bag.add_topic('/d', 'pkg/msg/Own')
        bag.add_topic('/d', 'pkg/msg/Own', schema_text='uint8 x\n', type_hash='RIHS01_0')
    with pytest.raises(StepdiagError, match='compression'):
        BagWriter(tmp_path / 'other', compression='rar')
    with pytest.raises(StepdiagError, match='blocks of 0 samples'):
        write_log(None, tmp_path / 'third', block_samples=0)


def test_qos_names_what_rosbag2_names():
    profile, = parse_qos(qos_yaml(qos_profile(depth=5, durability='transient_local')), '/a')
    assert profile['depth'] == 5 and profile['durability'] == 'transient_local'
    assert profile['history'] == 'keep_last' and '&' not in RELIABLE


def test_a_long_recording_is_split_so_that_its_index_does_not_grow(tmp_path):
    """Every chunk's index stays in memory until its file is closed: no file may hold more than so many."""
    most, said = 8, 400
    with BagWriter(tmp_path / 'bag', flush_period=0.005, sync_period=0.01, most_chunks=most) as writer:
        for topic in ('/m/a', '/m/b'):
            writer.add_topic(topic, STRING)
        for i in range(said):
            writer.write('/m/a', encode_string(f'{i}'), 100 + i, 100 + i, i + 1)
            if i == said // 2:
                writer.add_topic('/m/late', STRING)
                writer.write('/m/late', encode_string('late'), 100 + i, 100 + i, 1)
            time.sleep(0.002)
        assert writer.counts == {'/m/a': said, '/m/b': 0, '/m/late': 1} and writer.number == 0
    source = open_bag(tmp_path / 'bag')
    assert len(source.files) > 3 and not source.warnings
    assert [file.name for file in source.files] == [f'bag_{k}.mcap' for k in range(len(source.files))]
    chunks = []
    for file in source.files:
        with open(file, 'rb') as stream:
            chunks.append(len(make_reader(stream).get_summary().chunk_indexes))
    assert max(chunks) <= most + 2 and sum(chunks) > 3 * most
    assert source.counts == {'/m/a': said, '/m/b': 0, '/m/late': 1}
    tables = collect(source, lambda topic: True)
    assert tables.topics['/m/a'].count == said and tables.topics['/m/late'].count == 1
    info = information(tmp_path / 'bag')
    assert info['message_count'] == said + 1 == sum(file['message_count'] for file in info['files'])
    assert info['duration']['nanoseconds'] == said - 1
