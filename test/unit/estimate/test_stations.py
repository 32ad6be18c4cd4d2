"""Sequential multilateration as logs: stations and dead paths unknown, in one joint estimate with everything else."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import of_ways
from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import evaluate, solution_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.methods import run_method
from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.planned import observe, planned_table
from stepdiag_ros.estimate.readings import readings_of_stops
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

from .test_of_ways import ALL, X, Y, Z, off

CELL = """
schema: 1
seed: 22
machine: {name: stations, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 3, order: XYZ, repeats: 1}
setups:
SETUPS
noise: {displacement: 0.0, spot: 0.0, position_repeatability: 0.0, angle_repeatability: 0.0}
misalignments: {drawn: {laser: 0.0, mirror: 2.0e-4, psd_zero: 0.0, station: 2.0e-3}, given: {GIVEN}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.05, mount: 2.0}
sampling: {interferometer: 100.0, psd: 100.0, block: 0.05}
"""
SPACE = f'from: [0, 0, 0], to: [{X}, {Y}, {Z}], moves: grid'
PLANE = f'from: [0, 0, 0], to: [{X}, {Y}, 0], moves: grid'
AROUND = ((-0.15, -0.12, -0.10), (0.42, -0.10, -0.05), (0.38, 0.35, -0.15), (-0.12, 0.30, 0.25))
TOOLS = ((0.0, 0.0, -0.12), (0.05, 0.0, -0.12), (0.0, 0.05, -0.12), (-0.04, -0.04, -0.20))
FOUR = {f's{k}': f'{SPACE}, station: {list(place)}, tool: {list(tool)}'
        for k, (place, tool) in enumerate(zip(AROUND, TOOLS, strict=True))}
ONE_TOOL = {f's{k}': f'{SPACE}, station: {list(place)}' for k, place in enumerate(AROUND)}
THREE = {f's{k}': f'{PLANE}, station: [{x}, {y}, 0], tool: [0, 0, 0]' for k, (x, y) in enumerate(
    ((-0.15, -0.12), (0.42, -0.10), (0.10, 0.38)))}
IN_PLANE = {'EXX', 'EYX', 'ECX', 'EXY', 'EYY', 'EC0Y'}
EDGES = {'edge_x': f'from: [0, 0, 0], to: [{X}, 0, 0]', 'edge_y': f'from: [0, 0, 0], to: [0, {Y}, 0]',
         'edge_z': f'from: [0, 0, 0], to: [0, 0, {Z}]'}


def cell_of(setups):
    def line(name, body):
        mirror = '' if 'station' in body else 'standoff: 0.2, psd_offset: [0.02, 0.0]' + (', ' if body else '')
        return f'  {name}: {{{mirror}{body}}}'
    # Where all lies in one plane the stations do too.
    level = ', '.join(f'{name}: {{station: [{0.002 * k - 0.001}, 0.0015, 0.0]}}' for k, name in enumerate(setups)
                      if 'tool: [0, 0, 0]' in setups[name])
    return parse_cell(CELL.replace('SETUPS', '\n'.join(line(n, b) for n, b in setups.items())).replace('GIVEN', level))


def believed(log):
    return replace(log, description=replace(log.description, noise=Noise()))


STEPS = dict.fromkeys(('ppp', 'npp', 'pnp', 'nnp'), '')
OPEN = {'ECY', 'EAZ', 'EBZ', 'ECZ', 'EXZ', 'EYZ', 'EB0Z', 'EA0Z'}
PLANS = {'three stations in the plane': (THREE, IN_PLANE),
         'four stations in space, a tool each': (FOUR, ALL),
         'four stations in space, one tool': (ONE_TOOL, ALL - OPEN),
         'three stations, step diagonals and lines': (THREE | STEPS | EDGES, ALL)}


@pytest.fixture(scope='module', params=PLANS)
def plan(request):
    """A plan's cell, its noise-free log, and what it shows.

    The machine has no errors but those, and is described in its reference lines: motions out of a plane change the
    lengths to second order (0.3 nm), and squareness in a frame that is turned by 20 µrad differs by that times the
    difference of the axes' scale errors (1 nrad); no reading tells either apart."""
    setups, shown = PLANS[request.param]
    cell = cell_of(setups)
    lines = to_reference_lines(cell.geometry)
    curves, square = ({name: value for name, value in part.items() if name in shown}
                      for part in (lines.curves, lines.square))
    cell = replace(cell, geometry=GeometricErrors(curves, square))
    return cell, simulate_log(cell), shown


def off_from(solution, cell, shown):
    return {name: value for name, value in off(solution, filled_up(cell.geometry)).items() if name in shown}


def filled_up(errors):
    nothing = Curve(np.array([0.0, 1.0]), np.zeros(2))
    return GeometricErrors(dict.fromkeys(CURVES, nothing) | dict(errors.curves),
                           dict.fromkeys(SQUARENESS, 0.0) | dict(errors.square))


def test_errors_stations_and_dead_paths_come_back(plan):
    cell, log, shown = plan
    solution = evaluate(believed(log))
    assert solution.status == 'ok', solution.status
    named = {name.split()[0] for entry in solution.unidentifiable for name in entry.names}
    assert ALL - named == shown
    table = in_metres(log).table
    # From the estimate of the usual noise: with weights of 10 pm heights above a plane are a narrow, bent valley.
    near = fit(believed(log).description, table, linear_laser=1e-7, settled=1e-14)
    free = solution_of(fit(log.description, table, linear_laser=1e-7, theta=near.theta), table)
    found = off_from(free, cell, shown)
    assert max(found.values()) < 1e-9, found
    for name, place in free.extra['stations'].items():
        true = np.add(log.description.setups[name].station, cell.misalignments[name].station)
        np.testing.assert_allclose(place['position_m'], true, atol=2e-5)
        start = np.add(log.description.setups[name].tool_of(cell.description.machine), 0.0)
        assert place['dead_path_m'] == pytest.approx(float(np.linalg.norm(start - true)), abs=2e-5)


@pytest.mark.parametrize('steps', some(2, 4, later=[5]))
def test_ways_that_go_otherwise_than_the_plan_have_knots_of_their_own(steps):
    """No stop lies at the plan's thirds of the axes: with knots there every error was open, at status ok."""
    cell = cell_of({name: f'{body}, steps: {steps}' for name, body in FOUR.items()})
    solution = evaluate(believed(simulate_log(cell)))
    assert solution.status == 'ok'
    assert not {name.split()[0] for entry in solution.unidentifiable for name in entry.names} & ALL
    place, value, sigma = solution.curve('EXX')
    np.testing.assert_allclose(place, np.linspace(0.0, X, steps + 1), atol=1e-12)
    true = cell.geometry.curves['EXX']
    assert np.abs(value - true(place)).max() < 2e-7 and sigma.max() < 2e-5
    plain = evaluate(believed(simulate_log(cell_of(FOUR | {name: f'{body}, steps: 6' for name, body in FOUR.items()}))))
    assert len(plain.curve('EXX')[0]) == 4    # the plan's own, where they are gone by


def test_the_arrays_of_the_literature_agree_with_the_joint_estimate(plan):
    """A second way to the same errors: distances on arrays, kinematics to first order, another solver."""
    cell, log, shown = plan
    readings = readings_of_stops(log.description, in_metres(log).table)
    if set(log.description.setups) & {'ppp'}:
        assert of_ways.stations_lack(readings) is None
        return
    found = off_from(of_ways.multilaterated(readings), cell, shown)
    assert set(found) == shown and max(v for n, v in found.items() if n in CURVES and n[1] in 'XYZ') < 1e-9, found
    assert max(found.values()) < 1e-8, found


def test_multilateration_takes_one_grid_out_of_a_mixed_log():
    """A rectangle or another grid has positions that a single station saw: with them nothing would settle."""
    other = f'from: [0, 0, 0], to: [{X}, {Y}, {Z}], moves: grid, steps: 2, station: [-0.3, 0.0, 0.0]'
    mixed = {**FOUR, 'round': f'{PLANE.replace("grid", "around")}, station: [-0.15, -0.12, -0.12]', 'coarse': other}

    def found(setups):
        log = simulate_log(cell_of(setups))
        return of_ways.multilaterated(readings_of_stops(log.description, in_metres(log).table))
    assert np.array_equal(found(mixed).value, found(FOUR).value)
    log = simulate_log(cell_of({name: mixed[name] for name in ('s0', 's1', 's2', 'round', 'coarse')}))
    lacking = of_ways.stations_lack(readings_of_stops(log.description, in_metres(log).table))
    assert lacking and 'same grid' in lacking


def test_an_iteration_without_an_end_gives_no_numbers(monkeypatch):
    monkeypatch.setattr('stepdiag_ros.estimate.multilateration.MAX_ITERATIONS', 1)
    log = simulate_log(cell_of(THREE))
    with pytest.raises(StepdiagError, match='came to no end'):
        of_ways.multilaterated(readings_of_stops(log.description, in_metres(log).table))


def test_the_forward_model_is_the_sensors_closed_form_and_its_derivatives_are_right():
    cell = cell_of(FOUR | EDGES)
    description, geometry = cell.description, cell.geometry
    table = planned_table(description)
    parameters = parameters_of(description, table)
    model = ForwardModel(description, table, parameters)
    theta = np.random.default_rng(0).normal(size=parameters.size) * 1e-4
    readings, jacobian, _ = model.jacobian(theta)
    np.testing.assert_array_equal(readings, model.predict(theta))
    for column in range(0, parameters.size, 7):
        step = 1e-6 * np.eye(parameters.size)[column]
        by = (model.predict(theta + step) - model.predict(theta - step)) / 2e-6
        np.testing.assert_allclose(jacobian[:, [column]].toarray().ravel(), by.ravel(), atol=1e-8)
    # The virtual instrument, the closed form and the estimator's prediction are three pieces of code.
    log = simulate_log(cell)
    seen = in_metres(log).table
    closed = observe(description, seen, geometry, cell.misalignments)
    np.testing.assert_allclose(seen.displacement[:, 0], closed[:, 0], atol=1e-12)


def test_two_lines_and_a_rectangle_by_the_regulated_beams_own_problem_and_by_the_joint_estimate():
    cell = cell_of({'xy': f'from: [0, 0, 0], to: [{X}, {Y}, 0], moves: around, station: [-0.15, -0.12, -0.12]'} | EDGES)
    lines = to_reference_lines(cell.geometry)
    flat = GeometricErrors({n: c for n, c in lines.curves.items() if n in IN_PLANE}, {'EC0Y': lines.square['EC0Y']})
    level = {**cell.misalignments, 'xy': Misalignment(station=(1e-3, -2e-3, 0.0))}
    cell = replace(cell, geometry=flat, misalignments=level)
    log = simulate_log(cell)
    solution = run_method('regulated_beam', believed(log))
    found = off_from(solution, cell, IN_PLANE)
    assert set(found) == IN_PLANE and not solution.unidentifiable
    # The mirrors of the lines hang askew by 0.2 mrad: 0.3 nm, which the angles magnify.
    lengths = [value for name, value in found.items() if name in CURVES and name[1] in 'XYZ']
    assert max(lengths) < 2e-9 and max(found.values()) < 1e-7, found
    joint = evaluate(believed(log))
    named = {name.split()[0] for entry in joint.unidentifiable for name in entry.names}
    seen = {'EXX', 'EYY'} - named
    assert seen == {'EXX', 'EYY'} and max(off_from(joint, cell, seen).values()) < 3e-8
    with pytest.raises(StepdiagError, match='around a rectangle'):
        run_method('regulated_beam', believed(simulate_log(cell_of(EDGES))))


def test_parts_say_what_a_station_brought_and_what_stays_open():
    log = believed(simulate_log(cell_of({name: FOUR[name] for name in ('s0', 's1')} | EDGES)))
    solution = evaluate(log)
    parts = {part.kind: part for part in solution.parts}
    assert set(parts) == {'multilateration', 'line'} and parts['multilateration'].setups == ('s0', 's1')
    assert parts['multilateration'].narrowed or parts['multilateration'].settled
    assert solution.unidentifiable     # two stations are too few
    document = solution.to_json_dict()
    assert set(document['stations']) == {'s0', 's1'} and set(document['misalignments']) == set(EDGES)


def test_written_and_read_again_it_is_the_same_log_and_the_same_errors(tmp_path):
    log = simulate_log(cell_of(THREE | EDGES))
    write_log(log, tmp_path / 'bag')
    again = read_log(tmp_path / 'bag')
    assert again.description == log.description and not again.warnings
    one, other = (evaluate(believed(each)) for each in (log, again))
    assert np.array_equal(one.value, other.value) and np.array_equal(one.covariance, other.covariance)


def test_noise_is_covered():
    """Stations two millimetres from where they are said to stand, the usual noise: errors within their uncertainty."""
    cell = cell_of(FOUR)
    cell = replace(cell, description=replace(cell.description, noise=Noise()))
    solution = evaluate(simulate_log(cell))
    assert solution.status == 'ok', solution.status
    found = off(solution, cell.geometry)
    for name in ALL:
        sigma = solution.squareness(name)[1] if name in SQUARENESS else solution.curve(name)[2].max()
        assert found[name] < 4.0 * sigma, name


@pytest.mark.parametrize(('factor', 'name'), [(-1.0, 'sign'), (1e3, 'unit'), (1e-9, 'still')])
def test_a_mistake_of_commissioning_is_named(factor, name):
    log = simulate_log(cell_of(FOUR))
    table = in_metres(log).table
    assert not check_readings(log.description, table)
    found = check_readings(log.description, replace(table, displacement=factor * table.displacement))
    assert [one.name for one in found] == [name]
    swapped = dict(log.description.setups)
    swapped['s0'], swapped['s2'] = (replace(swapped[name], station=swapped[other].station)
                                    for name, other in (('s0', 's2'), ('s2', 's0')))
    found = check_readings(replace(log.description, setups=swapped), table)
    assert {one.name for one in found} <= {'direction', 'sign'} and found


@pytest.mark.parametrize(('body', 'words'), [
    (f'{SPACE}, station: [0.07, 0.06, 0.0]', ['station', '20 mm']),
    (f'{SPACE}, station: [0.1, 0.08]', ['station', '3']),
    (f'{SPACE}, station: [-0.2, 0, 0], beams: [[0, 0], [0.01, 0]]', ['beams', '2 beams']),
    (f'from: [0, 0, 0], to: [{X}, 0, 0], tool: [0, 0, 0]', ['tool', 'station']),
    (f'{SPACE}, steps: 9, station: [-0.2, 0, 0]', ['moves', '1000 stops']),
    (f'from: [0, 0, 0], to: [{X}, {Y}, {Z}], moves: around, station: [-0.2, 0, 0]', ['moves', 'two axes'])])
def test_what_cannot_be_measured_is_refused_with_its_key(body, words):
    with pytest.raises(StepdiagError) as caught:
        cell_of({'own': body})
    assert '\n' not in str(caught.value) and all(word in str(caught.value) for word in ('own', *words)), caught.value
