"""The sheet of multilateration: what it says of stations, errors and what is missing."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.report.sheets.write import sheets_of
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

CELL = """
schema: 1
seed: 5
machine: {name: sheet, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 2, order: XYZ, repeats: 2}
setups:
SETUPS
misalignments: {drawn: {station: 1.0e-3}}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-9, settling: 0.0, dwell: 0.05, mount: 2.0}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05, in_motion: false}
"""
PLACES = ((-0.15, -0.12, -0.10), (0.42, -0.10, -0.05), (0.38, 0.35, -0.15), (-0.12, 0.30, 0.25))
TOOLS = ((0.0, 0.0, -0.12), (0.05, 0.0, -0.12), (0.0, 0.05, -0.12), (-0.04, -0.04, -0.20))


def log_of(count, more='', tools=TOOLS):
    lines = [f'  s{k}: {{from: [0, 0, 0], to: [0.2, 0.16, 0.12], moves: grid, station: {list(PLACES[k])}, '
             f'tool: {list(tools[k])}}}' for k in range(count)]
    return simulate_log(parse_cell(CELL.replace('SETUPS', '\n'.join([*lines, more]))))


@pytest.fixture(scope='module')
def four():
    return log_of(4)


def test_the_sheet_has_stations_errors_and_conditions(four):
    evaluation = evaluate_in_full(four)
    [sheet] = sheets_of(four, evaluation, 'four')
    assert sheet.title == 'Multilateration' and not sheet.shortfalls
    rows = {row[0]: row for row in sheet.results.rows}
    assert len(rows) == 21
    _, value, sigma = evaluation.solution.curve('EXX')
    assert rows['EXX'][1:] == (f'{1e6 * np.ptp(value):.3f}', f'{2e6 * sigma.max():.3f}', 'µm')
    [stations] = sheet.details
    assert [row[0] for row in stations.rows] == ['s0', 's1', 's2', 's3'] and stations.rows[0][6:8] == ('27', '2')
    said = dict(sheet.conditions)
    assert 'station about (-150.0, -120.0, -100.0) mm' in said['targets of s0']
    assert 'as many as the method needs' in sheet.enough
    assert {'date of test', 'dwell at a target', 'air temperature', 'correction for air'} <= set(said)


def test_what_is_missing_is_on_the_sheet():
    log = log_of(2, '  edge: {standoff: 0.2, from: [0, 0, 0], to: [0.2, 0, 0]}', tools=(TOOLS[0],) * 2)
    sheet = next(s for s in sheets_of(log, evaluate_in_full(log), 'two') if s.title == 'Multilateration')
    assert any('2 stations; space needs four' in sentence for sentence in sheet.shortfalls)
    assert any('one tool vector' in sentence for sentence in sheet.shortfalls)
    assert any(note.startswith('Left open by the log') for note in sheet.notes)
    assert any('joint estimate of the whole log' in note for note in sheet.notes)


def test_a_rectangular_path_is_a_sheet_of_its_own():
    """It is no multilateration that lacks stations."""
    path = 'from: [0, 0, 0], to: [0.2, 0.16, 0], moves: around, station: [-0.15, -0.12, -0.12]'
    log = log_of(0, f'  xy: {{{path}}}\n  edge: {{standoff: 0.2, from: [0, 0, 0], to: [0.2, 0, 0]}}')
    sheets = {sheet.title: sheet for sheet in sheets_of(log, evaluate_in_full(log), 'path')}
    assert 'Multilateration' not in sheets
    sheet = sheets['Rectangular paths, the beam follows']
    assert sheet.shortfalls == ['xy: no line along Y; the path alone does not tell positioning.']
    assert [row[0] for row in sheet.details[0].rows] == ['xy']
    assert 'moves' not in dict(sheet.conditions) and 'around from' in dict(sheet.conditions)['targets of xy']


def test_the_command_writes_page_and_sheet(four, tmp_path, capsys):
    write_log(replace(four, namespace='/sheet'), tmp_path / 'four')
    assert main(['report', str(tmp_path / 'four'), '--out', str(tmp_path / 'out'), '--sheets']) == 0
    text = (tmp_path / 'out' / 'sheets.html').read_text(encoding='utf-8')
    assert 'Multilateration' in text and 'dead path' in text
    assert (tmp_path / 'out' / 'sheets.pdf').stat().st_size > 10_000
    page = ''.join(path.read_text(encoding='utf-8') for path in (tmp_path / 'out').glob('*.html'))
    assert 'Where the stations stood' in page and 'How laser and mirror were aligned' not in page
