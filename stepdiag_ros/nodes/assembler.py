"""From messages to a :class:`CalibrationLog`, by the very functions that read a bag.

The solver node keeps what it receives here, and ``stepdiag replay`` sends a bag's
messages through it.  Messages are put in the order (stamp, sequence) by
:mod:`stepdiag_ros.bag`, so that the order of arrival leaves no trace in the result.
"""

from pathlib import Path

import numpy as np

from stepdiag_ros.bag.cdr import decode
from stepdiag_ros.bag.msgdef import contract_fields
from stepdiag_ros.bag.reader import build_log
from stepdiag_ros.bag.schemas import DESCRIPTION, DISPLACEMENT, STEP, TOPICS
from stepdiag_ros.bag.source import BagSource
from stepdiag_ros.bag.tables import WANTED, Group, Tables, TopicTable
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import CalibrationLog


class LogAssembler:
    """Keeps the messages of one machine; :meth:`build` makes a log of them.

    ``namespace``: the machine's, for error messages and ``CalibrationLog.namespace``.
    ``source``: what errors call this log.
    """

    def __init__(self, namespace: str = '', source: str = 'the live log'):
        self.namespace = namespace.rstrip('/')
        self.source = source
        self._messages: dict[str, list[tuple[int, int, bytes]]] = {}
        self._number = 0

    def __len__(self) -> int:
        return self._number

    def count(self, topic: str) -> int:
        """Messages kept of a relative topic."""
        return len(self._messages.get(topic, ()))

    def add(self, topic: str, cdr: bytes, sequence: int) -> None:
        """Keep one serialised message of a relative contract topic; others are passed over."""
        if topic in TOPICS:
            self._messages.setdefault(topic, []).append((self._number, sequence, cdr))
            self._number += 1

    def copy(self) -> 'LogAssembler':
        """What is kept now; adding to the one leaves the other as it is."""
        other = LogAssembler(self.namespace, self.source)
        other._messages = {topic: list(messages) for topic, messages in self._messages.items()}
        other._number = self._number
        return other

    def missing(self) -> list[str]:
        """Topics without which nothing can be evaluated and of which there is nothing yet."""
        return [topic for topic in (DESCRIPTION, STEP, DISPLACEMENT) if not self.count(topic)]

    def build(self) -> CalibrationLog:
        """The log of what has been added; :class:`StepdiagError` names what is missing."""
        absent = self.missing()
        if absent:
            raise StepdiagError(f'{self.source}: nothing was received on '
                                f'{", ".join(f"{self.namespace}/{t}" for t in absent)}; '
                                'run a calibration first')
        tables = Tables()
        for relative, messages in self._messages.items():
            topic = f'{self.namespace}/{relative}'
            tables.topics[topic] = table_of(topic, TOPICS[relative], messages)
        return build_log(BagSource(Path(self.source), ()), tables, self.namespace)


def table_of(topic: str, type_name: str, messages: list[tuple[int, int, bytes]]) -> TopicTable:
    """All messages of one topic, grouped by length and decoded at once."""
    number, sequence, payloads = zip(*messages, strict=True)
    number, sequence = np.array(number, np.int64), np.array(sequence, np.int64)
    lengths = np.array([len(p) for p in payloads])
    table = TopicTable(topic, type_name, count=len(payloads), sequences=[sequence])
    fields, names = contract_fields(type_name), frozenset(WANTED[type_name])
    for length in np.unique(lengths):
        rows = np.flatnonzero(lengths == length)
        matrix = np.frombuffer(b''.join(payloads[i] for i in rows), np.uint8)
        done, bad = decode(matrix.reshape(len(rows), int(length)), fields, names)
        table.malformed += len(bad)
        table.groups += [Group(d.values, number[rows[d.rows]], sequence[rows[d.rows]])
                         for d in done]
    return table
