"""kill -9 on a process that records: at most half a second is lost.

A real process writes two sensors' blocks, each numbered and stamped by the number,
2000 messages a second and topic, and tells through a pipe what it has handed to the
writer.  It is killed in the middle.  Loss is counted in the messages' own time, so a
slow machine does not change the verdict.
"""

import os
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from stepdiag_ros.bag.recover import recover
from stepdiag_ros.bag.scan import McapFile

PERIOD = 500_000    # ns between messages of a topic
ALLOWED = 500_000_000    # ns that may be lost
TOPICS = ('/cell1/interferometer/displacement', '/cell1/psd/spot')
WRITER = """
import os, struct, sys, time
import numpy as np
from stepdiag_ros.bag.codec import encode_displacement, encode_spot
from stepdiag_ros.bag.writer import BagWriter

bag = BagWriter(sys.argv[1], compression=sys.argv[2])
pipe = int(sys.argv[3])
topics = sys.argv[4:]
bag.add_topic(topics[0], 'stepdiag_msgs/msg/Displacement')
bag.add_topic(topics[1], 'stepdiag_msgs/msg/SpotPosition')
values = np.random.default_rng(1).normal(size=(3, 10))
number = 0
while True:
    number += 1
    stamp = number * 500_000
    bag.write(topics[0], encode_displacement(stamp, 'ppp', 5e-5, values[0], 1.0, np.full(10, 99)),
              stamp, stamp, number)
    bag.write(topics[1], encode_spot(stamp, 'ppp', 5e-5, *values), stamp, stamp, number)
    os.write(pipe, struct.pack('<q', number))
    time.sleep(0.0005)
"""


def write_until(path: Path, count: int, compression: str = 'zstd') -> int:
    """Let a process write ``count`` messages a topic and more, kill it; returns the last number."""
    reading, writing = os.pipe()
    process = subprocess.Popen([sys.executable, '-c', WRITER, str(path), compression, str(writing), *TOPICS],
                               pass_fds=(writing,), stderr=subprocess.PIPE)
    os.close(writing)
    last, rest = 0, b''
    try:
        with open(reading, 'rb', buffering=0) as pipe:
            killed = False
            while data := pipe.read(65536):
                rest += data
                whole = len(rest) // 8 * 8
                if whole:
                    last, = struct.unpack('<q', rest[whole - 8:whole])
                    rest = rest[whole:]
                if last >= count and not killed:
                    process.send_signal(signal.SIGKILL)
                    killed = True
    finally:
        process.kill()
        _, said = process.communicate()
    assert process.returncode == -signal.SIGKILL, said.decode()
    return last


def numbers(bag: Path) -> dict[str, np.ndarray]:
    """Sequence numbers of each topic in order of the file."""
    file, = bag.glob('*.mcap')
    scan = McapFile(file)
    found: dict[str, list[np.ndarray]] = {}
    for segment in scan.segments():
        ids, sequence, _, _ = segment.headers()
        for number in np.unique(ids):
            found.setdefault(scan.channels[int(number)].topic, []).append(sequence[ids == number])
    return {topic: np.concatenate(parts) for topic, parts in found.items()}


@pytest.mark.parametrize(('count', 'compression'), [(700, 'zstd'), (2600, 'none'), (5100, 'zstd')])
def test_killed_writer_loses_at_most_half_a_second(tmp_path, count, compression):
    bag = tmp_path / 'killed'
    last = write_until(bag, count, compression)
    info = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert {t['topic_metadata']['name'] for t in info['topics_with_message_count']} == set(TOPICS)

    outcome = recover(bag)
    assert any('footer' in fault or 'middle of a record' in fault for fault in outcome.faults)
    kept = numbers(outcome.target)
    assert kept.keys() == set(TOPICS)
    for topic, sequence in kept.items():
        assert np.array_equal(sequence, np.arange(1, len(sequence) + 1)), f'{topic} has holes'
        lost = (last - len(sequence)) * PERIOD
        assert lost <= ALLOWED, f'{topic}: {lost / 1e9:.3f} s of {last * PERIOD / 1e9:.3f} s lost'
    for topic in outcome.topics:
        assert topic.recovered == len(kept[topic.topic]) and topic.gaps == 0
