"""Messages collected live make the same log as a bag read from the disk."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.assembler import LogAssembler
from stepdiag_ros.nodes.replaying import assemble, paced, read_messages
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
schema: 1
seed: 3
machine: {name: small, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.1]}
plan: {steps: 1, repeats: 1}
setups:
  ppp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.2, stops: 2}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, dwell: 0.05}
"""


@pytest.fixture(scope='module')
def log():
    return simulate_log(parse_cell(CELL))


@pytest.fixture(scope='module')
def bag(log, tmp_path_factory):
    return write_log(log, tmp_path_factory.mktemp('bags') / 'small')


def same(one, other) -> None:
    for part in ('displacement', 'spot', 'steps'):
        for name, value in vars(getattr(one, part)).items():
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, getattr(getattr(other, part), name))
    assert one.environment.keys() == other.environment.keys()
    for key, series in one.environment.items():
        np.testing.assert_array_equal(series.value, other.environment[key].value)
    assert one.description == other.description and one.namespace == other.namespace


def test_replay_makes_the_log_that_the_reader_makes(bag):
    same(read_log(bag), assemble(bag).build())


def test_the_order_of_arrival_leaves_no_trace(bag):
    namespace, messages = read_messages(bag)
    shuffled = LogAssembler(namespace)
    for i in np.random.default_rng(1).permutation(len(messages)):
        shuffled.add(messages[i].topic, messages[i].cdr, messages[i].sequence)
    same(read_log(bag), shuffled.build())


def test_messages_come_by_stamp_and_the_description_first(bag):
    namespace, messages = read_messages(bag)
    assert namespace == '/small' and messages[0].topic == 'cell_description'
    stamps = [m.stamp_ns for m in messages]
    assert stamps == sorted(stamps)
    due = [s for s, _ in paced(messages, 2.0)]
    assert due[0] == 0.0 and due[-1] == pytest.approx((stamps[-1] - stamps[1]) * 1e-9 / 2.0)


def test_what_is_missing_is_named():
    empty = LogAssembler('/cell1')
    assert empty.missing() == ['cell_description', 'sequencer/step', 'interferometer/displacement']
    with pytest.raises(StepdiagError, match='nothing was received on /cell1/cell_description'):
        empty.build()


def test_a_copy_stands_still(bag):
    namespace, messages = read_messages(bag)
    one = LogAssembler(namespace)
    for message in messages[:50]:
        one.add(message.topic, message.cdr, message.sequence)
    copy = one.copy()
    one.add(messages[50].topic, messages[50].cdr, messages[50].sequence)
    assert len(copy) == 50 and len(one) == 51


def test_topics_of_others_are_passed_over():
    one = LogAssembler('/cell1')
    one.add('rosout', b'\x00\x01\x00\x00', 1)
    assert len(one) == 0


def test_one_machine_of_several_has_to_be_chosen(log, tmp_path):
    write_log(log, tmp_path / 'one', namespace='/a')
    with pytest.raises(StepdiagError, match='has no machine /b; it holds /a'):
        read_messages(tmp_path / 'one', '/b')
    assert read_messages(tmp_path / 'one', 'a')[0] == '/a'


def test_a_bag_without_spots_is_assembled_too(log, tmp_path):
    spots = type(log.spot).empty(2)
    write_log(replace(log, spot=spots), tmp_path / 'lengths')
    assert len(assemble(tmp_path / 'lengths').build().spot) == 0


def test_a_log_cut_short_anywhere_is_evaluated_or_refused_in_one_line(log):
    """What a cancelled calibration leaves must not end the solver."""
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.model.log import StepEvents
    evaluated = 0
    for length in range(1, len(log.steps) + 1, 2):
        steps = StepEvents(**{name: value[:length] if isinstance(value, np.ndarray) else value
                              for name, value in vars(log.steps).items()})
        try:
            evaluate(replace(log, steps=steps)).to_json_dict()
            evaluated += 1
        except StepdiagError as error:
            assert '\n' not in str(error)
    assert evaluated > len(log.steps) // 3
