"""What must be received before a start, and what ends a run."""

import time

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.watch import Recording, Watch

SOURCES = ('/m/interferometer/displacement', '/m/psd/spot')
DESCRIPTION = '/m/cell_description'


def recording(receives=(*SOURCES, DESCRIPTION), bag='/bags/a', on=True) -> Recording:
    return Recording(time.monotonic(), on, bag, frozenset(receives))


def watch(timeout_s: float = 30.0) -> Watch:
    return Watch(SOURCES, [DESCRIPTION], timeout_s)


def block(one: Watch, topic: str, setup: str = 'ppp', signal: bool = True) -> None:
    now = time.time_ns()
    one.block(topic, now, now + 1, signal, setup)


def test_nothing_heard_names_everything():
    assert watch().wants() == [f'nothing was received on {SOURCES[0]}', f'nothing was received on {SOURCES[1]}',
                               'the recorder is silent']


def test_ready_when_all_deliver_and_the_recorder_hears_them():
    one = watch()
    for topic in SOURCES:
        block(one, topic)
    one.recorder(recording())
    assert one.wants() == []
    one.check('/bags/a', 'ppp')


def test_the_recorders_word_counts():
    one = watch()
    for topic in SOURCES:
        block(one, topic)
    one.recorder(recording(on=False))
    assert one.wants() == ['the recorder is not recording']
    one.recorder(recording(receives=[DESCRIPTION, SOURCES[0]]))
    assert one.wants() == [f'the recorder does not receive {SOURCES[1]}']


def test_a_source_that_falls_silent_is_named():
    one = watch(timeout_s=0.01)
    for topic in SOURCES:
        block(one, topic)
    time.sleep(0.03)
    one.recorder(recording())
    assert [w.split(' has been silent')[0] for w in one.wants()] == list(SOURCES)


def test_a_listener_that_samples_do_not_reach_yet_would_miss_the_first_stops():
    """That it is known to the graph does not mean that its subscriptions are matched."""
    one, began = watch(), time.monotonic()
    assert one.not_receiving(['solver'], began) == ['solver has not reported what it receives']
    one.listener('solver', frozenset([DESCRIPTION, SOURCES[0]]))
    assert one.not_receiving(['solver'], began) == [f'solver does not receive {SOURCES[1]}']
    one.listener('solver', frozenset([DESCRIPTION, *SOURCES]))
    assert one.not_receiving(['solver'], began) == []
    # What it received of the log before this one says nothing of this one.
    assert one.not_receiving(['solver'], time.monotonic()) == ['solver has not reported what it receives']


def test_what_came_before_the_goal_does_not_count():
    one = watch()
    for topic in SOURCES:
        block(one, topic)
    one.recorder(recording())
    began = time.monotonic()
    assert one.wants(since_s=began) == [f'{SOURCES[0]} delivers nothing', f'{SOURCES[1]} delivers nothing',
                                        'the recorder is silent']
    for topic in SOURCES:
        block(one, topic)
    one.recorder(recording())
    assert one.wants(since_s=began) == []


def test_dark_beams_matter_in_a_run_only():
    one = watch(timeout_s=0.02)
    one.recorder(recording())
    for topic in SOURCES:
        block(one, topic, signal=False)
    time.sleep(0.03)
    for topic in SOURCES:
        block(one, topic, signal=False)
    one.recorder(recording())
    assert one.wants() == []
    with pytest.raises(StepdiagError, match='delivers no signal'):
        one.check('/bags/a', 'ppp')
    one.begin()
    one.check('/bags/a', 'ppp')


def test_darkness_is_known_at_once():
    one = watch()
    block(one, SOURCES[0], signal=False)
    block(one, SOURCES[1])
    assert one.dark()
    block(one, SOURCES[0])
    assert not one.dark()


def test_blocks_of_another_setup_end_a_run():
    one = watch()
    one.recorder(recording())
    for topic in SOURCES:
        block(one, topic, setup='npp')
    one.begin()
    one.check('/bags/a', 'ppp')      # these came before the setup was mounted
    time.sleep(0.001)
    block(one, SOURCES[1], setup='npp')
    with pytest.raises(StepdiagError, match="/m/psd/spot speaks of setup 'npp' in a run of 'ppp'"):
        one.check('/bags/a', 'ppp')


def test_a_driver_that_was_away_for_a_moment_is_not_forgiven():
    one = watch()
    one.recorder(recording())
    block(one, SOURCES[0])
    block(one, SOURCES[1], setup='')
    block(one, SOURCES[1])           # somebody has told it the setup again
    with pytest.raises(StepdiagError, match="/m/psd/spot speaks of setup ''"):
        one.check('/bags/a', 'ppp')
    one.begin()
    one.check('/bags/a', 'ppp')


def test_another_bag_ends_a_run():
    one = watch()
    one.recorder(recording(bag='/bags/b'))
    for topic in SOURCES:
        block(one, topic)
    with pytest.raises(StepdiagError, match='began another bag'):
        one.check('/bags/a', 'ppp')
