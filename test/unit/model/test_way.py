"""Ways of setups without a short name: stops, what is refused, and the contract's YAML."""

import numpy as np
import pytest
import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import NONE
from stepdiag_ros.model.path import setup_direction, start_corner, stops
from stepdiag_ros.model.way import TOGETHER, Way, problem

VOLUME = (0.4, 0.2, 0.1)
TEXT = """
schema: 1
machine: {name: m, chain: FXYZ, volume: [0.4, 0.2, 0.1], tool: [0.0, 0.0, -0.1]}
plan: {steps: 4, order: XYZ, repeats: 2}
setups:
  ppp: {standoff: 0.2}
  body: {standoff: 0.2, from: [0.4, 0, 0], to: [0, 0.2, 0.1], steps: 5, repeats: 3}
  face: {standoff: 0.2, from: [0, 0, 0.1], to: [0.4, 0.2, 0.1], moves: YX}
  line: {standoff: 0.2, from: [0, 0.2, 0.1], to: [0.4, 0.2, 0.1]}
"""


def test_axes_together_stop_on_the_line():
    description = Description.from_yaml(TEXT)
    path, setup = stops(description, 'body'), description.setups['body']
    np.testing.assert_allclose(path.positions, np.linspace([0.4, 0.0, 0.0], [0.0, 0.2, 0.1], 6))
    assert np.array_equal(path.positions[-1], [0.0, 0.2, 0.1])
    assert path.axis.tolist() == [NONE] * 6 == path.moved(-1).tolist()
    np.testing.assert_allclose(setup_direction(description.machine, setup), np.array([-0.4, 0.2, 0.1]) / 0.21**0.5)
    assert np.array_equal(start_corner(description.machine, setup), [0.4, 0.0, 0.0])
    assert (setup.kind, setup.is_straight, setup.axes) == ('body diagonal', True, (0, 1, 2))
    assert description.repeats_of('body') == 3 and description.repeats_of('face') == 2


def test_axes_in_turn_zigzag_in_the_order_asked_for():
    description = Description.from_yaml(TEXT)
    path, setup = stops(description, 'face'), description.setups['face']
    assert path.axis.tolist() == [NONE, *[1, 0] * 4] and len(path) == 9
    assert np.array_equal(path.positions[:3], [[0.0, 0.0, 0.1], [0.0, 0.05, 0.1], [0.1, 0.05, 0.1]])
    assert path.moved(-1).tolist() == [NONE, *[0, 1] * 4]
    assert (setup.kind, setup.is_straight) == ('face step diagonal', False)
    line = description.setups['line']
    assert (line.kind, line.is_line, line.is_straight) == ('line', True, True)
    assert stops(description, 'line').axis.tolist() == [NONE, 0, 0, 0, 0]


def test_the_contracts_yaml_tells_the_same_ways_again():
    description = Description.from_yaml(TEXT)
    again = Description.from_yaml(description.to_yaml())
    assert again == description
    assert set(yaml.safe_load(description.to_yaml())['setups']['ppp']) == {'standoff', 'psd_offset', 'beams'}


@pytest.mark.parametrize(('way', 'key', 'words'), [
    (Way((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)), 'to', '(0.5, 0, 0)'),
    (Way((-0.1, 0.0, 0.0), (0.4, 0.0, 0.0)), 'from', 'volume'),
    (Way((0.1, 0.0, 0.0), (0.1, 0.0, 0.0)), 'to', 'same'),
    (Way((0.0, 0.0, 0.0), (0.4, 0.2, 0.0), 'XZ'), 'moves', 'XY'),
    (Way((0.0, 0.0, 0.0), (0.4, 0.2, 0.0), 'XYX'), 'moves', TOGETHER)])
def test_what_the_machine_cannot_do_is_named(way, key, words):
    wrong = problem(way, VOLUME)
    assert wrong[0] == key and words in wrong[1]


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('  body:', '  body/2:', ['body/2', 'short names']),
    ('  line: {standoff: 0.2, from: [0, 0.2, 0.1]', '  line: {standoff: 0.2', ['setups.line.from', '3 numbers']),
    ('  ppp: {standoff: 0.2}', '  ppp: {from: [0, 0, 0], to: [0.4, 0, 0]}', ['setups.ppp', 'short name']),
    ('  ppp: {standoff: 0.2}', '  qqq: {standoff: 0.2}', ["'qqq'", 'from and to']),
    ('moves: YX', 'moves: ZX', ['setups.face.moves', "'ZX'"]),
    ('steps: 5', 'steps: 0', ['setups.body.steps', 'at least 1'])])
def test_a_complaint_names_the_setup_and_the_key(old, new, words):
    with pytest.raises(StepdiagError) as caught:
        Description.from_yaml(TEXT.replace(old, new), 'log')
    assert '\n' not in str(caught.value) and all(word in str(caught.value) for word in ('log', *words))
