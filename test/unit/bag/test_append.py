"""A bag whose recorder was killed is mended in place and goes on in a further file."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import yaml

from stepdiag_ros.bag.append import go_on
from stepdiag_ros.bag.scan import MAGIC
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.bag.tables import collect

WRITER = """
import sys, time
from stepdiag_ros.bag.writer import BagWriter
bag = BagWriter(sys.argv[1])
bag.add_topic('/m/cell_description', 'std_msgs/msg/String')
for i in range(200):
    bag.write('/m/cell_description', bytes([0, 1, 0, 0, 2, 0, 0, 0, 97, 0]), 10 + i, 10 + i, i + 1)
bag.flush()
print('written', flush=True)
time.sleep(60)
"""


def torn_bag(path: Path) -> None:
    with subprocess.Popen([sys.executable, '-c', WRITER, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == 'written\n'
        os.kill(writer.pid, signal.SIGKILL)


def write(writer, number: int, begin: int) -> None:
    writer.add_topic('/m/cell_description', 'std_msgs/msg/String')
    for i in range(number):
        writer.write('/m/cell_description', b'\x00\x01\x00\x00\x02\x00\x00\x00b\x00', begin + i, begin + i, i + 1)


def test_a_torn_bag_is_mended_and_goes_on(tmp_path):
    bag = tmp_path / 'log'
    torn_bag(bag)
    continued = go_on(bag)
    assert continued.mended == ('log_0.mcap',) and continued.received == {'/m/cell_description': 200}
    assert continued.writer.number == 1
    write(continued.writer, 50, 1000)
    continued.writer.close()
    again = go_on(bag)           # and once more, from a bag that was closed in order
    assert again.mended == () and again.received == {'/m/cell_description': 250} and again.writer.number == 2
    write(again.writer, 5, 2000)
    again.writer.close()
    source = open_bag(bag)
    assert [file.name for file in source.files] == ['log_0.mcap', 'log_1.mcap', 'log_2.mcap']
    assert source.counts == {'/m/cell_description': 255} and not source.warnings
    assert collect(source, lambda topic: True).topics['/m/cell_description'].count == 255
    info = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert info['starting_time']['nanoseconds_since_epoch'] == 10
    assert info['duration']['nanoseconds'] == 2004 - 10 and info['message_count'] == 255
    assert [file['message_count'] for file in info['files']] == [200, 50, 5]
    assert (bag / 'log_0.mcap.torn').exists() and not list(bag.glob('.mending_*'))


def test_a_file_in_which_nothing_was_written_is_put_aside(tmp_path):
    bag = tmp_path / 'log'
    torn_bag(bag)
    go_on(bag).writer.close()
    (bag / 'log_2.mcap').write_bytes(MAGIC)
    continued = go_on(bag)
    assert continued.writer.number == 3 and continued.received == {'/m/cell_description': 200}
    continued.writer.close()
    assert (bag / 'log_2.mcap.torn').exists()
