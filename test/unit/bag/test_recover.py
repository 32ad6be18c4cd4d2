"""recover: torn, cut and flipped bags."""

import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from stepdiag_ros.bag.codec import encode_string
from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.recover import recover
from stepdiag_ros.bag.scan import McapFile
from stepdiag_ros.bag.writer import BagWriter
from stepdiag_ros.errors import StepdiagError

STRING = 'std_msgs/msg/String'


def only_file(bag: Path) -> Path:
    file, = bag.glob('*.mcap')
    return file


def chunked(path: Path, compression: str = 'none', chunks: int = 5, each: int = 20) -> list[int]:
    """A bag of several chunks; returns where each begins."""
    with BagWriter(path, live=False, compression=compression) as bag:
        bag.add_topic('/a', STRING)
        bag.add_topic('/b', STRING)
        for k in range(chunks * each):
            for topic in ('/a', '/b'):
                bag.write(topic, encode_string(f'{topic} {k}'), 1000 + k, 1000 + k, k + 1)
            if (k + 1) % each == 0:
                bag.flush()
    with open(only_file(path), 'rb') as stream:
        return [c.chunk_start_offset for c in make_reader(stream).get_summary().chunk_indexes]


def counts(outcome) -> dict[str, tuple[int, int | None]]:
    return {t.topic: (t.recovered, t.lost) for t in outcome.topics}


def texts(bag: Path) -> list[bytes]:
    """Payloads of a bag in order."""
    found = []
    for segment in McapFile(only_file(bag)).segments():
        for offset, length in zip(segment.offsets, segment.lengths, strict=True):
            found.append(segment.buffer[offset + 31:offset + 31 + length].tobytes())
    return found


def test_sound_bag_comes_out_the_same(tmp_path, small_log, differs):
    bag = write_log(small_log, tmp_path / 'bag')
    outcome = recover(bag)
    assert outcome.target == tmp_path / 'bag_recovered' and outcome.faults == ()
    assert differs(small_log, read_log(outcome.target)) == []
    assert all(t.lost == 0 for t in outcome.topics)


@pytest.mark.parametrize('compression', ['none', 'zstd', 'lz4'])
def test_unclosed_bag(tmp_path, compression):
    """Flushed and never closed: the state a killed recorder leaves."""
    bag = BagWriter(tmp_path / 'live', live=False, compression=compression)
    bag.add_topic('/a', STRING)
    for k in range(50):
        bag.write('/a', encode_string(str(k)), k + 1, k + 1, k + 1)
    bag.flush()
    shutil.copytree(tmp_path / 'live', tmp_path / 'torn')
    bag.close()
    outcome = recover(tmp_path / 'torn')
    assert outcome.recovered == 50 and any('no footer' in f for f in outcome.faults)
    assert texts(outcome.target) == [encode_string(str(k)) for k in range(50)]


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_cut_in_every_chunk(tmp_path, compression):
    """Whatever was whole before the cut is there after it, in order, and nothing is made up."""
    starts = chunked(tmp_path / 'bag', compression)
    whole = only_file(tmp_path / 'bag').read_bytes()
    everything = texts(tmp_path / 'bag')
    for number, start in enumerate(starts[1:], 1):
        for cut in (start, start + 5, start + 150):
            only_file(tmp_path / 'bag').write_bytes(whole[:cut])
            outcome = recover(tmp_path / 'bag', tmp_path / f'to_{cut}')
            got = texts(outcome.target)
            assert got == everything[:len(got)] and len(got) >= 40 * number
            assert outcome.recovered == len(got)


def test_cut_chunk_gives_its_whole_records(tmp_path):
    """Uncompressed, the messages of a chunk that is cut off are saved up to the cut."""
    starts = chunked(tmp_path / 'bag')
    file = only_file(tmp_path / 'bag')
    file.write_bytes(file.read_bytes()[:starts[2] + 700])
    outcome = recover(tmp_path / 'bag')
    assert 80 < outcome.recovered < 120
    assert counts(outcome)['/a'][0] + counts(outcome)['/a'][1] == 100    # metadata.yaml knows


def test_flipped_byte_costs_its_chunk_and_no_more(tmp_path):
    starts = chunked(tmp_path / 'bag')
    file = only_file(tmp_path / 'bag')
    data = bytearray(file.read_bytes())
    data[starts[2] + 200] ^= 0x55
    file.write_bytes(data)
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    outcome = recover(tmp_path / 'bag')
    assert counts(outcome) == {'/a': (80, 20), '/b': (80, 20)}
    assert any('chunk 3' in f and 'CRC' in f for f in outcome.faults)
    gaps = {t.topic: t.gaps for t in outcome.topics}
    assert gaps == {'/a': 20, '/b': 20}


def test_broken_record_length_is_jumped_over(tmp_path):
    """A length that leads nowhere: the summary says where the next chunk begins."""
    starts = chunked(tmp_path / 'bag')
    file = only_file(tmp_path / 'bag')
    data = bytearray(file.read_bytes())
    data[starts[1] + 7] ^= 0x7F
    file.write_bytes(data)
    with pytest.raises(StepdiagError, match='stepdiag recover'):
        list(McapFile(file).segments())
    assert counts(recover(tmp_path / 'bag')) == {'/a': (80, 20), '/b': (80, 20)}


def test_bare_file_and_given_target(tmp_path, small_log, differs):
    file = only_file(write_log(small_log, tmp_path / 'bag'))
    assert recover(file).target == file.with_name('bag_0_recovered')
    assert differs(small_log, read_log(recover(file, tmp_path / 'there').target)) == []
    with pytest.raises(StepdiagError, match=r'exists already.*--to'):
        recover(file)


def test_wrong_message_index_does_no_harm(tmp_path):
    """No CRC guards an index in a file of rosbag2; the records themselves decide."""
    starts = chunked(tmp_path / 'bag', chunks=2, each=200)
    file = only_file(tmp_path / 'bag')
    everything = texts(tmp_path / 'bag')
    assert len(everything) == 800
    data = bytearray(file.read_bytes())
    end = int.from_bytes(data[-28:-20], 'little')
    data[end - 4:end] = bytes(4)    # no data CRC, as rosbag2 writes
    length = int.from_bytes(data[starts[0] + 1:starts[0] + 9], 'little')
    index = starts[0] + 9 + length
    assert data[index] == 7
    entries = index + 9 + 6
    # The low and the high byte of the first, a middle and the last offset, in several ways.
    for entry in (0, 77, 199):
        for byte in (8, 9, 10, 15):
            for flip in (0x01, 0x21, 0x80):
                wrong = bytearray(data)
                wrong[entries + 16 * entry + byte] ^= flip
                file.write_bytes(wrong)
                assert texts(tmp_path / 'bag') == everything, (entry, byte, flip)
    # An offset that names a message a second time, and the place of something else.
    for value in (0, int.from_bytes(data[entries + 24:entries + 32], 'little')):
        wrong = bytearray(data)
        wrong[entries + 8:entries + 16] = value.to_bytes(8, 'little')
        file.write_bytes(wrong)
        assert texts(tmp_path / 'bag') == everything, value


def test_result_is_read_back(tmp_path, small_log, monkeypatch):
    """A copy that holds less than was written to it is not called recovered."""
    bag = write_log(small_log, tmp_path / 'bag')
    write = BagWriter.write

    def forgetful(self, topic, data, log_time_ns, publish_time_ns, sequence):
        if sequence != 3:
            write(self, topic, data, log_time_ns, publish_time_ns, sequence)

    monkeypatch.setattr(BagWriter, 'write', forgetful)
    with pytest.raises(StepdiagError, match='do not use this bag'):
        recover(bag)


def test_nothing_to_recover(tmp_path):
    file = tmp_path / 'empty.mcap'
    file.touch()
    with pytest.raises(StepdiagError, match='no message that can be recovered'):
        recover(file)
    file.write_text('no mcap')
    with pytest.raises(StepdiagError, match='no message that can be recovered'):
        recover(file)
    assert not (tmp_path / 'empty_recovered').exists()


def test_one_dead_file_of_two(tmp_path, small_log):
    bag = write_log(small_log, tmp_path / 'bag')
    everything = texts(bag)
    (bag / 'metadata.yaml').unlink()
    (bag / 'bag_1.mcap').touch()
    outcome = recover(bag)
    assert texts(outcome.target) == everything
    assert any('bag_1.mcap: is empty' in f for f in outcome.faults)
