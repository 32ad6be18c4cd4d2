"""The shipped layouts name topics and fields that a live run and a bag have."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from stepdiag_ros.bag.schemas import DEFINITIONS, TOPICS
from stepdiag_ros.bag.shown import SHOWN

LAYOUTS = Path(__file__).resolve().parents[2] / 'layouts'
KNOWN = {f'/demo/{topic}': kind for topic, kind in (TOPICS | SHOWN).items()}
NUMBERS = {'float64', 'float32', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'int64', 'uint64', 'bool'}


def split(path: str, mark: str) -> tuple[str, str]:
    """Topic and the rest of a path, the longest topic that fits."""
    topic = max((t for t in KNOWN if path == t or path.startswith(t + mark)), key=len, default=None)
    assert topic, f'{path} is of no topic that is published'
    return topic, path[len(topic) + 1:]


def leaf(kind: str, fields: list[str]) -> str:
    """The type of a field of a message, by way of its parts."""
    for number, field in enumerate(fields):
        name, _, index = re.match(r'(\w+)(\[(\d+|:)\])?', field).groups()
        lines = [line.split() for line in DEFINITIONS[kind].splitlines() if '=' not in line]
        found = next((line[0] for line in lines if line[1] == name), None)
        assert found, f'{kind} has no field {name}'
        array = re.search(r'\[(\d*)\]$', found)
        assert bool(array) == (index is not None), f'{field}: {kind} has {found}'
        if array and array[1] and index != ':':
            assert int(index) < int(array[1])
        kind = found.partition('[')[0]
        if number + 1 < len(fields):
            package = kind if '/' in kind else f'{"std_msgs" if kind == "Header" else "stepdiag_msgs"}/{kind}'
            kind = package.replace('/', '/msg/')
    return kind


def test_plotjuggler_plots_numbers_that_there_are():
    root = ElementTree.parse(LAYOUTS / 'plotjuggler.xml').getroot()
    curves = [curve.get('name') for curve in root.iter('curve')]
    assert len(curves) > 10 and len(list(root.iter('Tab'))) == 3
    for curve in curves:
        topic, rest = split(curve, '/')
        assert leaf(KNOWN[topic], rest.split('/')) in NUMBERS, curve
    for splitter in root.iter('DockSplitter'):
        assert int(splitter.get('count')) == len(list(splitter)) == len(splitter.get('sizes').split(';'))


def paths(value) -> list[str]:
    if isinstance(value, dict):
        own = [value['value']] if 'timestampMethod' in value else []
        return own + [path for part in value.values() for path in paths(part)]
    return [path for part in value for path in paths(part)] if isinstance(value, list) else []


def panels(layout) -> list[str]:
    if isinstance(layout, str):
        return [layout]
    return [name for side in ('first', 'second') for name in panels(layout[side])]


def test_foxglove_plots_numbers_that_there_are():
    layout = json.loads((LAYOUTS / 'foxglove.json').read_text())
    found = paths(layout)
    assert len(found) > 15
    for path in found:
        topic, rest = split(path, '.')
        fields = re.sub(r'\{[^}]*\}', '', rest).split('.')
        assert leaf(KNOWN[topic], fields) in NUMBERS, path
    names = set(re.findall(r'name==\\"(\w+)\\"', json.dumps(layout)))
    from stepdiag_ros.model.machine import CURVES
    assert names == set(CURVES)
    config = layout['configById']
    shown = panels(layout['layout'])
    shown += [name for panel in config.values() for tab in panel.get('tabs', []) for name in panels(tab['layout'])]
    assert sorted(shown) == sorted(config)
    for panel in config.values():
        for topic in [*panel.get('topics', {}), *filter(None, [panel.get('topicPath')])]:
            assert topic in KNOWN
    assert config['3D!scene']['followTf'] == 'demo/base_link'


@pytest.mark.parametrize('name', ['foxglove.json', 'plotjuggler.xml'])
def test_another_machine_is_a_word_away(name):
    """As the page says: sed 's#/demo/#/left/#g; s#"demo/#"left/#g'."""
    text = (LAYOUTS / name).read_text().replace('/demo/', '/left/').replace('"demo/', '"left/')
    assert 'demo' not in re.sub(r'<!--.*?-->', '', text)
