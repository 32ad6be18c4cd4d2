"""The recorder, killed in the middle: what was received half a second before is in the bag."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.recover import recover
from stepdiag_ros.bag.schemas import DISPLACEMENT
from stepdiag_ros.nodes.patience import Patience
from stepdiag_ros.nodes.replaying import read_messages

RATE_HZ = 100.0
LOSS_S = 0.5


class Source:
    """Publishes description, steps and displacement blocks at a steady rate; notes when."""

    def __init__(self):
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        from stepdiag_ros.bag.schemas import DESCRIPTION, STEP, TOPICS
        from stepdiag_ros.nodes import base, subscription
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node('source', namespace='/kill', context=self._context)
        self._publishers = {
            topic: self.node.create_publisher(subscription.message_class(TOPICS[topic]), topic,
                                              base.reliable(latched=topic == DESCRIPTION))
            for topic in (DESCRIPTION, STEP, DISPLACEMENT)}
        self.sent: list[tuple[int, int]] = []     # stamp of the block, when it was sent
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        from std_msgs.msg import String

        from stepdiag_ros.bag.schemas import DESCRIPTION, STEP
        patience = Patience(60)
        while not all(self._publishers[t].get_subscription_count() for t in (STEP, DISPLACEMENT)):
            assert not patience.over(), 'the recorder does not listen'
            time.sleep(0.05)
        self._publishers[DESCRIPTION].publish(String(data=(
            'schema: 1\nmachine: {name: kill, chain: FXYZ, volume: [0.1, 0.1, 0.1]}\nplan: {steps: 1}\n'
            'setups:\n  ppp: {standoff: 0.2}\n')))
        self._thread.start()

    def _run(self) -> None:
        from std_msgs.msg import Header

        from stepdiag_msgs.msg import Displacement, Step
        from stepdiag_ros.bag.schemas import STEP
        from stepdiag_ros.nodes.stamps import stamp_of
        while not self._stop.wait(1.0 / RATE_HZ):
            now = time.time_ns()
            header = Header(stamp=stamp_of(now), frame_id='ppp')
            self._publishers[DISPLACEMENT].publish(Displacement(
                header=header, sample_period=1e-3, beams=1, displacement=[0.0] * 10,
                refractive_index=1.0, quality=[90] * 10))
            self._publishers[STEP].publish(Step(header=header, run_id='ppp/0/+', setup='ppp',
                                                direction=1, index=0, axis=255, phase=1))
            self.sent.append((now, time.time_ns()))

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def acknowledged(self) -> None:
        from rclpy.duration import Duration
        for publisher in self._publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=30))

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        from stepdiag_ros.nodes import base
        base.end(self.node, self._context)


@pytest.fixture
def recording(ros_domain, tmp_path: Path):
    """A recorder in a process of its own and a source; yields (process, source, bag)."""
    bag = tmp_path / 'log'
    log = open(tmp_path / 'recorder.log', 'wb')
    process = subprocess.Popen(
        [sys.executable, '-m', 'stepdiag_ros.nodes.recorder', '--ros-args', '-r', '__ns:=/kill',
         '-p', f'bag:={bag}', '-p', f'bag_folder:={bag.parent}', '-p', 'autostart:=true'],
        stdout=log, stderr=subprocess.STDOUT)
    log.close()
    source = Source()
    try:
        source.start()
        yield process, source, bag
    finally:
        source.close()
        if process.poll() is None:
            process.kill()
        process.wait()


def test_kill_costs_half_a_second_at_most(recording, tmp_path):
    process, source, bag = recording
    time.sleep(2.5)
    killed_ns = time.time_ns()
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    source.stop()
    recover(bag, tmp_path / 'mended')
    kept = {m.stamp_ns for m in read_messages(tmp_path / 'mended')[1] if m.topic == DISPLACEMENT}
    due = [stamp for stamp, sent in source.sent if sent < killed_ns - LOSS_S * 1e9]
    assert len(due) > 50
    missing = [stamp for stamp in due if stamp not in kept]
    assert not missing, f'{len(missing)} of {len(due)} messages older than {LOSS_S} s are lost'


def test_terminate_drains_and_closes(recording):
    process, source, bag = recording
    time.sleep(1.0)
    source.stop()
    source.acknowledged()    # what was sent has reached the recorder's process, not yet necessarily the bag
    process.terminate()
    assert process.wait(30) == 0
    sent = [stamp for stamp, _ in source.sent]
    kept = sorted(m.stamp_ns for m in read_messages(bag)[1] if m.topic == DISPLACEMENT)
    assert kept == sent
    assert not [w for w in read_log(bag).warnings if 'recover' in w or 'CRC' in w or 'lost' in w]


def test_sequence_numbers_in_the_bag_are_the_publishers(recording):
    process, source, bag = recording
    time.sleep(1.0)
    source.stop()
    process.terminate()
    assert process.wait(30) == 0
    numbers = [m.sequence for m in read_messages(bag)[1] if m.topic == DISPLACEMENT]
    assert numbers == list(range(1, len(numbers) + 1))
