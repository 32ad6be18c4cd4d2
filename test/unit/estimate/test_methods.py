"""The registry and the comparison, on arrays and on a log by another maker."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.compare import compare, text_table, truth_of
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.methods import (
    METHODS,
    body_diagonal_test,
    corner_deviations,
    linear_test,
    run_all,
    run_method,
    squareness_test,
)
from stepdiag_ros.estimate.readings import readings_of_stops, simulate
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Description, Machine, Plan, Setup
from stepdiag_ros.model.machine import CURVES


@pytest.fixture(scope='module')
def field_log():
    """log_05 of the other maker: no effect, true errors known."""
    import os
    from pathlib import Path

    from stepdiag_ros.bag.reader import read_log
    place = Path(os.environ.get('STEPDIAG_SHARED', Path(__file__).parents[4] / 'shared'))
    bag = place / 'field_logs' / 'open' / 'log_05'
    if not bag.is_dir():
        pytest.skip(f'field log missing: no folder {bag} (set STEPDIAG_SHARED)')
    log = read_log(bag)
    truth = truth_of((bag.parent / 'truth.json').read_text(), log.description, 'log_05', 'truth.json')
    return log, truth


@pytest.fixture(scope='module')
def by_method(field_log):
    """What each method makes of the field log, and what those lack that cannot."""
    return run_all(field_log[0])


def test_corner_stops_of_a_zig_zag(machine, draw_errors, cell_sights):
    errors = draw_errors(machine, 6, angles=False)
    cell = simulate(machine, 6, cell_sights(machine, 6), errors)
    along, forward, backward = corner_deviations(cell.setups['npp'])
    assert len(along) == 7
    assert along[-1] == pytest.approx(np.linalg.norm(machine.volume))
    assert forward.shape == (1, 7)
    assert backward.shape == (0, 7)
    test = body_diagonal_test(cell)
    assert set(test.diagonals) == set(DIAGONALS)
    assert squareness_test(cell).has('EA0Z')
    assert linear_test(cell).axes == {}


def test_every_method_has_its_reasons(machine, draw_errors, cell_sights):
    whole = simulate(machine, 3, cell_sights(machine, 3), draw_errors(machine, 3))
    bare = simulate(machine, 3, cell_sights(machine, 3, ('ppp', 'npp')), draw_errors(machine, 3))
    # Those of which the four step diagonals hold nothing: other setups are wanted.
    never = {'face_diagonal', 'three_face', 'linear_lines', 'multilateration', 'regulated_beam', 'iso230_2',
             'body_displacement', 'face_displacement', 'face_diagonal_xy', 'face_diagonal_xz', 'face_diagonal_yz'}
    for name, method in METHODS.items():
        assert method.name == name
        assert method.title and method.source and method.needs
        assert (method.lacks(whole) is None) == (name not in never)
    assert METHODS['step_diagonal'].lacks(bare) == "3 body step diagonals in the plan's steps (has 2)"
    assert METHODS['new_formulation'].lacks(bare.without('npp')) == "4 body step diagonals in the plan's steps (has 1)"


def test_setups_are_found_by_their_ways_whatever_they_are_called(machine, draw_errors, cell_sights):
    """Corner to corner, spelled out in the cell file, is the diagonal of a short name; the same for edges."""
    short = simulate(machine, 3, cell_sights(machine, 3), draw_errors(machine, 3), sigma_m=1e-7)
    kinds = dict.fromkeys(DIAGONALS, 'body step diagonal') | dict.fromkeys(LINEAR, 'line')
    spelled = replace(short, setups={f'own_{name}': replace(setup, sight=replace(
        setup.sight, name=f'own_{name}', kind=kinds[name])) for name, setup in short.setups.items()})
    for name in ('enhanced_dahlem', 'step_diagonal', 'step_diagonal_no_slopes', 'new_formulation',
                 'squareness_diagonals'):
        assert METHODS[name].lacks(spelled) is None, name
        one, other = (METHODS[name].run(None, cell) for cell in (short, spelled))
        assert np.array_equal(one.value, other.value) and np.array_equal(one.covariance, other.covariance), name
        assert {f'own_{setup}' for setup in one.misalignments} == set(other.misalignments), name
    # Their ends alone, as diagonals in one motion have them, tell squareness and no more.
    straight = replace(spelled, setups={name: replace(
        setup, displacement_m=setup.displacement_m[::3], displacement_sigma_m=setup.displacement_sigma_m[::3],
        sight=replace(setup.sight, kind='body diagonal', positions=setup.sight.positions[::3],
                      axis=setup.sight.axis[::3]))
        for name, setup in spelled.setups.items() if name[4:] in DIAGONALS})
    assert np.array_equal(squareness_test(straight).value, squareness_test(short).value)
    assert METHODS['step_diagonal'].lacks(straight) == "3 body step diagonals in the plan's steps (has 0)"


def test_field_log_every_method(field_log, by_method):
    log, truth = field_log
    results, skipped = by_method
    assert set(results) | set(skipped) == set(METHODS)
    assert {'enhanced', 'enhanced_dahlem', 'step_diagonal', 'new_formulation', 'squareness_diagonals',
            'body_diagonal', 'iso230_2'} <= set(results)
    outcome = compare(results, truth, 'truth', log.description)
    # The closed form on somebody else's data: within the machine's repeatability and its own σ.
    for group, limit in (('positioning', 1e-6), ('straightness', 1e-6), ('angles', 1e-6),
                         ('squareness', 2e-6)):
        assert outcome.worst('enhanced_dahlem', group) < limit
    assert outcome.within_k2['enhanced_dahlem'] > 0.85
    # The earlier methods fail on the same log, as the literature says.
    assert outcome.worst('step_diagonal', 'positioning') > 5e-5
    assert outcome.worst('new_formulation', 'straightness') > 5e-6
    assert outcome.worst('step_diagonal', 'angles') is None
    for _, measured, true in outcome.figures['body_diagonal'][:4]:
        assert measured == pytest.approx(true, abs=1e-6)
    text = text_table(outcome)
    for name in (*results, 'EXX', 'EC0Y'):
        assert name in text


def test_evaluate_by_name(field_log):
    log, _ = field_log
    assert run_method('step_diagonal', log).method == 'step_diagonal'
    with pytest.raises(StepdiagError, match='not known; choose from enhanced'):
        run_method('magic', log)
    with pytest.raises(StepdiagError, match='method multilateration needs distances'):
        run_method('multilateration', log)


def test_figures_of_merit_read_well(by_method):
    results, _ = by_method
    text = results['body_diagonal'].text()
    assert all(name in text for name in (*DIAGONALS, 'worst', 'E [µm]'))
    text = results['iso230_2'].text()
    assert 'lin_z' in text
    assert len({len(line) for line in text.splitlines()[3:]}) == 1


def test_results_are_json(by_method):
    for name, result in by_method[0].items():
        data = json.loads(json.dumps(result.to_json_dict()))
        assert data['status'] == 'ok', name


def test_readings_join_the_runs(field_log):
    log, _ = field_log
    cell = readings_of_stops(log.description, reduce_log(log))
    setup = cell.setups['ppp']
    assert setup.displacement_m[0, 0] == 0.0
    assert len(setup.forward_m) == len(setup.backward_m) == 2
    # A backward run goes on where the forward one ended.
    assert setup.backward_m[0, -1] == setup.forward_m[0, -1]
    assert 0.0 < setup.displacement_sigma_m[0] < 2e-6


def test_a_setup_with_a_hole_is_left_out_and_named(field_log):
    log, _ = field_log
    table = reduce_log(log)
    ppp = table.setup == table.setup_names.index('ppp')
    gone = ppp & (table.index == 5)
    displacement = table.displacement.copy()
    displacement[gone] = np.nan
    cell = readings_of_stops(log.description, replace(table, displacement=displacement))
    assert 'ppp' not in cell.setups
    assert 'no run has a reading at stop 5' in cell.left_out['ppp']
    assert METHODS['step_diagonal'].lacks(cell) is None
    assert METHODS['new_formulation'].lacks(cell) == "4 body step diagonals in the plan's steps (has 3)"
    # One run without that stop is no harm.
    displacement = table.displacement.copy()
    displacement[gone & (table.run == table.run[ppp][0])] = np.nan
    whole = readings_of_stops(log.description, table).setups['ppp']
    cell = readings_of_stops(log.description, replace(table, displacement=displacement))
    assert np.abs(cell.setups['ppp'].displacement_m - whole.displacement_m).max() < 2e-6
    assert len(cell.setups['ppp'].forward_m) == len(whole.forward_m) - 1


@pytest.mark.parametrize('channel', ['displacement', 'spot'])
def test_a_run_that_saw_nothing_is_no_harm(field_log, channel):
    log, _ = field_log
    table = reduce_log(log)
    values = getattr(table, channel).copy()
    values[table.run == 0] = np.nan
    name = table.setup_names[table.setup[table.run == 0][0]]
    whole = readings_of_stops(log.description, table).setups[name]
    cell = readings_of_stops(log.description, replace(table, **{channel: values}))
    assert cell.left_out == {}
    assert np.abs(cell.setups[name].displacement_m - whole.displacement_m).max() < 3e-6
    assert np.isfinite(cell.setups[name].spot_m).all()
    assert np.isfinite(cell.setups[name].spot_sigma_m).all()
    # Nothing at all of a setup's spots: no tilts, and the method says so.
    values[np.array(table.setup_names, object)[table.setup] == name] = np.nan
    if channel == 'spot':
        cell = readings_of_stops(log.description, replace(table, spot=values))
        assert cell.setups[name].spot_m is None
        assert METHODS['enhanced_dahlem'].lacks(cell) == f'psd/spot or three beams in setup {name}'


def test_imported_positioning_test(shared, tmp_path):
    """A measured stage brought in as a bag: one run without resets, B as published."""
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.cli.main import main
    bag = tmp_path / 'stage'
    assert main(['import', str(shared / 'real_data' / 'stage_a_x.csv'), '--to', str(bag)]) == 0
    result = run_method('iso230_2', read_log(bag)).axes['lin_x']
    assert result.runs == 5
    assert result.B * 1e6 == pytest.approx(33.6, abs=0.05)


DESCRIPTION = Description(Machine('m', 'FXYZ', (0.8, 0.6, 0.5), (0, 0, 0)), Plan(2, 'XYZ', 1),
                          {'ppp': Setup('ppp', 0.3, (0, 0), ((0, 0),))})


def test_truth_in_both_forms():
    flat = {'geometry': {'EXX': [0.0, 1e-6, 2e-6], 'square': {'EC0Y': 1e-5}}}
    nested = {'errors': {'EXX': {'position_m': [0.0, 0.8], 'value': [0.0, 2e-6]}, 'EC0Y': {'value': 1e-5}}}
    for data in (flat, nested, {'some_log': flat}, {'some_log': nested}):
        truth = truth_of(json.dumps(data), DESCRIPTION, 'some_log', 'truth.json')
        assert truth.curves['EXX'](np.array([0.4]))[0] == pytest.approx(1e-6)
        assert truth.square == {'EC0Y': 1e-5}


@pytest.mark.parametrize(('text', 'complaint'), [
    ('{', 'line 1: not JSON'),
    ('{"other_log": {}}', 'neither "errors" nor "geometry" for log'),
    ('[1]', 'neither'),
    ('{"geometry": {"EXX": [0.0, 1.0]}}', 'EXX has 2 values, the plan 3'),
    ('{"geometry": 7}', '"errors" or "geometry" is no object'), ('{"errors": {"square": []}}', 'is no object'),
    ('{"errors": {"EXX": {"value": [0.0]}}}', 'EXX.position_m: .None. where finite numbers belong'),
    ('{"errors": {"EXX": {"position_m": [0.0], "value": [null]}}}', 'EXX: .*where finite numbers belong'),
    ('{"errors": {"EC0Y": null}}', 'EC0Y: .None. where'),
    ('{"errors": {"EC0Y": [1.0, 2.0]}}', 'EC0Y has 2 values; give one'),
    ('{"errors": {"EC0Y": ' + '9' * 5000 + '}}', 'not JSON'), ('[' * 100_000, 'not JSON'),
])
def test_bad_truth_is_named(text, complaint):
    with pytest.raises(StepdiagError, match=complaint):
        truth_of(text, DESCRIPTION, 'log', 'truth.json')


def test_the_reference_itself_deviates_by_nothing(machine, draw_errors, cell_sights):
    from stepdiag_ros.estimate.enhanced_dahlem import evaluate
    errors = draw_errors(machine, 2)
    found = evaluate(simulate(machine, 2, cell_sights(machine, 2), errors))
    assert isinstance(found, Solution)
    outcome = compare({'one': found}, found.errors, 'itself', DESCRIPTION)
    assert max(outcome.deviation['one'].values()) < 1e-18
    assert set(outcome.deviation['one']) >= set(CURVES)
    assert outcome.within_k2['one'] is None


@pytest.fixture(scope='module')
def line():
    """A line of six targets and five cycles in a log of steps, each run reset at its first stop, and its machine."""
    import yaml

    from stepdiag_ros.virtual.cell import parse_cell
    from stepdiag_ros.virtual.offline import simulate_log

    from ..conftest import DEMO
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    text['plan']['repeats'] = 5
    text['setups'] = {name: body for name, body in text['setups'].items() if name.startswith('lin')}
    text['setups']['lin_x'] |= {'stops': 6, 'beams': [[0.0, 0.03]]}
    cells = [parse_cell(yaml.safe_dump(text | {'seed': seed}, sort_keys=False), str(DEMO)) for seed in range(20, 26)]
    return [(cell, simulate_log(cell)) for cell in cells]


def test_the_scatter_of_a_logs_cycles_is_that_of_its_arrivals(line):
    """Declared are 0.3 µm an arrival; runs counted each from its own first stop show 40 % more."""
    tests = [linear_test(readings_of_stops(log.description, reduce_log(log))).axes['lin_x'] for _, log in line]
    s = np.sqrt(np.mean([np.concatenate([t.s_up, t.s_down])**2 for t in tests]))
    assert s == pytest.approx(3e-7, rel=0.12)


def test_the_truth_of_a_line_has_its_rotations(line):
    """A beam 30 mm beside the line sees the pitch: the known machine's figure is what a perfect log shows."""
    levers = []
    for cell, log in line[:3]:
        measured = run_method('iso230_2', log)
        rows = {name: (found, true) for name, found, true in compare(
            {'iso230_2': measured}, cell.geometry, 'truth', log.description).figures['iso230_2']}
        found, true = rows['E lin_x']
        curve = to_reference_lines(cell.geometry).curves['EXX']
        assert abs(found - true) < 5e-7 + 2.0 * measured.sigma_m['B lin_x']
        levers.append(abs(true - np.ptp(curve(measured.axes['lin_x'].target_m))))
    assert max(levers) > 1e-6


def test_few_targets_and_cycles_are_remarked(by_method):
    results, _ = by_method
    remarks = results['iso230_2'].to_json_dict()['remarks']
    assert any('ISO 230-2 wants at least 5' in text for text in remarks)
    assert any('2 cycles; ISO 230-2 wants 5' in text for text in remarks)
    assert any('2 cycles; ISO 230-6 wants 5' in text for text in results['body_diagonal'].remarks)


def test_no_figure_rests_on_the_scatter_of_two_stops_alone(line):
    """Two cycles over two stops scatter little by chance; what all repeats of the log say is the least."""
    for _, log in line[:2]:
        keep = log.steps.repeat < 2
        columns = ('time_ns', 'run', 'setup', 'repeat', 'direction', 'index', 'axis', 'commanded', 'phase')
        steps = replace(log.steps, **{name: getattr(log.steps, name)[keep] for name in columns})
        sigma = run_method('iso230_2', replace(log, steps=steps)).sigma_m
        # A difference of two means of two arrivals each.
        assert min(sigma[f'B lin_{axis}'] for axis in 'xyz') > 0.8 * 3e-7
