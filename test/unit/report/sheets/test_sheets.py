"""Test sheets from logs: their numbers by a second way, what they say, the files."""

import re
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import yaml

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.report.sheets.write import sheets_of
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).parents[4] / 'cells' / 'demo.yaml'
DIAGONALS = ('ppp', 'npp', 'pnp', 'nnp')


def cell(**changes):
    """The demo's cell at rest only, with other keys."""
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    for key, value in changes.items():
        text[key] = text.get(key, {}) | value if isinstance(value, dict) and key != 'setups' else value
    return parse_cell(yaml.safe_dump(text, sort_keys=False), str(DEMO))


def bag_of(folder, **changes):
    write_log(simulate_log(cell(**changes)), folder)
    return folder


@pytest.fixture(scope='module')
def full(tmp_path_factory):
    """Five cycles, five targets and more, backlash of X 2 µm."""
    setups = yaml.safe_load(DEMO.read_text(encoding='utf-8'))['setups']
    setups['lin_x']['stops'] = 9
    return bag_of(tmp_path_factory.mktemp('sheets') / 'full', plan={'steps': 2, 'repeats': 5}, effects={'backlash': {
        'B': [2e-6, 0.0, 0.0]}}, setups={n: setups[n] for n in (*DIAGONALS, 'lin_x')})


@pytest.fixture(scope='module')
def sheets(full):
    log = read_log(full)
    return sheets_of(log, evaluate_in_full(log), 'full')


def figures(sheet):
    return {row[0]: [float(v.replace('−', '-')) for v in row[-2:]] for row in sheet.results.rows}


def test_figures_of_a_line_by_numpy_alone(full, sheets):
    """From the samples of the log, without the readings of the estimators."""
    log, runs = read_log(full), {1: {}, -1: {}}
    steps, name = log.steps, log.steps.setup_names.index('lin_x')
    for i in np.flatnonzero((steps.setup == name) & (steps.phase == 1)):
        inside = (log.displacement.time_ns >= steps.time_ns[i]) & (log.displacement.time_ns < steps.time_ns[i + 1])
        runs[int(steps.direction[i])].setdefault(int(steps.repeat[i]), {})[int(steps.index[i])] = (
            log.displacement.values[inside, 0].mean())
    target = np.linspace(0.0, 0.2, 9)
    up = np.array([[run[k] for k in range(9)] for run in runs[1].values()])
    up = up - up[:, :1]
    down = np.array([[run[k] for k in range(9)] for run in runs[-1].values()])
    down = down - down[:, -1:] + up[:, -1:]
    up, down = 1e6 * (up - target), 1e6 * (down - target)
    # Each cycle has a zero of its own: of its 17 arrivals one is in all readings, and their mean off makes 17/16.
    cycle = (up.sum(axis=1) + down[:, :-1].sum(axis=1)) / 17
    x_up, x_down = up.mean(0), down.mean(0)
    s_up, s_down = (np.sqrt(17 / 16) * (v - cycle[:, None]).std(0, ddof=1) for v in (up, down))
    got = {key: value for key, (value, _) in figures(sheets[0]).items()}
    high, low = np.maximum(x_up + 2 * s_up, x_down + 2 * s_down), np.minimum(x_up - 2 * s_up, x_down - 2 * s_down)
    assert got['A'] == pytest.approx(high.max() - low.min(), abs=2e-3)
    assert got['A↑'] == pytest.approx((x_up + 2 * s_up).max() - (x_up - 2 * s_up).min(), abs=2e-3)
    assert got['E'] == pytest.approx(np.ptp([x_up, x_down]), abs=2e-3)
    assert got['R↓'] == pytest.approx(4 * s_down.max(), abs=2e-3)
    assert got['R'] == pytest.approx(np.max([2 * s_up + 2 * s_down + abs(x_up - x_down), 4 * s_up, 4 * s_down]),
                                     abs=2e-3)
    assert got['B'] == pytest.approx(abs(x_up - x_down).max(), abs=2e-3)
    assert got['M'] == pytest.approx(np.ptp((x_up + x_down) / 2), abs=2e-3)
    assert got['B'] == pytest.approx(2.0, abs=0.8)


def test_every_figure_has_an_uncertainty(sheets):
    for sheet in (one for one in sheets if one.standard.startswith('ISO')):
        for name, (_, expanded) in figures(sheet).items():
            assert expanded > 0.0, (sheet.title, name)


@pytest.mark.parametrize(('slopes', 'diagonal_um'), [((50e-6, 0.0, 0.0), 28.9), ((100e-6, -50e-6, -25e-6), 14.4),
                                                    ((0.0, 0.0, 100e-6), 57.7)],
                         ids=['machine A', 'machine B', 'machine C'])
def test_machines_of_renishaw_on_the_sheet(tmp_path, slopes, diagonal_um):
    """From the published machine through a log to Ed on the sheet."""
    curves = {f'E{a}{a}': {'position': [0.0, 1.0], 'value': [0.0, s]} for a, s in zip('XYZ', slopes, strict=True)}
    small = dict.fromkeys(('displacement', 'spot', 'position_repeatability', 'angle_repeatability'), 1e-9)
    setup = {'standoff': 0.2, 'psd_offset': [0.02, 0.0], 'beams': [[0.0, 0.0]]}
    none = {'drawn': dict.fromkeys(('positioning', 'straightness', 'angle', 'squareness'), 0.0), 'curves': curves}
    log = read_log(bag_of(
        tmp_path / 'machine', machine={'volume': [1.0, 1.0, 1.0], 'tool': [0.0, 0.0, 0.0]}, noise=small, geometry=none,
        misalignments={'drawn': {'laser': 0.0, 'mirror': 0.0, 'psd_zero': 0.0}}, plan={'repeats': 2},
        setups={name: deepcopy(setup) for name in DIAGONALS},
        air={'drift': dict.fromkeys(('temperature', 'pressure', 'humidity'), 0.0)}))
    sheet = sheets_of(log, evaluate_in_full(log), 'machine')[0]
    assert sheet.standard == 'ISO 230-6'
    assert figures(sheet)['Ed, Bd'][0] == pytest.approx(0.0, abs=0.05)     # Bd: the machine has no backlash
    assert float(sheet.results.rows[-1][4]) == pytest.approx(diagonal_um, abs=0.05)
    assert any('opposite' in note for note in sheet.notes)


def test_the_sheet_of_the_steps_has_errors_mirrors_and_what_is_missing(full, sheets):
    sheet = next(one for one in sheets if one.title == 'Step diagonals of the body')
    solution = evaluate_in_full(read_log(full)).solution
    rows = {row[0]: row for row in sheet.results.rows}
    assert rows['EAX'][2] == f'{2e6 * solution.curve("EAX")[2].max():.3f}' and rows['EAX'][3] == 'µrad'
    [angles] = sheet.details
    found = {row[0]: row[2:] for row in angles.rows}
    assert list(found) == list(DIAGONALS)
    own, sigma = solution.misalignments['npp'], solution.misalignment_sigma['npp']
    assert found['npp'][2] == f'{1e6 * own.mirror[0]:.1f} ± {2e6 * sigma.mirror[0]:.1f}'
    assert [s for s in sheet.shortfalls if 'no line along Y, Z' in s] == sheet.shortfalls


def test_what_the_log_does_not_hold_is_not_stated(sheets):
    said = dict(sheets[0].conditions)
    assert said['compensation active in the control'] == said['overrun before the end targets'] == 'not stated'
    assert said['temperature of scale X'] == said['expansion coefficient of scale X'] == 'not stated'
    assert said['person'] == said['make and serial number of the machine'] == 'not stated'
    assert said['feed'].startswith('commanded 30000 mm/min; mean speed')
    assert said['air temperature'].startswith('20.3') and 'U ' in said['air temperature']
    assert said['dwell at a target'].startswith('0.060 s')
    assert re.fullmatch(r'\d{4}-\d\d-\d\d .* UTC to .* UTC', said['date of test'])


def test_what_the_owner_states_is_on_the_sheet_and_in_the_log(tmp_path):
    said = {'machine': 'Mill 5, no. 17', 'instrument': 'IDS3010, no. 4, calibrated 2026-02', 'detector': 'no. 9',
            'place': 'hall 2', 'person': 'the operator', 'warm_up': '2 h', 'compensation': 'none',
            'bed_temperature': '20.4 °C'}
    setups = yaml.safe_load(DEMO.read_text(encoding='utf-8'))['setups']
    scale = {'expansion': 1.15e-5, 'sigma': 1e-6, 'temperature': 21.3, 'temperature_sigma': 0.2}
    bag = bag_of(tmp_path / 'stated', test=said, setups={'lin_x': setups['lin_x'] | {'feed': 0.02}}, material={
        'scales': {'x': scale}, 'workpiece': {'expansion': 2.3e-5, 'sigma': 1e-6, 'temperature': 22.0}})
    log = read_log(bag)
    assert dict(log.description.statement.said) == said
    shown = dict(sheets_of(log, evaluate_in_full(log), 'stated')[0].conditions)
    assert shown['temperature of scale X'] == '21.30 ± 0.40 °C (k = 2; the cell file\'s value, not measured)'
    assert shown['temperature of the workpiece'].startswith('22.00 ± 1.00 °C')
    assert shown['expansion coefficient of the workpiece'] == '23.00 ± 2.00 µm/(m·K) (k = 2)'
    assert shown['readings along X referred to 20 °C'].startswith('yes')
    assert 'EXX -' in shown['parts'] and '(k = 2)' in shown['parts']
    for text in said.values():
        assert any(text in value for value in shown.values()), text
    assert shown['feed'].startswith('commanded 1200 mm/min')


def test_one_command_writes_html_and_pdf_that_need_nothing_else(full, tmp_path, capsys):
    assert main(['report', str(full), '--sheets', '--out', str(tmp_path)]) == 0
    printed = capsys.readouterr().out.split()
    assert printed == [str(tmp_path / name) for name in ('index.html', 'sheets.html', 'sheets.pdf')]
    html, pdf = (tmp_path / 'sheets.html').read_text(), (tmp_path / 'sheets.pdf').read_bytes()
    assert html.count('<section class="sheet">') == 3 and html.count('<svg') == 3
    assert not re.search(r'(src|href)="(?!#)', html)
    assert 'Positioning of axis X' in html and 'Body diagonals' in html and 'ISO 230-2 wants 5' not in html
    assert pdf.startswith(b'%PDF') and len(re.findall(rb'/Type /Page\b', pdf)) >= 4


@pytest.mark.long
def test_fewer_targets_and_cycles_are_said_on_both(tmp_path, capsys):
    bag = bag_of(tmp_path / 'short')
    assert main(['report', str(bag), '--sheets', '--out', str(tmp_path / 'out')]) == 0
    capsys.readouterr()
    html = (tmp_path / 'out' / 'sheets.html').read_text()
    assert 'lin_x: 2 targets over 200 mm; ISO 230-2 wants at least 5.' in html
    assert 'npp: 2 cycles; ISO 230-6 wants 5.' in html


def test_a_table_without_times_has_no_date_feed_or_dwell(tmp_path, capsys):
    rows = ['cycle,direction,target_mm,measured_mm']
    for repeat in range(5):
        for way in (1, -1):
            rows += [f'{repeat},{way},{10 * k},{10 * k + 0.001 * (way < 0) + 1e-4 * ((7 * k + 3 * repeat) % 5)}'
                     for k in range(5)[::way]]
    (tmp_path / 'line_x.csv').write_text('\n'.join(rows) + '\n')
    assert main(['import', str(tmp_path / 'line_x.csv'), '--axis', 'x', '--to', str(tmp_path / 'bag')]) == 0
    capsys.readouterr()
    log = read_log(tmp_path / 'bag')
    evaluation = evaluate_in_full(log)
    said = dict(sheets_of(log, evaluation, 'line')[0].conditions)
    for what in ('date of test', 'instrument', 'feed', 'dwell at a target'):
        assert said[what].startswith('not stated'), what
    assert said['zero of the readings'].endswith('several cycles share it')
    closure = evaluation.solution.closure[0]
    assert not closure.reset_between and closure.to_json_dict()['time_ns'] is None
    assert closure.length_m == pytest.approx(1e-6, abs=1e-9)


@pytest.mark.parametrize(('stage', 'reversal_um'), [('stage_a_x', 33.6), ('stage_a_z', 2.4)])
def test_published_reversal_of_measured_stages_on_the_sheet(shared, tmp_path, capsys, stage, reversal_um):
    assert main(['import', str(shared / 'real_data' / f'{stage}.csv'), '--to', str(tmp_path / 'bag')]) == 0
    capsys.readouterr()
    log = read_log(tmp_path / 'bag')
    sheet = sheets_of(log, evaluate_in_full(log), stage)[0]
    assert figures(sheet)['B'][0] == pytest.approx(reversal_um, abs=0.05)


def test_without_the_option_there_are_no_sheets(tmp_path, capsys):
    setups = yaml.safe_load(DEMO.read_text(encoding='utf-8'))['setups']
    bag, out = bag_of(tmp_path / 'line', setups={'lin_x': setups['lin_x']}), tmp_path / 'out'
    assert main(['report', str(bag), '--out', str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / 'index.html')
    assert not list(out.glob('sheets.*'))
