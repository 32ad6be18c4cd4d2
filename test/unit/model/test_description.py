"""The cell description: what is read, kept and refused."""

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description

TEXT = """\
schema: 1
machine: {name: demo, chain: fxyz, volume: [0.8, 0.6, 0.5], tool: [0.0, 0.0, -0.15]}
plan: {steps: 10, order: XYZ, repeats: 2}
setups:
  ppp: {standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}
  lin_x: {standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]], length: 0.8, stops: 2}
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
"""


def test_round_trip():
    description = Description.from_yaml(TEXT)
    assert description.machine.chain == 'FXYZ'
    assert description.setups['lin_x'].is_linear
    assert Description.from_yaml(description.to_yaml()) == description


def test_the_place_of_the_volume_in_machine_coordinates_is_kept():
    assert Description.from_yaml(TEXT).machine.origin is None
    placed = TEXT.replace('chain: fxyz', 'chain: fxyz, origin: [-0.8, 0.0, -0.5]')
    description = Description.from_yaml(placed)
    assert description.machine.origin == (-0.8, 0.0, -0.5)
    assert Description.from_yaml(description.to_yaml()) == description
    with pytest.raises(StepdiagError, match='machine.origin'):
        Description.from_yaml(placed.replace('-0.8, 0.0, -0.5', '-0.8, 0.0'))


def test_what_the_owner_states_is_kept():
    assert not Description.from_yaml(TEXT).statement.to_dict()
    stated = TEXT + "test: {machine: 'Mill 5, no. 17', person: the operator, feed: 0.5}\n"
    description = Description.from_yaml(stated)
    assert description.statement.said['machine'] == 'Mill 5, no. 17' and description.statement.feed == 0.5
    assert Description.from_yaml(description.to_yaml()) == description
    for wrong in ('place: 3', f'place: {"x" * 201}', 'place: "a\\nb"', 'feed: fast'):
        with pytest.raises(StepdiagError, match=r'cell\.yaml: test\.(place|feed) '):
            Description.from_yaml(stated.replace('person: the operator', wrong).replace(
                ', feed: 0.5', '' if 'feed' in wrong else ', feed: 0.5'), 'cell.yaml')


def test_noise_may_be_left_out():
    short = TEXT[:TEXT.index('noise')]
    assert Description.from_yaml(short).noise.angle_repeatability == 2.0e-7


@pytest.mark.parametrize(('old', 'new', 'said'), [
    ('schema: 1', 'schema: 2', 'this version reads schema 1'),
    ('fxyz', 'XXYZ', "machine.chain is 'XXYZ'"),
    ('order: XYZ', 'order: XY', "plan.order is 'XY'"),
    ('steps: 10', 'steps: 0', 'plan.steps is 0'),
    ('steps: 10', 'steps: true', 'plan.steps is True'),
    ('0.8, 0.6, 0.5', '0.8, 0.6', 'machine.volume is'),
    ('0.8, 0.6, 0.5', '0.8, 0.6, 0', 'each must be above zero'),
    ('standoff: 0.35, psd_offset: [0.02, 0.0], beams: [[0.0, 0.0]]}', 'standoff: -1}', 'setups.ppp.standoff is -1'),
    ('ppp:', 'ppn:', "unknown setup 'ppn'"),
    ('beams: [[0.0, 0.0]]}', 'beams: []}', 'setups.ppp.beams must be a list'),
    ('stops: 2', 'stops: 1', 'setups.lin_x.stops is 1'),
    ('spot: 2.0e-7', 'spot: .nan', 'noise.spot is nan'),
    ('plan: {', 'plan: [', 'cell.yaml:3: is not valid YAML'),
])
def test_mistakes_name_the_key(old, new, said):
    with pytest.raises(StepdiagError) as caught:
        Description.from_yaml(TEXT.replace(old, new, 1), 'cell.yaml')
    assert said in str(caught.value)
    assert str(caught.value).startswith('cell.yaml:')
    assert '\n' not in str(caught.value)
