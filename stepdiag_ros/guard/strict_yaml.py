"""YAML from strangers: :func:`load` and :func:`compose`.

No aliases (ten lines of them unfold to gigabytes), no deep nesting, no tags of other languages, no dates, no
integers beyond 64 bits, no control characters; what is left is what JSON could say too.
"""

from typing import Any

import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.show import UNFIT

_CORE = 'tag:yaml.org,2002:'
_TAGS = {f'{_CORE}{name}' for name in ('str', 'int', 'float', 'bool', 'null', 'map', 'seq')} | {'!', None}
#: libyaml's loader where PyYAML was built with it: ten times as fast.
_Base: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def _simple(base: Any) -> Any:
    """A loader class that takes dates and ``<<`` for texts and refuses integers beyond 64 bits."""
    class Loader(base):
        yaml_implicit_resolvers = {   # noqa: RUF012 - as in its base
            letter: [(tag, form) for tag, form in rules if tag not in (f'{_CORE}timestamp', f'{_CORE}merge')]
            for letter, rules in base.yaml_implicit_resolvers.items()}

        def integer(self, node: yaml.ScalarNode) -> int:
            if len(node.value) > limits.INTEGER_DIGITS:
                raise yaml.constructor.ConstructorError(
                    None, None, f'the number {node.value[:12]}… has {len(node.value)} digits', node.start_mark)
            return int(self.construct_yaml_int(node))

    Loader.add_constructor(f'{_CORE}int', Loader.integer)
    return Loader


_Fast, _Marked = _simple(_Base), _simple(yaml.SafeLoader)


def load(text: str, source: str) -> Any:
    """The document as Python's own types, ``None`` where it is empty; :class:`StepdiagError` names ``source``."""
    return _parsed(text, source, lambda: yaml.load(text, _Fast))


def compose(text: str, source: str) -> yaml.Node | None:
    """The document's node tree, which knows the line of every value; as :func:`load`."""
    return _parsed(text, source, lambda: yaml.compose(text, _Marked))


def _parsed(text: str, source: str, parse: Any) -> Any:
    try:
        _check(text, source)
        return parse()
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        at = f':{mark.line + 1}' if mark else ''
        said = ' '.join(str(getattr(error, 'problem', None) or error).split())
        raise StepdiagError(f'{source}{at}: is not valid YAML: {said[:200]}') from None
    except (ValueError, TypeError, OverflowError, LookupError) as error:   # a number or a key that Python does not take
        raise StepdiagError(f'{source}: is not valid YAML: {" ".join(str(error).split())[:200]}') from None


def _check(text: str, source: str) -> None:
    """Walk the events, which cost no memory, and refuse what :func:`load` shall not meet."""
    if len(text) > limits.YAML_BYTES:
        raise StepdiagError(f'{source}: has {len(text)} letters, YAML here has at most {limits.YAML_BYTES}')
    depth = values = 0
    for event in yaml.parse(text, _Base):
        def refuse(what: str, event: Any = event) -> StepdiagError:
            return StepdiagError(f'{source}:{event.start_mark.line + 1}: {what}')
        if isinstance(event, yaml.AliasEvent) or getattr(event, 'anchor', None) is not None:
            raise refuse('has an anchor or alias (& or *); write the value out')
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if not isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent):
            continue
        values += 1
        if values > limits.YAML_VALUES:
            raise refuse(f'holds more than {limits.YAML_VALUES} values')
        if event.tag not in _TAGS:
            raise refuse(f'has the tag {str(event.tag)[:60]!r}; tags are not read here')
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > limits.YAML_DEPTH:
                raise refuse(f'is nested more than {limits.YAML_DEPTH} deep')
        elif (found := UNFIT.search(event.value)) is not None:
            raise refuse(f'holds the control character {found[0]!r}; take it out')

