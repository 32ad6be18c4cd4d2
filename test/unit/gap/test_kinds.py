"""The diagnosis on logs of each kind of setup: nothing is found where nothing is, a creeping servo where it creeps."""

import pytest

from stepdiag_ros.effects import all_effects
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

CELL = """
schema: 1
seed: 22
machine: {name: kinds, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 3, order: XYZ, repeats: 2}
setups:
SETUPS
noise: {displacement: 5.0e-9, spot: 2.0e-7, position_repeatability: 3.0e-7, angle_repeatability: 2.0e-7}
misalignments: {drawn: {laser: 0.0, mirror: 2.0e-4, psd_zero: 0.0, station: 2.0e-3}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.2, mount: 2.0}
sampling: {interferometer: 500.0, psd: 500.0, block: 0.05}
effects: {EFFECTS}
"""
EDGES = ['edge_x: {standoff: 0.2, MOREfrom: [0, 0, 0], to: [0.2, 0, 0]}',
         'edge_y: {standoff: 0.2, MOREfrom: [0, 0, 0], to: [0, 0.16, 0]}',
         'edge_z: {standoff: 0.2, MOREfrom: [0, 0, 0], to: [0, 0, 0.12]}']
BODY = [f'{name}: {{standoff: 0.2, psd_offset: [0.02, 0.0]MORE}}' for name in ('ppp', 'npp', 'pnp', 'nnp')]
SEEN = 'psd_offset: [0.02, 0.0]'
GRID = 'from: [0, 0, 0], to: [0.2, 0.16, 0], moves: grid, tool: [0, 0, 0]'
SPACE = 'from: [0, 0, 0], to: [0.2, 0.16, 0.12], moves: grid, tool: [0, 0, 0]'
FACES = [f'{name}: {{standoff: 0.2, {SEEN}, from: {start}, to: {end}, moves: {moves}}}' for name, start, end, moves in (
    ('xy_p', [0, 0, 0], [0.2, 0.16, 0], 'XY'), ('xy_n', [0.2, 0, 0], [0, 0.16, 0], 'XY'),
    ('xz_p', [0, 0, 0], [0.2, 0, 0.12], 'XZ'), ('xz_n', [0.2, 0, 0], [0, 0, 0.12], 'XZ'),
    ('yz_p', [0, 0, 0], [0, 0.16, 0.12], 'YZ'), ('yz_n', [0, 0.16, 0], [0, 0, 0.12], 'YZ'))]
KINDS = {
    'overrun': [one.replace('MORE', 'overrun: 0.0005, ') for one in EDGES] + [one.replace('MORE', '') for one in BODY],
    'no detector': [one.replace('MORE', '') for one in EDGES]
    + [one.replace('MORE', ', psd: false') for one in BODY],
    'stations': [f's{k}: {{{GRID}, station: {place}}}' for k, place in enumerate(
        ([-0.15, -0.12, 0], [0.42, -0.1, 0], [0.1, 0.38, 0]))],
    'rectangle': ['s0: {station: [-0.15, -0.12, -0.12], from: [0, 0, 0], to: [0.2, 0.16, 0], moves: around}']
    + [one.replace('MORE', '') for one in EDGES],
    'regulated': ['s0: {station: [-0.15, -0.12, -0.12], from: [0, 0, 0], to: [0.2, 0.16, 0], moves: around, '
                  'regulated: true, feed: 0.015}'] + [one.replace('MORE', '') for one in EDGES],
    'diagonals in one motion': [
        f'{name}: {{standoff: 0.2, {SEEN}, from: {start}, to: {end}}}' for name, start, end in (
            ('b1', [0, 0, 0], [0.2, 0.16, 0.12]), ('b2', [0.2, 0, 0], [0, 0.16, 0.12]),
            ('b3', [0, 0.16, 0], [0.2, 0, 0.12]), ('f1', [0, 0, 0], [0.2, 0.16, 0]),
            ('f2', [0.2, 0, 0], [0, 0.16, 0]))],
    'three faces': FACES[::2] + [one.replace('MORE', '') for one in EDGES],
    'face step diagonals': FACES + [one.replace('MORE', '') for one in EDGES],
    'stations in space': [f's{k}: {{{SPACE}, station: {place}}}' for k, place in enumerate(
        ([-0.15, -0.12, -0.1], [0.42, -0.1, -0.05], [0.1, 0.38, -0.1], [0.1, 0.08, 0.5]))],
    'parallel lines': [EDGES[0].replace('MORE', 'psd: false, '),
                       'line_2: {standoff: 0.2, psd: false, from: [0, 0.16, 0], to: [0.2, 0.16, 0]}',
                       'line_3: {standoff: 0.2, psd: false, from: [0, 0, 0.12], to: [0.2, 0, 0.12]}']}
KINDS['a mixture'] = [*KINDS['three faces'], *KINDS['stations'], KINDS['diagonals in one motion'][0],
                      BODY[0].replace('MORE', '')]


def diagnosed(kind, effects):
    text = CELL.replace('SETUPS', '\n'.join(f'  {one}' for one in KINDS[kind])).replace('EFFECTS', effects)
    return diagnose(simulate_log(parse_cell(text)), [effect() for effect in all_effects().values()]).to_json_dict()


@pytest.mark.parametrize('kind', some('a mixture', 'no detector', 'overrun', later=KINDS))
def test_nothing_is_found_where_nothing_is(kind):
    found = diagnosed(kind, '')
    assert found['verdict'] == 'no_gap' and not found['effects']


@pytest.mark.parametrize('kind', some('regulated', later=[
    'face step diagonals', 'overrun', 'no detector', 'stations', 'rectangle', 'parallel lines']))
def test_a_creeping_servo_is_found(kind):
    found = diagnosed(kind, 'servo_settling: {amp: 5.0e-7, tau: 0.15}')
    assert [effect['name'] for effect in found['effects']] == ['servo_settling'], found['effects']
    assert found['verdict'] == 'explained' and found['effects'][0]['probability'] > 0.95


@pytest.mark.parametrize('kind', ['three faces'])
def test_a_creeping_servo_is_named_where_it_does_not_close_the_gap(kind):
    """Half a micrometre in repeats of 0.3 µm: named for sure, while most of the gap is what repeats cannot tell."""
    found = diagnosed(kind, 'servo_settling: {amp: 5.0e-7, tau: 0.15}')
    assert [effect['name'] for effect in found['effects']] == ['servo_settling'], found['effects']
    assert found['effects'][0]['probability'] > 0.95
