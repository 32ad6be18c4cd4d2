"""Type hashes as ROS 2 computes them: RIHS01 of REP-2011.

SHA-256 of the type's description and of those it refers to, written as JSON in a
fixed order and spacing.  Constants and defaults do not enter.
"""

import hashlib
import json
import re
from collections.abc import Mapping

from stepdiag_ros.bag.msgdef import long_name
from stepdiag_ros.bag.schemas import DEFINITIONS
from stepdiag_ros.errors import StepdiagError

_IDS = {'int8': 2, 'uint8': 3, 'int16': 4, 'uint16': 5, 'int32': 6, 'uint32': 7, 'int64': 8,
        'uint64': 9, 'float32': 10, 'float64': 11, 'char': 3, 'bool': 15, 'byte': 16,
        'string': 17, 'wstring': 18}
_BOUNDED_STRING = {'string': 21, 'wstring': 22}
_ARRAY, _BOUNDED, _UNBOUNDED = 48, 96, 144
_LINE = re.compile(r'^(?P<type>[A-Za-z][\w/]*)(?:<=(?P<chars>\d+))?'
                   r'(?:\[(?P<bound><=)?(?P<size>\d*)\])?\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$')


def rihs01(name: str, definitions: Mapping[str, str] = DEFINITIONS) -> str:
    """``RIHS01_…`` of the message type ``name`` (``package/msg/Name``).

    ``definitions`` maps type names to their texts, those of nested types included.
    """
    described: dict[str, dict] = {}
    _describe(long_name(name), definitions, described)
    mine = described.pop(long_name(name))
    whole = {'type_description': mine,
             'referenced_type_descriptions': [described[k] for k in sorted(described)]}
    return 'RIHS01_' + hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def _describe(name: str, definitions: Mapping[str, str], described: dict[str, dict]) -> None:
    if name in described:
        return
    if name not in definitions:
        raise StepdiagError(f'no definition of message type {name} is known; its hash cannot be computed')
    fields: list[dict] = []
    described[name] = {'type_name': name, 'fields': fields}
    for raw in definitions[name].splitlines():
        match = _LINE.match(raw.split('#', 1)[0].strip())
        if match is None or match['rest'].startswith('='):
            continue
        kind, size = match['type'], match['size']
        step = 0 if size is None else (_UNBOUNDED if not size else
                                       _BOUNDED if match['bound'] else _ARRAY)
        nested = ''
        if match['chars']:
            code = _BOUNDED_STRING[kind]
        elif kind in _IDS:
            code = _IDS[kind]
        else:
            nested = long_name(kind if '/' in kind else f'{name.split("/")[0]}/{kind}')
            code = 1
            _describe(nested, definitions, described)
        fields.append({'name': match['name'],
                       'type': {'type_id': code + step, 'capacity': int(size or 0),
                                'string_capacity': int(match['chars'] or 0),
                                'nested_type_name': nested}})
    if not fields:    # rosidl gives an empty message one member
        fields.append({'name': 'structure_needs_at_least_one_member',
                       'type': {'type_id': _IDS['uint8'], 'capacity': 0, 'string_capacity': 0,
                                'nested_type_name': ''}})
