"""Idle hours leave no trace in memory; what belongs to a run is kept, and what came just before it."""

from rclpy.serialization import serialize_message

from stepdiag_msgs.msg import Step
from stepdiag_ros.bag.schemas import DESCRIPTION, DISPLACEMENT, STEP
from stepdiag_ros.model.log import DONE, DWELL, MOVE
from stepdiag_ros.nodes.idle import LEAD_S, LONGEST_STOP_S, TAIL_S, IdleFilter

AIR = 'environment/air_temperature'


class Bench:
    def __init__(self):
        self.now, self.kept = 0.0, []
        self.filter = IdleFilter(lambda topic, cdr, sequence: self.kept.append((topic, sequence)), Step,
                                 lambda: self.now)
        self._count = 0

    def stream(self, seconds: float) -> None:
        """Ten blocks of samples and a temperature a second."""
        for i in range(round(seconds * 10)):
            self.now += 0.1
            self._count += 1
            self.filter.add(DISPLACEMENT, b'', self._count)
            if i % 10 == 0:
                self.filter.add(AIR, b'', self._count)

    def step(self, phase: int) -> None:
        self.filter.add(STEP, serialize_message(Step(phase=phase, run_id='ppp/0/+', setup='ppp')), 1)

    def of(self, topic: str) -> list[int]:
        return [sequence for name, sequence in self.kept if name == topic]


def test_idle_hours_are_not_kept():
    bench = Bench()
    bench.filter.add(DESCRIPTION, b'', 1)
    bench.stream(600.0)
    assert bench.of(DESCRIPTION) == [1] and not bench.of(DISPLACEMENT)
    assert bench.filter.waiting()[DISPLACEMENT] <= 10 * LEAD_S + 1
    bench.stream(4000.0)
    assert bench.filter.waiting()[AIR] <= 3601


def test_a_run_is_kept_whole_with_what_came_before_and_after():
    bench = Bench()
    bench.stream(60.0)
    bench.step(MOVE)
    bench.stream(5.0)
    bench.step(DWELL)
    bench.stream(30.0)          # a long dwell, without an event in it
    bench.step(DONE)
    bench.stream(60.0)
    kept = bench.of(DISPLACEMENT)
    assert kept == list(range(kept[0], kept[0] + len(kept)))
    assert 600 - 10 * LEAD_S - 1 <= kept[0] <= 600 - 10 * LEAD_S + 1
    assert 950 + 10 * TAIL_S - 2 <= kept[-1] <= 950 + 10 * TAIL_S + 1
    assert len(bench.of(AIR)) >= 60 + 35


def test_a_sequencer_that_died_in_a_stop_does_not_fill_the_memory():
    bench = Bench()
    bench.step(DWELL)
    bench.now += LONGEST_STOP_S + 1.0
    bench.stream(600.0)
    assert not bench.of(DISPLACEMENT)
