"""Cell files: what they say, and complaints that name file, line and key."""

from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description
from stepdiag_ros.virtual.cell import load_cell, parse_cell

CELLS = Path(__file__).resolve().parents[3] / 'cells'
SMALL = """\
schema: 1
seed: 3
machine: {name: small, volume: [0.2, 0.16, 0.12], tool: [0, 0, -0.1]}
plan: {steps: 2, repeats: 1}
setups:
  ppp: {standoff: 0.2}
  lin_x: {standoff: 0.2, stops: 3}
motion:
  feed: 0.1
"""


# A hall is a file about cells, and read by others.
@pytest.mark.parametrize('path', sorted(p for p in CELLS.glob('*.yaml') if p.stem != 'hall'), ids=lambda p: p.stem)
def test_the_cells_that_come_with_the_program_load(path):
    cell = load_cell(path)
    text = cell.description.to_yaml()
    assert Description.from_yaml(text) == cell.description


def test_what_is_not_said_has_a_default():
    cell = parse_cell(SMALL)
    assert cell.description.machine.chain == 'FXYZ'
    assert cell.description.setups['lin_x'].length == 0.2
    assert cell.motion.feed == 0.1 and cell.motion.dwell > 0.0
    assert cell.effects == {}


def test_a_cell_is_the_same_machine_wherever_it_is_loaded():
    a, b = parse_cell(SMALL), parse_cell(SMALL, 'elsewhere')
    other = parse_cell(SMALL.replace('seed: 3', 'seed: 4'))
    for name, curve in a.geometry.curves.items():
        np.testing.assert_array_equal(curve.value, b.geometry.curves[name].value)
        assert curve.value[0] == 0.0
    assert a.geometry.square == b.geometry.square
    assert a.geometry.square != other.geometry.square


def test_drawn_sizes_are_kept():
    cell = parse_cell(SMALL + 'geometry: {drawn: {positioning: 1e-5, straightness: 0, angle: 3e-5}}\n')
    assert 5e-6 <= np.abs(cell.geometry.curves['EXX'].value).max() <= 1e-5
    assert 1.5e-5 <= np.abs(cell.geometry.curves['EAX'].value).max() <= 3e-5
    assert 'EYX' not in cell.geometry.curves


def test_given_curves_replace_drawn_ones():
    cell = parse_cell(SMALL + """\
geometry:
  curves: {EXX: {position: [0, 0.1, 0.2], value: [0, 1e-6, 5e-7]}}
  squareness: {EC0Y: 1.1e-5}
""")
    np.testing.assert_array_equal(cell.geometry.curves['EXX'].value, [0, 1e-6, 5e-7])
    assert set(cell.geometry.curves) == {'EXX'}
    assert dict(cell.geometry.square) == {'EC0Y': 1.1e-5}


def test_misalignments_given_and_drawn():
    cell = parse_cell(SMALL + """\
misalignments:
  drawn: {laser: 1e-4}
  given: {ppp: {mirror: [1e-4, -2e-4], psd_zero: [1e-3, 0]}}
""")
    assert cell.misalignments['ppp'].mirror == (1e-4, -2e-4)
    assert cell.psd_zero['ppp'] == (1e-3, 0.0)
    assert cell.misalignments['lin_x'].mirror == (0.0, 0.0)
    assert cell.misalignments['lin_x'].laser != cell.misalignments['ppp'].laser != (0.0, 0.0)


@pytest.mark.parametrize(('change', 'line', 'words'), [
    (('feed: 0.1', 'feed: fast'), 9, ['motion.feed', "'fast'", 'm/s']),
    (('feed: 0.1', 'feed: -0.1'), 9, ['motion.feed', 'above 0']),
    (('feed: 0.1', 'feed: .nan'), 9, ['motion.feed', 'number']),
    (('feed: 0.1', 'fed: 0.1'), 9, ['motion.fed', 'not a known key', 'feed']),
    (('steps: 2', 'steps: 2.5'), 4, ['plan.steps', 'whole number']),
    (('repeats: 1', 'repeats: 0'), 4, ['plan.repeats', 'at least 1']),
    (('volume: [0.2, 0.16, 0.12]', 'volume: [0.2, 0.16]'), 3, ['machine.volume', '2 items']),
    (('volume: [0.2, 0.16, 0.12]', 'volume: [0.2, -0.16, 1]'), 3, ['machine.volume.1', 'above 0']),
    (('  ppp:', '  ppq:'), 6, ['setups.ppq', 'short names', 'ppp', 'from']),
    (('stops: 3', 'stops: 1'), 7, ['setups.lin_x.stops', 'at least 2']),
    (('name: small', 'name: small, chain: FXXZ'), 3, ['machine.chain', 'FXXZ']),
    (('schema: 1', 'schema: 7'), 1, ['schema', 'must be 1']),
    (('plan: {steps: 2, repeats: 1}', ''), 1, ["'plan' is missing"]),
    (('feed: 0.1', 'feed: 0.1\n  feed: 0.2'), 10, ['motion.feed', 'twice']),
    (('feed: 0.1', 'feed: [0.1'), None, ['not valid YAML']),
])
def test_a_complaint_names_file_line_and_key(change, line, words):
    with pytest.raises(StepdiagError) as caught:
        parse_cell(SMALL.replace(*change), 'bad.yaml')
    message = str(caught.value)
    assert message.startswith('bad.yaml:') and '\n' not in message
    if line is not None:
        assert message.startswith(f'bad.yaml:{line}:')
    for word in words:
        assert word in message


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(StepdiagError, match=r'none\.yaml: cannot be read'):
        load_cell(tmp_path / 'none.yaml')
    (tmp_path / 'empty.yaml').write_text('# nothing\n')
    with pytest.raises(StepdiagError, match=r'empty\.yaml: is empty'):
        load_cell(tmp_path / 'empty.yaml')
