"""A bag's messages in the order (stamp, machine, sequence), for replay.

Never through an executor: executors promise no order.  Where the system clock was set while the bag was
recorded, or a driver's clock was not the sequencer's, stamps are put right first.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.clockoffsets import STAMPED, offsets_of
from stepdiag_ros.bag.clocksteps import shift_ns, steps_of
from stepdiag_ros.bag.msgdef import contract_fields, layout
from stepdiag_ros.bag.scan import HEADER_SIZE, McapFile
from stepdiag_ros.bag.schemas import CLOCK_OFFSET, CLOCK_STEP, DESCRIPTION, OCCASIONAL, STEP, TOPICS, split_topic
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
    """The messages without their ``clock_step``, all stamps on the time scale on which the sequencer's began.

    What is left of ``clock_offset`` says that nothing is to be taken off any more, and how well that is known.
    """
    tables = {topic: table_of(topic, TOPICS[topic], said) for topic in OCCASIONAL
              if (said := [(m.place, m.sequence, m.cdr) for m in messages if m.topic == topic])}
    if not tables:
        return messages
    steps, offsets = steps_of(tables.get(CLOCK_STEP)), offsets_of(tables)
    right = {m.place: m for m in messages if m.topic != CLOCK_STEP}
    for topic in {step.topic for step in steps}:
        mine = [m for m in right.values() if m.topic == topic and m.stamp_ns >= 0]
        shift = shift_ns(*(np.array([getattr(m, key) for m in mine], np.int64)
                           for key in ('stamp_ns', 'sequence', 'place')),
                         [step for step in steps if step.topic == topic])
        for message, by in zip(mine, shift, strict=True):
            if by:
                right[message.place] = _stamped(message, message.stamp_ns + int(by))
    end_ns = max((m.stamp_ns for m in right.values() if m.topic == STEP), default=0)
    left: dict[int, Message] = {}
    for sensor, known in offsets.items():
        clock = known.until(end_ns)
        if not clock.one:
            for message in [m for m in right.values() if m.topic in STAMPED[sensor]]:
                ahead = int(clock.ahead_ns(np.array([message.stamp_ns]))[0])
                right[message.place] = _stamped(message, message.stamp_ns - ahead)
        for place, offset_ns in zip(known.number.tolist(), known.offset_ns.tolist(), strict=True):
            left[place] = _saying(right[place], offset_ns / SECOND if clock.one else 0.0)
    return [left.get(m.place, m) for m in right.values() if m.topic != CLOCK_OFFSET or m.place in left]


def _stamped(message: Message, stamp_ns: int) -> Message:
    """The message with another stamp, as far as a stamp reaches: seconds are 32 bits."""
    stamp_ns = min(max(stamp_ns, -2**31 * SECOND), 2**31 * SECOND - 1)
    order = '<iI' if message.cdr[1] & 1 else '>iI'
    cdr = message.cdr[:4] + struct.pack(order, *divmod(stamp_ns, SECOND)) + message.cdr[12:]
    return replace(message, stamp_ns=stamp_ns, cdr=cdr)


def _saying(message: Message, offset_s: float) -> Message:
    """A ``clock_offset`` with another offset: the last number but one of its two."""
    return replace(message, cdr=message.cdr[:-16] + struct.pack('<d' if message.cdr[1] & 1 else '>d', offset_s)
                   + message.cdr[-8:])


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
