"""Steps of a computer's clock in the middle of a log, and stamps put right.

A node whose system clock was set says so on ``clock_step``: by how much, and how many messages it had
published before on each of its topics.  What it published afterwards is brought back onto the time scale
of the log's beginning, so that dwells keep their length and no two moments of a log have one stamp.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.blocks import SECOND, stamps_ns
from stepdiag_ros.bag.schemas import CLOCK_STEP
from stepdiag_ros.bag.tables import TopicTable

_FIELDS = ('header.stamp.sec', 'header.stamp.nanosec')


@dataclass(frozen=True)
class ClockStep:
    """One step as one topic shows it: ``stamp_ns`` by the clock after it, ``step_ns``, ``published`` before;
    ``number``: place in the log."""

    topic: str
    stamp_ns: int
    step_ns: int
    published: int
    node: str = ''
    number: int = 0


def shift_ns(stamp: np.ndarray, sequence: np.ndarray, number: np.ndarray,
             steps: list[ClockStep]) -> np.ndarray:
    """What to add to each stamp (n,) [ns] of one topic, given its ``steps`` in the order of the log.

    ``sequence`` (n,): the publisher's count, from 1; ``number`` (n,): place in the log.
    """
    shift = np.zeros(len(stamp), np.int64)
    for step in steps:
        after = np.flatnonzero(sequence == step.published + 1)
        if not len(after):   # that very message was lost
            after = np.flatnonzero(sequence > step.published)
        if not len(after):
            continue
        # A publisher that was started again counts from 1 once more: the nearest in time is meant.
        first = number[after[np.argmin(np.abs(stamp[after] - step.stamp_ns))]]
        shift[number >= first] -= step.step_ns
    return shift


def steps_of(table: TopicTable | None) -> list[ClockStep]:
    """The steps that a table of ``clock_step`` holds, in the order of the log."""
    found = []
    for group in table.groups if table is not None else ():
        values = group.values
        stamp = stamps_ns(values)
        found += [ClockStep(
            bytes(values['topic'][i]).decode('utf-8', 'replace'), int(stamp[i]),
            round(float(values['step'][i]) * SECOND), int(values['published'][i]),
            bytes(values['header.frame_id'][i]).decode('utf-8', 'replace'), int(group.number[i]))
            for i in range(len(stamp)) if np.isfinite(values['step'][i]) and abs(values['step'][i]) < 1e9]
    return sorted(found, key=lambda step: step.number)


def set_stamps(table: TopicTable, stamp_ns: np.ndarray) -> None:
    """Give the messages of a table other stamps (n,), in the order of its groups."""
    begin = 0
    for group in table.groups:
        mine = stamp_ns[begin:begin + len(group.number)]
        begin += len(mine)
        # Columns of a decoded message may look at the file's own bytes: new ones take their place.
        group.values[_FIELDS[0]], group.values[_FIELDS[1]] = mine // SECOND, mine % SECOND


def put_right(tables: dict[str, TopicTable | None]) -> list[str]:
    """Put the stamps of one machine's tables (by relative topic) right in place; what was done, in words."""
    steps = steps_of(tables.get(CLOCK_STEP))
    for topic in dict.fromkeys(step.topic for step in steps):
        table = tables.get(topic)
        if table is None or not table.groups or _FIELDS[0] not in table.groups[0].values:
            continue
        stamp = np.concatenate([stamps_ns(group.values) for group in table.groups])
        right = stamp + shift_ns(stamp, np.concatenate([group.sequence for group in table.groups]),
                                 np.concatenate([group.number for group in table.groups]),
                                 [step for step in steps if step.topic == topic])
        set_stamps(table, right)
    said = {(step.node, round(step.step_ns, -6)): step for step in reversed(steps)}
    return [f'{step.node}: the system clock was set by {step.step_ns / SECOND:+.3f} s while the log was '
            'recorded; later stamps are put back onto the time scale of its beginning'
            for step in reversed(said.values())]
