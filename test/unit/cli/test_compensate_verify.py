"""``stepdiag compensate`` and ``stepdiag verify`` as a user runs them, on logs of virtual machines."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.import_csv import import_csv
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.known import known_errors
from stepdiag_ros.cli.main import main
from stepdiag_ros.cli.verify import apart_words
from stepdiag_ros.compensate.applied import taken_off
from stepdiag_ros.compensate.compensation import compensation
from stepdiag_ros.compensate.control import Place
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.taken import left_of
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.estimate.methods import run_method
from stepdiag_ros.estimate.prediction import deviation
from stepdiag_ros.estimate.traceability import Traceability
from stepdiag_ros.report.compensation_words import summary
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

from ..compensated import compensated_log
from ..conftest import DEMO

ORIGIN = [-0.5, 0.1, -0.3]
pytestmark = pytest.mark.usefixtures('diagnosed_once')

SUFFIXES = ('.comp', '.ini', '.COM', '.csv')


def cell_of(effects: dict | None = None, seed: int = 20, tool: list | None = None, without: str = '#',
            origin: list | None = ORIGIN, compensated: bool = True, errors=None) -> Cell:
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['seed'] = seed
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    text['motion'] |= {'dwell': 0.1}
    text['air'] |= {} if compensated else {'compensated': False, 'sensors': []}
    text['effects'] = effects or {}
    if origin is not None:
        text['machine']['origin'] = origin
    if tool is not None:
        text['machine']['tool'] = tool
    text['setups'] = {name: body for name, body in text['setups'].items() if not name.startswith(without)}
    if errors is not None:
        text['geometry'] = {
            'curves': {n: {'position': np.asarray(c.position).tolist(), 'value': np.asarray(c.value).tolist()}
                       for n, c in errors.curves.items()},
            'squareness': {n: float(v) for n, v in errors.square.items()}}
    return parse_cell(yaml.safe_dump(text, sort_keys=False), str(DEMO))


def bag_of(cell: Cell, folder) -> str:
    write_log(simulate_log(cell), folder)
    return str(folder)


@pytest.fixture(scope='module')
def place(tmp_path_factory):
    """Folder with ``before``, its tables of two controls, and ``after_KIND``: measured with the tables in force."""
    folder = tmp_path_factory.mktemp('loop')
    before = cell_of()
    bag = bag_of(before, folder / 'before')
    machine = before.description.machine
    for kind in ('linuxcnc', 'heidenhain', 'isg'):
        tables = folder / kind
        assert main(['compensate', bag, '--format', kind, '--out', str(tables)]) == 0
        files = {file.name: file.read_text() for file in tables.iterdir() if file.suffix in SUFFIXES}
        taken = CONTROLS[kind].read(files, Place(machine, np.array(ORIGIN)))
        if CONTROLS[kind].whole_model:
            again = compensated_log(cell_of(errors=before.geometry, seed=99), taken_off(taken, machine))
            write_log(again, folder / f'after_{kind}')
        else:
            bag_of(cell_of(errors=left_of(before.geometry, taken), seed=99), folder / f'after_{kind}')
    return folder


@pytest.mark.parametrize('kind', some('linuxcnc', later=['heidenhain', 'isg']))
def test_the_loop_closes_as_predicted(place, kind, capsys):
    """Measure, make tables, put them in force, measure: the machine is better, and as much as was predicted."""
    capsys.readouterr()
    assert main(['verify', str(place / 'before'), str(place / f'after_{kind}'), '--tolerance', '12um', 'EYY=6um',
                 '--prediction', str(place / kind / 'prediction.json'), '--out', str(place / 'v'), '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer['decision'] == 'conforms' and answer['prediction']['as_predicted'], answer['prediction']
    figures = {figure['name']: figure for figure in answer['figures']}
    assert figures['volumetric']['after'] < 0.6 * figures['volumetric']['before']
    assert {'E', 'B', 'EXX', 'EA0Z'} <= set(figures)
    assert all(figure['U_after'] > 0.0 for figure in figures.values())
    page = (place / 'v' / 'index.html').read_text(encoding='utf-8')
    assert 'conforms' in page and '<svg' in page and 'as predicted' in page


def test_tables_on_top_of_a_volumetric_compensation(place, tmp_path, capsys):
    """The rotations are still there and act nowhere: what remains is what the tool point keeps, and all but nothing."""
    capsys.readouterr()
    tables = [str(place / 'isg' / f'{axis}.csv') for axis in 'xyz']
    assert main(['compensate', str(place / 'after_isg'), '--format', 'isg', '--out', str(tmp_path / 't'), '--json',
                 '--present', *tables]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer['before']['largest_m'] < 2e-6
    assert any('is known to U' in reason for reason in answer['refused'])


def test_tables_that_are_not_those_of_the_prediction_are_not_put_back(place, tmp_path, capsys):
    shutil.copytree(place / 'isg', tmp_path / 'isg')
    (tmp_path / 'isg' / 'y.csv').write_text((tmp_path / 'isg' / 'x.csv').read_text())
    assert main(['verify', str(place / 'before'), str(place / 'after_isg'), '--tolerance', '9um', '--prediction',
                 str(tmp_path / 'isg' / 'prediction.json'), '--out', str(tmp_path / 'v')]) == 2
    assert 'y.csv: is not the file' in one_line(capsys)


@pytest.mark.long
def test_tables_that_were_not_loaded_are_found_and_undecided_is_reported(place, capsys):
    bag = str(place / 'before')
    prediction = str(place / 'heidenhain' / 'prediction.json')
    assert main(['verify', bag, bag, '--tolerance', '6um', '--prediction', prediction, '--out', str(place / 'w')]) == 1
    out = capsys.readouterr().out
    assert 'NOT as predicted' in out and 'does not conform' in out
    answer = json.loads((place / 'w' / 'verify.json').read_text())
    largest = next(f['after'] for f in answer['figures'] if f['name'] == 'volumetric')
    # Neither inside its tolerance by U nor outside: undecided, with a status of its own.
    assert main(['verify', bag, bag, '--tolerance', f'{1e6 * largest:.4f}um', '--out', str(place / 'w')]) == 4
    assert 'undecided' in capsys.readouterr().out


def test_what_lies_beside_the_tables(place):
    folder = place / 'linuxcnc'
    prediction = json.loads((folder / 'prediction.json').read_text(encoding='utf-8'))
    assert prediction['written'] and prediction['after']['largest_m'] < prediction['before']['largest_m']
    assert prediction['after']['U_m'] > 0.0 and prediction['not_carried_m']['EAX'] > 1e-6
    assert set(prediction['not_carried_U_m']) == set(prediction['not_carried_m'])
    assert all(0.0 < spread < 1e-6 for spread in prediction['not_carried_U_m'].values())
    readme = (folder / 'README.txt').read_text(encoding='utf-8')
    assert 'The way back' in readme and 'To load' in readme
    assert (place / 'heidenhain' / 'README.txt').read_text(encoding='utf-8').startswith('NOTE: sign')
    assert (folder / 'prediction.png').stat().st_size > 20_000
    back = [line.split() for line in (folder / 'before' / 'x.comp').read_text().splitlines()]
    assert all(float(trim) == 0.0 for row in back for trim in row[1:])
    # In machine coordinates: the table of X begins where the volume does.
    assert float((folder / 'x.comp').read_text().split()[0]) == 1e3 * ORIGIN[0]


@pytest.mark.long
def test_lost_motion_goes_into_the_trims(tmp_path):
    """And out of the positioning: a run is zeroed where its first stop was reached from behind."""
    cell = cell_of({'backlash': {'B': [4e-6, 0.0, 0.0]}})
    bag = bag_of(cell, tmp_path / 'bag')
    assert main(['compensate', bag, '--format', 'linuxcnc', '--out', str(tmp_path / 'tables')]) == 0
    rows = np.array([[float(v) for v in line.split()]
                     for line in (tmp_path / 'tables' / 'x.comp').read_text().splitlines()])
    assert rows[:, 1] - rows[:, 2] == pytest.approx(4e-3, abs=4e-4)
    prediction = json.loads((tmp_path / 'tables' / 'prediction.json').read_text())
    assert prediction['reversal_m'].keys() == {'X'} and prediction['reversal_m']['X']['U'] > 0.0
    # A model without directions says that it stays.
    known = known_errors(read_log(bag), bag)
    found = compensation(known.solution, cell.description.machine, CONTROLS['isg'], reversal=known.reversal).checked()
    assert found.reversal == {} and found.reversal_left.keys() == {'X'}
    # What stays is part of what is predicted and of what is verified: half of it to either side.
    assert found.worst_after[0] == pytest.approx(2e-6, abs=2e-7)
    assert main(['verify', bag, bag, '--tolerance', '12um', '--json', '--out', str(tmp_path / 'v')]) in (0, 1, 4)
    told = json.loads((tmp_path / 'v' / 'verify.json').read_text())
    measured = {f['name']: f['after'] for f in told['figures']}['volumetric']
    assert measured == pytest.approx(found.worst_before[0], rel=0.02)
    assert measured > known_largest(known.solution, cell.description.machine) + 1e-6
    assert any('lost motion X' in note for note in told['notes'])
    assert 'it stays, this kind of table knows no direction' in summary(found)


def known_largest(solution, machine):
    """Largest deviation [m] at the corners and in the middle, lost motion left away."""
    points = np.stack(np.meshgrid(*(np.linspace(0.0, v, 9) for v in machine.volume), indexing='ij'), -1).reshape(-1, 3)
    return float(np.linalg.norm(deviation(solution.errors, machine, points), axis=1).max())


def test_a_log_of_one_axis_makes_one_file(tmp_path):
    table = tmp_path / 'stage_x.csv'
    rows = [f'{cycle},{way},{100 * target},{1e-3 * (1.5 * target ** 2 + 0.02 * way):.6f}' for cycle in (1, 2, 3)
            for way, targets in ((1, range(5)), (-1, reversed(range(5)))) for target in targets]
    table.write_text('cycle,direction,target_mm,deviation_mm\n' + '\n'.join(rows) + '\n')
    log = import_csv(table, 'x', corrected=True).log
    known = known_errors(log, 'stage_x')
    for kind, files in (('linuxcnc', {'x.comp', 'joints.ini'}), ('sinumerik', {'x_eec.mpf'}), ('isg', {'x.csv'})):
        found = compensation(known.solution, log.description.machine, CONTROLS[kind], np.zeros(3)).checked()
        assert set(found.files) == files
        assert {'EYY', 'EZZ'} <= set(found.unmeasured) and not found.whole_volume
        assert found.worst_after[0] < 0.01 * found.worst_before[0]


@pytest.fixture(scope='module')
def refused(tmp_path_factory):
    folder = tmp_path_factory.mktemp('refused')
    return {'no linear': bag_of(cell_of(without='lin'), folder / 'no_linear'),
            'vacuum': bag_of(cell_of(compensated=False), folder / 'vacuum'),
            'no place': bag_of(cell_of(origin=None), folder / 'no_place'),
            'other': bag_of(cell_of(tool=[0.0, 0.0, -0.1]), folder / 'other')}


@pytest.mark.parametrize(('column', 'said'), some(('displacement', 'turn the sign of the displacement'),
                                                  later=[('spot', 'is inverted')]))
def test_a_mistake_of_commissioning_makes_no_table(place, tmp_path, capsys, column, said):
    """A turned sign made tables of half a metre, a mirrored detector was taken for a gain."""
    log = read_log(place / 'before')
    samples = getattr(log, column)
    turned = samples.values * ([-1.0] if column == 'displacement' else [1.0, -1.0])
    write_log(replace(log, **{column: replace(samples, values=turned)}), tmp_path / 'bag')
    bag = str(tmp_path / 'bag')
    assert main(['compensate', bag, '--format', 'isg', '--out', str(tmp_path / 't')]) == 2
    assert said in (line := one_line(capsys)) and 'mistake of commissioning' in line
    assert not (tmp_path / 't').exists()
    assert main(['verify', str(place / 'before'), bag, '--tolerance', '9um', '--out', str(tmp_path / 'v')]) == 2
    assert said in one_line(capsys)
    with pytest.raises(StepdiagError, match='mistake of commissioning'):
        compensation(evaluate(read_log(bag)), log.description.machine, CONTROLS['linuxcnc']).checked()


def one_line(capsys) -> str:
    err = capsys.readouterr().err
    assert err.startswith('stepdiag: ') and err.count('\n') == 1, err
    return err


def test_reasons_not_to_write_tables(refused, tmp_path, capsys):
    out = tmp_path / 'tables'
    base = ['--format', 'linuxcnc', '--out', str(out)]
    assert main(['compensate', refused['no linear'], *base]) == 2
    line = one_line(capsys)
    assert 'EYY' in line and 'lin_y' in line and '--partial' in line
    assert main(['compensate', refused['no place'], *base]) == 2
    assert '--origin' in one_line(capsys)
    assert not out.exists()
    assert main(['compensate', refused['no linear'], '--format', 'sinumerik', '--out', str(out), '--partial']) == 0
    assert {p.name for p in out.glob('*.mpf')} == {'cec.mpf'}


def test_lengths_without_air_are_neither_compensated_nor_verified(refused, tmp_path, capsys):
    bag = refused['vacuum']
    assert not read_log(bag).environment
    assert main(['compensate', bag, '--format', 'isg', '--out', str(tmp_path / 't')]) == 2
    assert 'not corrected for air' in one_line(capsys)
    assert main(['verify', bag, bag, '--tolerance', '9um', '--out', str(tmp_path / 'v')]) == 2
    assert 'not corrected for air' in one_line(capsys)


@pytest.mark.long
def test_every_answer_says_that_lengths_are_not_corrected_for_air(refused, tmp_path, capsys):
    """Whatever is asked: text, status, page and JSON; and no error along an axis looks known."""
    bag, out = refused['vacuum'], tmp_path / 'gap'
    for asked in (['evaluate', bag], ['evaluate', bag, '--method', 'body_diagonal'],
                  ['evaluate', bag, '--method', 'iso230_2'], ['replay', bag]):
        capsys.readouterr()
        assert main(asked) == 1, asked
        assert 'not corrected for air' in capsys.readouterr().out, asked
    for asked in (['compare', bag], ['map', bag], ['gap', bag, '--out', str(out)]):
        assert main(asked) == 0, asked
        assert 'not corrected for air' in capsys.readouterr().out, asked
    document = json.loads((out / 'vacuum' / 'gap.json').read_text(encoding='utf-8'))
    assert document['traceable'] is False and any('not corrected for air' in text for text in document['warnings'])
    known = evaluate(read_log(bag))
    for name in ('EXX', 'EYY', 'EZZ'):
        assert document['errors'][name]['sigma'][-1] == pytest.approx(known.curve(name)[2][-1], rel=0.02)
    page = (out / 'vacuum' / 'index.html').read_text(encoding='utf-8')
    assert 'nothing wrong, but not corrected for air' in page and 'no metres' in page


@pytest.mark.parametrize(('arguments', 'said'), [
    (['--origin', '1,2'], '--origin'), (['--line', '0.1,0.1,nan'], '--line'), (['--line', '9,9,9'], 'reference line'),
    (['--line', '0,0,0', '--workpiece', '0,0,0'], 'give one of them'), (['--present', 'nowhere.comp'], 'nowhere.comp'),
    (['--tool', 'long'], '--tool')])
def test_bad_options_cost_one_line(place, tmp_path, capsys, arguments, said):
    capsys.readouterr()
    assert main(['compensate', str(place / 'before'), '--format', 'linuxcnc', '--out', str(tmp_path / 't'),
                 *arguments]) == 2
    assert said in one_line(capsys)


def test_a_folder_with_other_things_in_it_is_left_alone(place, tmp_path, capsys):
    (tmp_path / 'mine.txt').write_text('keep')
    assert main(['compensate', str(place / 'before'), '--format', 'isg', '--out', str(tmp_path)]) == 2
    assert 'holds other files' in one_line(capsys)
    assert [p.name for p in tmp_path.iterdir()] == ['mine.txt']


@pytest.mark.parametrize(('arguments', 'said'), [
    (['--tolerance', '12'], '--tolerance'), (['--tolerance', 'EXX=5urad'], 'EXX=5urad'),
    (['--tolerance', 'EQQ=5um'], 'EQQ'), (['--tolerance', '5um', '6um'], 'twice'),
    (['--tolerance', '5um', '--prediction', 'nowhere.json'], 'nowhere.json')])
def test_bad_questions_to_verify_cost_one_line(place, tmp_path, capsys, arguments, said):
    capsys.readouterr()
    bag = str(place / 'before')
    assert main(['verify', bag, bag, '--out', str(tmp_path / 'v'), *arguments]) == 2
    assert said in one_line(capsys)


def test_two_machines_are_not_compared(place, refused, tmp_path, capsys):
    assert main(['verify', str(place / 'before'), refused['other'], '--tolerance', '5um', '--out',
                 str(tmp_path / 'v')]) == 2
    assert 'machine.tool differs' in one_line(capsys)


def warm(effects: dict | None = None, steps: int = 4) -> Cell:
    """Vacuum lengths, scales 3 K above 20 °C of a stated material: all that lengths have to be freed of."""
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    text['motion'] |= {'dwell': 0.1}
    text['air'] |= {'compensated': False, 'sensors': ['temperature', 'pressure', 'humidity', 'scale'],
                    'scale_temperature': [23.0, 23.0, 23.0]}
    text['material'] = {'scales': {axis: {'expansion': 1.15e-5, 'sigma': 1e-6} for axis in 'xyz'}}
    text['machine']['origin'] = ORIGIN
    text['plan']['steps'] = steps
    text['effects'] = effects or {}
    return parse_cell(yaml.safe_dump(text, sort_keys=False), str(DEMO))


@pytest.mark.long
def test_a_cause_taken_out_leaves_metres_20_degrees_and_the_whole_budget(tmp_path):
    """Lost motion beside all that: the tables are those of the machine without it, its two directions apart."""
    plain, lost = (simulate_log(warm(effects)) for effects in (None, {'backlash': {'B': [4e-6, 0.0, 0.0]}}))
    known = known_errors(lost, 'lost')
    clean = evaluate(plain)
    assert known.reversal['X'][0] == pytest.approx(4e-6, abs=4e-7)
    assert known.solution.traceability.reference_temperature == 20.0
    assert known.solution.traceability.air == 'topics'
    for name in ('EXX', 'EYY', 'EZZ', 'EXY', 'EAX'):
        (_, value, sigma), (_, true, own) = known.solution.curve(name), clean.curve(name)
        # The same noise; 3 K of the scale of X are 6.9 µm, half the lost motion is 2 µm.
        assert np.abs(value - true).max() < 2.0 * np.hypot(sigma, own).max()
        assert np.all(sigma >= 0.97 * own), name
    for bag, log in (('plain', plain), ('lost', lost)):
        write_log(log, tmp_path / bag)
        tables = str(tmp_path / f'{bag}_t')
        assert main(['compensate', str(tmp_path / bag), '--format', 'linuxcnc', '--out', tables]) == 0
    mean = [np.array([[float(v) for v in line.split()] for line in
                      (tmp_path / f'{bag}_t' / 'x.comp').read_text().splitlines()])[:, 1:].mean(axis=1)
            for bag in ('plain', 'lost')]
    assert np.abs(mean[0] - mean[1]).max() < 6e-4
    prediction = json.loads((tmp_path / 'lost_t' / 'prediction.json').read_text())
    assert prediction['traceability']['reference_temperature'] == 20.0


def test_e_and_b_of_a_verification_are_in_metres(tmp_path, capsys):
    """Vacuum lengths of a diagonal of 0.28 m are 76 µm too long."""
    bag = bag_of(warm(steps=2), tmp_path / 'bag')
    capsys.readouterr()
    assert main(['verify', bag, bag, '--tolerance', '40um', 'E=25um', 'B=9um', '--out', str(tmp_path / 'v'),
                 '--json']) == 0
    figures = {f['name']: f for f in json.loads(capsys.readouterr().out)['figures']}
    document = json.loads((tmp_path / 'v' / 'verify.json').read_text(encoding='utf-8'))
    assert document['traceability']['after']['reference_temperature'] == 20.0
    assert any('referred to 20 °C' in note for note in document['notes'])
    assert not any('unlike' in note for note in document['notes'])
    test = run_method('body_diagonal', read_log(bag))
    assert figures['E']['after'] == pytest.approx(test.Ed) and figures['E']['after'] < 2e-5
    assert figures['E']['U_after'] == pytest.approx(2.0 * test.sigma_m['Ed'])
    assert figures['B']['U_after'] == pytest.approx(2.0 * test.sigma_m['Bd']) and figures['B']['U_after'] > 1e-7


def test_what_is_left_out_counts_in_every_u(refused, tmp_path, capsys):
    """Without linear setups the slopes are known to 0.2 mm: so is what tables without them leave."""
    out = tmp_path / 'tables'
    assert main(['compensate', refused['no linear'], '--format', 'sinumerik', '--out', str(out), '--partial']) == 0
    prediction = json.loads((out / 'prediction.json').read_text())
    assert all(prediction[when]['U_m'] > 1e-4 for when in ('before', 'after', 'after_as_measured'))
    assert 'they count in each U' in (out / 'README.txt').read_text(encoding='utf-8')


def test_vectors_may_begin_with_a_minus_sign(place, tmp_path, capsys):
    capsys.readouterr()
    assert main(['compensate', str(place / 'before'), '--format', 'isg', '--out', str(tmp_path / 't'),
                 '--origin', '-0.5,0.1,-0.3', '--tool', '-0.01,0,-0.1']) == 0
    assert json.loads((tmp_path / 't' / 'prediction.json').read_text())['origin_m'] == ORIGIN
    assert main(['compensate', str(place / 'before'), '--format', 'isg', '--out', str(tmp_path / 'u'),
                 '--origin', '-0.5,0.1,nix']) == 2
    assert '--origin' in one_line(capsys)


def test_a_table_of_one_axis_makes_tables_of_that_axis_alone(tmp_path, capsys):
    table = tmp_path / 'stage_x.csv'
    rows = [f'{cycle},{way},{100 * i},{1e-3 * (1.5 * i ** 2 + 0.02 * way + 0.05 * ((7 * i + cycle) % 3)):.6f}'
            for cycle in (1, 2, 3) for way, places in ((1, range(5)), (-1, reversed(range(5)))) for i in places]
    table.write_text('cycle,direction,target_mm,deviation_mm\n' + '\n'.join(rows) + '\n')
    asked = ['--format', 'linuxcnc', '--out', str(tmp_path / 't'), '--origin', '0,0,0']
    assert main(['import', str(table), '--to', str(tmp_path / 'bare')]) == 0
    assert main(['compensate', str(tmp_path / 'bare'), *asked]) == 2
    assert '--corrected' in one_line(capsys)
    assert main(['import', str(table), '--to', str(tmp_path / 'bag'), '--corrected']) == 0
    assert main(['compensate', str(tmp_path / 'bag'), *asked]) == 0
    assert {p.name for p in (tmp_path / 't').glob('*.comp')} == {'x.comp'}
    assert {p.name for p in (tmp_path / 't' / 'before').iterdir()} == {'x.comp', 'joints.ini'}


def test_results_at_unlike_temperatures_are_not_compared_without_a_word():
    """A machine measured cold and warm differs by its scales, unless both are referred to 20 °C."""
    def at(x: float | None, reference: float | None):
        return SimpleNamespace(traceability=Traceability(
            reference_temperature=reference, measured_at={} if x is None else {'x': x}))
    assert apart_words(at(18.0, 20.0), at(25.0, 20.0)) == apart_words(at(20.0, None), at(20.2, None)) == []
    assert apart_words(at(None, None), at(None, None)) == []
    referred = SimpleNamespace(traceability=replace(at(18.0, None).traceability, correction_m={'EXX': np.zeros(2)}))
    for before, after in ((at(18.0, None), at(25.0, None)), (at(18.0, 20.0), at(None, None)),
                          (referred, at(18.0, None))):
        assert 'unlike temperatures' in apart_words(before, after)[0]
