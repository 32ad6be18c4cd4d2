"""YAML with the line of every key, so that a complaint names file, line and key.

``yaml.safe_load`` forgets where a value stood.  :class:`Reader` walks the node tree
instead and converts on request; numbers are taken as Python writes them, so that
``5e-9`` is a number here although YAML 1.1 calls it a string.
"""

import math
from pathlib import Path
from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import read_text


def read_yaml(path: str | Path) -> 'Reader':
    """Parse a file into a :class:`Reader` of its top mapping."""
    return parse_yaml(read_text(path, limits.YAML_BYTES, 'cell file'), str(path))


def parse_yaml(text: str, source: str) -> 'Reader':
    """Parse text; ``source`` names it in complaints."""
    node = strict_yaml.compose(text, source)
    if node is None:
        raise StepdiagError(f'{source}: is empty; describe a cell as in cells/demo.yaml')
    return Reader(source, node, '')


class Reader:
    """One node of a YAML document: reads checked values, complains with file, line and key."""

    def __init__(self, source: str, node: yaml.Node, path: str):
        self.source, self.node, self.path = source, node, path

    def fail(self, what: str) -> StepdiagError:
        """The error to raise about this node."""
        key = f'{self.path}: ' if self.path else ''
        return StepdiagError(f'{self.source}:{self.node.start_mark.line + 1}: {key}{what}')

    def child(self, key: str, node: yaml.Node) -> 'Reader':
        return Reader(self.source, node, f'{self.path}.{key}' if self.path else key)

    def mapping(self, known: tuple[str, ...] | None = None) -> dict[str, 'Reader']:
        """Its keys and readers of their values; a key that is not in ``known`` is an error."""
        if not isinstance(self.node, yaml.MappingNode):
            raise self.fail('must be a mapping of keys to values')
        children = {}
        for key_node, value in self.node.value:
            key = str(key_node.value)
            child = self.child(key, value)
            if key in children:
                raise child.fail('is given twice; keep one')
            if known is not None and key not in known:
                raise Reader(self.source, key_node, child.path).fail(
                    f'is not a known key; known here are {", ".join(known)}')
            children[key] = child
        return children

    def items(self) -> list['Reader']:
        """Readers of a list's items."""
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.fail('must be a list')
        return [self.child(f'{i}', node) for i, node in enumerate(self.node.value)]

    @property
    def is_null(self) -> bool:
        return isinstance(self.node, yaml.ScalarNode) and self.node.tag.endswith(':null')

    def plain(self) -> Any:
        """The value as Python objects, numbers converted wherever they look like one."""
        if isinstance(self.node, yaml.MappingNode):
            return {key: child.plain() for key, child in self.mapping().items()}
        if isinstance(self.node, yaml.SequenceNode):
            return [child.plain() for child in self.items()]
        if self.is_null:
            return None
        if self.node.tag.endswith(':bool'):
            return self.boolean()
        if self.node.style is None:
            if len(self.node.value) > limits.INTEGER_DIGITS and self.node.tag.endswith(':int'):
                raise self.fail(f'is a whole number of {len(self.node.value)} digits; give at most '
                                f'{limits.INTEGER_DIGITS}')
            for convert in (int, float):
                try:
                    return convert(self.node.value)
                except ValueError:
                    pass
        return self.node.value

    def text(self, choices: tuple[str, ...] | None = None) -> str:
        if not isinstance(self.node, yaml.ScalarNode) or self.is_null:
            raise self.fail('must be a text')
        value = str(self.node.value)
        if choices is not None and value not in choices:
            raise self.fail(f'is {value!r}; choose from {", ".join(choices)}')
        return value

    def boolean(self) -> bool:
        value = self.text().lower()
        if value not in ('true', 'false', 'yes', 'no', 'on', 'off'):
            raise self.fail(f'is {value!r}; write true or false')
        return value in ('true', 'yes', 'on')

    def number(self, minimum: float | None = None, above: float | None = None,
               maximum: float | None = None, unit: str = '') -> float:
        """A finite number; ``minimum`` may be reached, ``above`` may not; what is not bounded is by its unit."""
        if (most := limits.BY_UNIT.get(unit)) is not None:
            maximum = most if maximum is None else maximum
            minimum = -most if minimum is None and above is None else minimum
        given = self.node.value if isinstance(self.node, yaml.ScalarNode) else 'not a number'
        try:
            value = float(given)
        except ValueError:
            value = math.nan
        if abs(value) > limits.NUMBER:
            value = math.nan
        elif abs(value) < limits.SMALLEST:
            value = 0.0
        bounds = [f'of at least {minimum:g}' if minimum is not None else '',
                  f'above {above:g}' if above is not None else '',
                  f'of at most {maximum:g}' if maximum is not None else '']
        if not math.isfinite(value) or (minimum is not None and value < minimum) \
                or (above is not None and value <= above) \
                or (maximum is not None and value > maximum):
            wanted = ' and '.join(b for b in bounds if b)
            raise self.fail(f'is {given[:60]!r}; give a number{" " + wanted if wanted else ""}'
                            f'{f" [{unit}]" if unit else ""}')
        return value

    def count(self, minimum: int = 0, maximum: int | None = None) -> int:
        value = self.number(minimum=minimum, maximum=maximum)
        if value != int(value):
            raise self.fail(f'is {value:g}; give a whole number')
        return int(value)

    def vector(self, size: int, above: float | None = None, unit: str = 'm') -> tuple[float, ...]:
        items = self.items()
        if len(items) != size:
            raise self.fail(f'has {len(items)} items; give {size} numbers [{unit}]')
        return tuple(item.number(above=above, unit=unit) for item in items)
