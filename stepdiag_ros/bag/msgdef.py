"""Message definitions as text: parsing ``ros2msg`` schemas, writing them.

A schema is a definition followed by those it needs, set apart by a line of 80
``=`` and ``MSG: package/Name``.  Fields are flattened to dotted paths, because a
decoder needs the order on the wire and nothing else.
"""

import re
from dataclasses import dataclass

from stepdiag_ros.bag.schemas import DEFINITIONS
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits

#: Size in bytes of each primitive; also its alignment.
SIZES = {'bool': 1, 'byte': 1, 'char': 1, 'int8': 1, 'uint8': 1, 'int16': 2, 'uint16': 2,
         'int32': 4, 'uint32': 4, 'float32': 4, 'int64': 8, 'uint64': 8, 'float64': 8}
SEPARATOR = '=' * 80
SEQUENCE = -1
UNSUPPORTED = 'unsupported'

_FIELD = re.compile(r'^(?P<type>[A-Za-z][\w/]*)(?P<bound><=\d+)?'
                    r'(?P<array>\[(?:(?:<=)?\d+)?\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$')


@dataclass(frozen=True)
class Field:
    """One primitive on the wire.

    ``path`` is dotted (``header.stamp.sec``); ``kind`` a primitive, ``string`` or
    ``unsupported``; ``array`` is ``None``, a fixed length, or ``SEQUENCE``.
    """

    path: str
    kind: str
    array: int | None = None

    def __str__(self) -> str:
        suffix = {None: '', SEQUENCE: '[]'}.get(self.array, f'[{self.array}]')
        return self.kind + suffix


@dataclass(frozen=True)
class _Member:
    name: str
    type: str
    array: int | None


def short_name(name: str) -> str:
    """``std_msgs/msg/Header`` -> ``std_msgs/Header``."""
    return name.replace('/msg/', '/')


def long_name(name: str) -> str:
    """``std_msgs/Header`` -> ``std_msgs/msg/Header``."""
    package, _, last = short_name(name).partition('/')
    return f'{package}/msg/{last}'


def _members(text: str) -> list[_Member]:
    """Fields of one definition; comments, constants and defaults are passed over."""
    members = []
    for raw in text.splitlines():
        line = raw.split('#', 1)[0].strip()
        if not line:
            continue
        match = _FIELD.match(line)
        if match is None:
            raise ValueError(f'cannot read the line {raw.strip()!r}')
        if match['rest'].startswith('='):
            continue
        array = match['array']
        size = None if array is None else \
            (SEQUENCE if array == '[]' or '<=' in array else int(array[1:-1]))
        members.append(_Member(match['name'], match['type'], size))
    return members


def parse(name: str, text: str) -> tuple[Field, ...]:
    """Fields of the ``ros2msg`` schema ``text`` of type ``name``, in order on the wire.

    Raises ``ValueError`` with what is wrong if the text is no message definition.
    """
    if len(text) > limits.SCHEMA_BYTES:
        raise ValueError(f'it has {len(text)} letters, at most {limits.SCHEMA_BYTES} are read')
    head, *tail = re.split(r'(?m)^={3,}\s*$', text)
    definitions = {}
    for part in tail:
        match = re.match(r'\s*MSG:\s*(\S+)[^\n]*\n?', part)
        if match is None:
            raise ValueError("a part after the line of '=' does not begin with 'MSG:'")
        definitions[short_name(match[1])] = part[match.end():]
    fields: list[Field] = []

    def walk(package: str, body: str, prefix: str, depth: int) -> None:
        if depth > limits.SCHEMA_DEPTH:
            raise ValueError('definitions contain each other')
        for member in _members(body):
            if len(fields) >= limits.SCHEMA_FIELDS:
                raise ValueError(f'it has more than {limits.SCHEMA_FIELDS} fields')
            path = prefix + member.name
            if member.type in SIZES or member.type == 'string':
                unreadable = member.type == 'string' and member.array is not None
                fields.append(Field(path, UNSUPPORTED if unreadable else member.type, member.array))
                continue
            if member.type == 'wstring' or member.array is not None:
                fields.append(Field(path, UNSUPPORTED, member.array))
                continue
            inner = short_name(member.type)
            if '/' not in inner:
                inner = 'std_msgs/Header' if inner == 'Header' else f'{package}/{inner}'
            if inner not in definitions:
                raise ValueError(f'the definition of {inner} is missing')
            walk(inner.split('/')[0], definitions[inner], path + '.', depth + 1)

    walk(name.split('/')[0], head, '', 0)
    return tuple(fields)


def dependencies(name: str) -> list[str]:
    """Types that ``name`` needs, itself left out, in the order a schema lists them."""
    found: list[str] = []

    def walk(outer: str) -> None:
        for member in _members(DEFINITIONS[outer]):
            if member.type in SIZES or member.type == 'string':
                continue
            inner = long_name(member.type if '/' in member.type else f'{outer.split("/")[0]}/{member.type}')
            if inner not in found:
                found.append(inner)
                walk(inner)

    walk(name)
    return found


def schema_text(name: str) -> str:
    """The ``ros2msg`` schema of a type of :data:`schemas.DEFINITIONS`, dependencies included."""
    if name not in DEFINITIONS:
        raise StepdiagError(f'no definition of message type {name} is built in; pass its text')
    parts = [DEFINITIONS[name]]
    parts += [f'{SEPARATOR}\nMSG: {short_name(inner)}\n{DEFINITIONS[inner]}'
              for inner in dependencies(name)]
    return ''.join(parts)


def contract_fields(name: str) -> tuple[Field, ...]:
    """Fields that the contract fixes for type ``name``."""
    return parse(name, schema_text(name))


def layout(topic: str, name: str, text: str, contract: str, source: str) -> tuple[Field, ...]:
    """Layout of ``topic`` as its own schema gives it, checked against the ``contract`` type.

    Every field of the contract must be there with its type; fields beyond are let
    pass, so that a lab may extend a message (decision 0011).
    Raises :class:`StepdiagError` which names the topic and both types.
    """
    if long_name(name) != contract:
        raise StepdiagError(f'{source}: topic {topic} has type {name}, the contract wants {contract}')
    try:
        fields = parse(contract, text)
    except ValueError as error:
        raise StepdiagError(f'{source}: topic {topic}: schema of {name} is not a message '
                            f'definition: {error}') from None
    have = {field.path: field for field in fields}
    for want in contract_fields(contract):
        got = have.get(want.path)
        if got is None:
            raise StepdiagError(f'{source}: topic {topic}: its {name} has no field {want.path}, '
                                f'the contract wants {want} {want.path}')
        if got != want:
            raise StepdiagError(f'{source}: topic {topic}: field {want.path} of its {name} is '
                                f'{got}, the contract wants {want}')
    return fields
