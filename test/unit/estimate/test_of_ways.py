"""Logs of setups with ways of their own: what the joint estimate and the older methods find, on noise-free cells."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate import face_diagonal, linear_lines, of_ways
from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import evaluate, solution_of
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.methods import diagonal_displacement, linear_test
from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.estimate.noise import arrivals
from stepdiag_ros.estimate.readings import readings_of_stops
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
schema: 1
seed: 20
machine: {name: ways, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 4, order: XYZ, repeats: 1}
setups:
SETUPS
noise: {displacement: 0.0, spot: 0.0, position_repeatability: 0.0, angle_repeatability: 0.0}
misalignments: {drawn: {laser: LASER, mirror: MIRROR, psd_zero: 0.0}, given: {GIVEN}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.05, mount: 2.0}
sampling: {interferometer: 100.0, psd: 100.0, block: 0.05}
"""
X, Y, Z = 0.2, 0.16, 0.12
LINES = {'x_1': ((0, 0, 0), (X, 0, 0)), 'y_1': ((0, 0, 0), (0, Y, 0)), 'z_1': ((0, 0, 0), (0, 0, Z))}
OFFSET = {'x_2': ((0, Y, 0), (X, Y, 0)), 'x_3': ((0, 0, Z), (X, 0, Z)), 'y_2': ((X, 0, 0), (X, Y, 0)),
          'y_3': ((0, 0, Z), (0, Y, Z)), 'z_2': ((X, 0, 0), (X, 0, Z)), 'z_3': ((0, Y, 0), (0, Y, Z))}
BODY = {f'body_{s}': ((X * (s[0] == 'n'), Y * (s[1] == 'n'), 0), (X * (s[0] == 'p'), Y * (s[1] == 'p'), Z))
        for s in ('ppp', 'npp', 'pnp', 'nnp')}
FACES = {'xy_p': ((0, 0, 0), (X, Y, 0), 'XY'), 'xz_p': ((0, 0, 0), (X, 0, Z), 'XZ'),
         'yz_p': ((0, 0, 0), (0, Y, Z), 'YZ'), 'xy_n': ((X, 0, 0), (0, Y, 0), 'XY'),
         'xz_n': ((X, 0, 0), (0, 0, Z), 'XZ'), 'yz_n': ((0, Y, 0), (0, 0, Z), 'YZ')}
STRAIGHT_FACES = {name: way[:2] for name, way in FACES.items()}
THREE = {name: FACES[name] for name in ('xy_p', 'xz_p', 'yz_p')}
UNSEEN = {name: (*way, 'psd: false') for name, way in THREE.items()}
SHORT = dict.fromkeys(('ppp', 'npp', 'pnp', 'nnp'), ())
ALL = {*CURVES, *SQUARENESS}
PITCH_YAW = {'EXX', 'EBX', 'ECX', 'EYY', 'EAY', 'ECY', 'EZZ', 'EAZ', 'EBZ'}
PLANS = {
    'body diagonals beside step diagonals and lines': (SHORT | LINES | BODY, ALL),
    'face diagonals in one motion and lines': (STRAIGHT_FACES | LINES, PITCH_YAW | {*SQUARENESS}),
    'face step diagonals and lines': (FACES | LINES, ALL),
    'three faces from one corner and lines': (THREE | LINES, ALL),
    'parallel lines': (LINES | OFFSET, PITCH_YAW),
    'body diagonals alone': (BODY, set()),
    'a mixture': (THREE | LINES | OFFSET | BODY, ALL)}


def cell_of(setups, laser='3.0e-4', mirror='2.0e-4'):
    """A noise-free cell whose beams lie along what moves straight, as an operator aligns them."""
    lines, straight = [], []
    for name, way in setups.items():
        body = 'standoff: 0.2, psd_offset: [0.02, 0.0]'
        if way:
            body += f', from: {list(way[0])}, to: {list(way[1])}' + (f', moves: {way[2]}' if len(way) > 2 else '')
            body = body if len(way) < 4 else body.replace('psd_offset: [0.02, 0.0]', way[3])
        if len(way) == 2:
            straight.append(f'{name}: {{laser: [0.0, 0.0]}}')
        lines.append(f'  {name}: {{{body}}}')
    text = CELL.replace('SETUPS', '\n'.join(lines)).replace('LASER', laser).replace('MIRROR', mirror)
    return parse_cell(text.replace('GIVEN', ', '.join(straight)))


def off(solution, errors):
    """Largest deviation [m, rad] of every error that a solution has, in the same reference lines."""
    truth, found = to_reference_lines(errors), {}
    for (name, knot), value in zip(solution.names, solution.value, strict=True):
        true = truth.square[name] if knot < 0 else float(truth.curves[name](solution.positions[name][knot:knot + 1])[0])
        found[name] = max(found.get(name, 0.0), abs(float(value) - true))
    return found


@pytest.mark.parametrize('plan', PLANS)
def test_what_a_log_can_show_comes_back_and_the_rest_is_named(plan):
    setups, shown = PLANS[plan]
    cell = cell_of(setups)
    log = simulate_log(cell)
    # As a log of the usual noise would be judged: what is open then is open.
    believed = evaluate(replace(log, description=replace(log.description, noise=Noise())))
    assert believed.status == 'ok', believed.status
    named = {name.split()[0] for entry in believed.unidentifiable for name in entry.names}
    assert ALL - named == shown
    # The same readings, weighed as the noise-free ones that they are.
    table = in_metres(log).table
    solution = solution_of(fit(log.description, table, linear_laser=1e-5), table)
    found = {name: value for name, value in off(solution, cell.geometry).items() if name in shown}
    assert all(value < 1e-9 for value in found.values()), found


def test_without_a_detector_three_faces_leave_open_what_turns_with_their_mirrors():
    """The rolls, and in XY, where the tool is no lever, straightness and squareness; all else within its U."""
    cell = cell_of(UNSEEN | LINES)
    log = simulate_log(cell)
    believed = evaluate(replace(log, description=replace(log.description, noise=Noise())))
    assert believed.status == 'ok', believed.status
    named = {name.split()[0] for entry in believed.unidentifiable for name in entry.names}
    assert named & ALL == {'EAX', 'EBY', 'ECZ', 'EYX', 'EXY', 'EC0Y'}
    found = off(believed, cell.geometry)
    for name in sorted(ALL - named):
        u = 2.0 * (believed.squareness(name)[1] if name in SQUARENESS else believed.curve(name)[2].max())
        assert found[name] < u, name
    table = in_metres(log).table
    solution = solution_of(fit(log.description, table, linear_laser=1e-5), table)
    found = off(solution, cell.geometry)
    assert max(found[name] for name in CURVES if name not in named) < 5e-9


def test_a_way_spelled_out_is_the_short_name_bit_by_bit():
    """Samples and errors of a cell do not depend on how its file names the ways."""
    short = {'ppp': (), 'nnp': (), 'x_1': LINES['x_1']}
    spelled = {'up': ((0, 0, 0), (X, Y, Z), 'XYZ'), 'down': ((X, Y, 0), (0, 0, Z), 'XYZ'), 'x_1': LINES['x_1']}
    logs = [simulate_log(cell_of(setups, '0.0', '0.0')) for setups in (short, spelled)]
    for one in ('displacement', 'spot'):
        first, second = (getattr(log, one) for log in logs)
        assert np.array_equal(first.values, second.values) and np.array_equal(first.time_ns, second.time_ns)
    assert np.array_equal(logs[0].steps.commanded, logs[1].steps.commanded)
    one, other = (evaluate(log) for log in logs)
    assert np.array_equal(one.value, other.value) and np.array_equal(one.covariance, other.covariance)


def test_axes_that_moved_together_have_arrived_anew_and_the_third_stands():
    table = in_metres(simulate_log(cell_of(STRAIGHT_FACES))).table
    first = table.run == table.run[0]
    assert table.setup_names[table.setup[0]] == 'xy_p'
    numbers = arrivals(table)[first]
    assert len(set(numbers[:, 0])) == len(set(numbers[:, 1])) == 5 and len(set(numbers[:, 2])) == 1


@pytest.mark.parametrize(('factor', 'name'), [(-1.0, 'sign'), (1e3, 'unit')])
def test_a_wrong_scale_along_a_straight_diagonal_is_noticed(factor, name):
    log = simulate_log(cell_of(BODY))
    table = in_metres(log).table
    assert not check_readings(log.description, table)
    found = check_readings(log.description, replace(table, displacement=factor * table.displacement))
    assert [one.name for one in found] == [name]


def test_closed_forms_agree_with_the_joint_estimate():
    """A second way to the same errors: formulas of the papers, for mirrors square to their beams."""
    cell = cell_of(FACES | LINES | OFFSET, '0.0', '0.0')
    log = simulate_log(cell)
    readings = readings_of_stops(log.description, in_metres(log).table)
    assert list(of_ways.faces(readings).setups) == list(FACES)
    three, lines = of_ways.three_faces(readings), linear_lines.evaluate(of_ways.parallel(readings))
    assert {*three.positions} == {*CURVES}
    for solution in (three, lines):
        found = off(solution, cell.geometry)
        assert max(v for n, v in found.items() if n in CURVES) < 1e-9, found
        assert max((v for n, v in found.items() if n in SQUARENESS), default=0.0) < 5e-9, found
    # Y and Z of this chain have no second arm.
    assert [*of_ways.parallel(readings)] == ['X'] and {*lines.positions} == {'EXX', 'EBX', 'ECX'}
    angles = replace(to_reference_lines(cell.geometry), square={})
    angles = replace(angles, curves={n: c for n, c in angles.curves.items() if n[1] in 'ABC'})
    plane = face_diagonal.evaluate(of_ways.faces(readings), 'xy', angles)
    found = off(plane, cell.geometry)
    assert max(found.values()) < 3e-9, found


def test_diagonals_and_lines_are_tested_by_the_standards_where_they_lie():
    cell = cell_of(BODY | OFFSET, '0.0', '0.0')
    log = simulate_log(cell)
    readings = readings_of_stops(log.description, in_metres(log).table)
    test = diagonal_displacement(readings, 'body_displacement', ('body diagonal',))
    assert [*test.diagonals] == [*BODY] and all(own.B < 1e-12 for own in test.diagonals.values())
    np.testing.assert_allclose(test.diagonals['body_npp'].position_m, np.linspace(0.0, (X**2 + Y**2 + Z**2)**0.5, 5))
    lines = linear_test(readings)
    assert [*lines.axes] == [*OFFSET] and [lines.letter(n) for n in lines.axes] == ['X', 'X', 'Y', 'Y', 'Z', 'Z']
    # An arm of Y lengthens X by the yaw times it: what line and edge differ by.
    yaw = cell.geometry.curves['ECX'](np.linspace(0.0, X, 5))
    edge = cell.geometry.curves['EXX'](np.linspace(0.0, X, 5)) - Z * cell.geometry.curves['EBX'](np.linspace(0.0, X, 5))
    np.testing.assert_allclose(lines.axes['x_2'].mean_up, edge - Y * yaw, atol=2e-9)


def test_what_is_missing_is_said():
    log = simulate_log(cell_of({'xy_p': FACES['xy_p']} | LINES))
    readings = readings_of_stops(log.description, in_metres(log).table)
    assert re.search('xz, yz', of_ways.three_faces_lack(readings))
    log = simulate_log(cell_of(THREE))
    readings = readings_of_stops(log.description, in_metres(log).table)
    assert re.search('EXX, EYY, EZZ', of_ways.three_faces_lack(readings))
