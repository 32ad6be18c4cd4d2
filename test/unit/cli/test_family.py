"""Every kind of test in one plan, as shipped: simulated, evaluated in one estimate, diagnosed, shown on sheets."""

import json
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.virtual.cell import load_cell

CELL = Path(__file__).resolve().parents[3] / 'cells' / 'family.yaml'


@pytest.fixture(scope='module')
def log(tmp_path_factory) -> Path:
    bag = tmp_path_factory.mktemp('family') / 'log'
    assert main(['simulate', str(CELL), '--out', str(bag)]) == 0
    return bag


def test_the_shipped_family_shows_all_errors_in_one_estimate(log, capsys):
    capsys.readouterr()
    assert main(['evaluate', str(log), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['status'] == 'ok'
    assert {part['kind'] for part in found['parts']} == {
        'body diagonal', 'face diagonal', 'face step diagonal', 'line', 'multilateration'}
    assert set(found['errors']) == {*CURVES, *SQUARENESS}
    named = {name.split()[0] for entry in found['unidentifiable'] for name in entry['names']}
    assert not named & {*CURVES, *SQUARENESS}
    truth = to_reference_lines(load_cell(CELL).geometry)
    within = []
    for name, curve in found['errors'].items():
        if 'position_m' in curve:
            true = truth.curves[name](np.array(curve['position_m']))
        else:
            true = truth.square[name]
        away = np.abs(np.subtract(curve['value'], true))
        within += list(np.atleast_1d(away <= 3.0 * np.array(curve['sigma']) + 1e-12))
    assert np.mean(within) > 0.97


@pytest.mark.long
def test_each_kind_has_its_sheet(log):
    page = log.parent / 'page'
    assert main(['report', str(log), '--sheets', '--out', str(page)]) == 0
    sheets = (page / 'sheets.html').read_text(encoding='utf-8')
    for title in ('ISO 230-2', 'ISO 230-6', 'Multilateration', 'Rectangular', 'Step diagonals'):
        assert title in sheets, title
    assert (page / 'sheets.pdf').stat().st_size > 10_000


@pytest.mark.long
def test_nothing_is_found_in_it(log, tmp_path):
    assert main(['gap', str(log), '--out', str(tmp_path / 'gap')]) == 0
    found = json.loads(next((tmp_path / 'gap').rglob('gap.json')).read_text(encoding='utf-8'))
    assert found['verdict'] == 'no_gap'
