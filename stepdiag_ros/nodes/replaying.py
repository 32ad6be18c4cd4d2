"""A bag's messages in the order (stamp, machine, sequence), for replay.

Never through an executor: executors promise no order.  Where the system clock was set while the bag was
recorded, stamps are put right first.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.clocksteps import shift_ns, steps_of
from stepdiag_ros.bag.msgdef import contract_fields, layout
from stepdiag_ros.bag.scan import HEADER_SIZE, McapFile
from stepdiag_ros.bag.schemas import CLOCK_STEP, DESCRIPTION, TOPICS, split_topic
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes.assembler import LogAssembler, table_of

SECOND = 1_000_000_000


@dataclass(frozen=True, order=True)
class Message:
    """One serialised message; compares by (stamp, machine, sequence), then by place in the bag.

    ``stamp_ns`` is the header's, −1 for the description, which has none and comes first.
    """

    stamp_ns: int
    namespace: str
    sequence: int
    place: int
    topic: str
    cdr: bytes


def read_messages(path: str | Path, namespace: str | None = None) -> tuple[str, list[Message]]:
    """The contract's messages of one machine, in order; and its namespace.

    Raises :class:`StepdiagError` for damage, for several machines without ``namespace``,
    and for messages that are not laid out as the contract's.
    """
    source = open_bag(path)
    found: list[Message] = []
    for file_path in source.files:
        file = McapFile(file_path)
        names: dict[int, tuple[str, str] | None] = {}
        for segment in file.segments():
            ids, sequences, _, _ = segment.headers()
            for i, channel in enumerate(ids):
                channel = int(channel)
                if channel not in names:
                    names[channel] = _contract_topic(file, channel)
                if names[channel] is None:
                    continue
                begin = int(segment.offsets[i]) + HEADER_SIZE
                cdr = segment.buffer[begin:begin + int(segment.lengths[i])].tobytes()
                space, topic = names[channel]
                found.append(Message(_stamp(cdr, topic), space, int(sequences[i]), len(found),
                                     topic, cdr))
    machines = sorted({message.namespace for message in found})
    if namespace is None and len(machines) > 1:
        raise StepdiagError(f'{path}: holds the machines {", ".join(machines)}; '
                            'choose one with --namespace')
    if namespace is None:
        chosen = machines[0] if machines else ''
    else:
        chosen = next((m for m in machines if m.strip('/') == namespace.strip('/')), None)
        if chosen is None:
            raise StepdiagError(f'{path}: has no machine {namespace}; '
                                f'it holds {", ".join(machines) or "none"}')
    return chosen, sorted(_put_right([message for message in found if message.namespace == chosen]))


def _put_right(messages: list[Message]) -> list[Message]:
    """The messages without their ``clock_step``, stamps of a step's topics on the log's first time scale."""
    said = [(m.place, m.sequence, m.cdr) for m in messages if m.topic == CLOCK_STEP]
    if not said:
        return messages
    steps = steps_of(table_of(CLOCK_STEP, TOPICS[CLOCK_STEP], said))
    right = {m.place: m for m in messages if m.topic != CLOCK_STEP}
    for topic in {step.topic for step in steps}:
        mine = [m for m in right.values() if m.topic == topic and m.stamp_ns >= 0]
        shift = shift_ns(*(np.array([getattr(m, key) for m in mine], np.int64)
                           for key in ('stamp_ns', 'sequence', 'place')),
                         [step for step in steps if step.topic == topic])
        for message, by in zip(mine, shift, strict=True):
            if by:
                stamp = message.stamp_ns + int(by)
                order = '<iI' if message.cdr[1] & 1 else '>iI'
                cdr = message.cdr[:4] + struct.pack(order, *divmod(stamp, SECOND)) + message.cdr[12:]
                right[message.place] = replace(message, stamp_ns=stamp, cdr=cdr)
    return list(right.values())


def _contract_topic(file: McapFile, channel_id: int) -> tuple[str, str] | None:
    """Namespace and relative topic of a channel of the contract; ``None`` for others."""
    channel = file.channels.get(channel_id)
    split = None if channel is None else split_topic(channel.topic)
    if split is None:
        return None
    schema = file.schemas.get(channel.schema_id)
    wanted = contract_fields(TOPICS[split[1]])
    fields = None
    if schema is not None and channel.message_encoding == 'cdr' and schema.encoding == 'ros2msg':
        fields = layout(channel.topic, schema.name, schema.data.decode('utf-8', 'replace'),
                        TOPICS[split[1]], str(file.path))
    if fields is None or fields[:len(wanted)] != wanted:
        raise StepdiagError(f'{file.path}: topic {channel.topic} is not laid out as the contract has it '
                            'and cannot be replayed; use: stepdiag evaluate')
    return split


def _stamp(cdr: bytes, topic: str) -> int:
    if topic == DESCRIPTION or len(cdr) < 12:
        return -1
    seconds, nanoseconds = struct.unpack_from('<iI' if cdr[1] & 1 else '>iI', cdr, 4)
    return seconds * SECOND + nanoseconds


def assemble(path: str | Path, namespace: str | None = None,
             progress: Callable[[int, int], None] = lambda done, total: None) -> LogAssembler:
    """The bag's messages sent through the solver node's own collection."""
    space, messages = read_messages(path, namespace)
    assembler = LogAssembler(space, str(path))
    for done, message in enumerate(messages, 1):
        assembler.add(message.topic, message.cdr, message.sequence)
        if done % 1000 == 0 or done == len(messages):
            progress(done, len(messages))
    return assembler


def paced(messages: list[Message], speed: float) -> Iterator[tuple[float, Message]]:
    """Each message with the seconds after the start at which it is due."""
    stamps = [m.stamp_ns for m in messages if m.stamp_ns >= 0]
    first = min(stamps, default=0)
    for message in messages:
        yield max(0, message.stamp_ns - first) / SECOND / speed, message
