"""How cycles come back to their first stop: by hand, without drift, with drift, with a reset and without."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.cli.main import main
from stepdiag_ros.estimate.closure import closures, said
from stepdiag_ros.estimate.evaluate import evaluate, evaluate_in_full
from stepdiag_ros.model.path import setup_direction
from stepdiag_ros.report.closure_section import closure_section
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

DEMO = Path(__file__).parents[3] / 'cells' / 'demo.yaml'


def log_of(effects=None, repeats=3, **air):
    text = yaml.safe_load(DEMO.read_text(encoding='utf-8'))
    text['sampling'] |= {'interferometer': 200.0, 'psd': 200.0, 'in_motion': False}
    text['plan']['repeats'] = repeats
    text['effects'] = effects or {}
    text['air'] |= air
    return simulate_log(parse_cell(yaml.safe_dump(text, sort_keys=False), str(DEMO)))


@pytest.fixture(scope='module')
def quiet():
    return log_of(repeats=8)


@pytest.fixture(scope='module')
def whole(quiet):
    return evaluate_in_full(quiet)


def test_without_drift_closures_are_as_uncertain_as_they_say(whole):
    found = whole.solution.closure
    assert len(found) == 7 * 8
    lengths = np.array([one.length_m / one.length_sigma_m for one in found])
    spots = np.array([one.spot_m / one.spot_sigma_m for one in found]).ravel()
    # A standard deviation from 56 (112) values is uncertain by 9 % (7 %).
    assert 0.7 < lengths.std() < 1.3 and 0.78 < spots.std() < 1.22
    assert all(one.reset_between and 0.0 < one.unseen_s < 1.0 for one in found)
    assert [one.time_ns for one in found] == sorted(one.time_ns for one in found)


def test_by_hand(quiet, whole):
    """A cycle with a reset at its turn, and the same as one run with the zero of the forward one."""
    table, noise = whole.metres.table, whole.fit.noise
    cycle = np.flatnonzero((table.setup == table.setup_names.index('npp')) & (table.repeat == 1))
    forward, backward = (cycle[table.direction[cycle] == way] for way in (1, -1))
    forward, backward = forward[np.argsort(table.index[forward])], backward[np.argsort(table.index[backward])]
    length = table.displacement[:, 0].copy()
    length[forward[0]], length[forward[-1]], length[backward[-1]], length[backward[0]] = 1.0, 4.0, 10.0, 7.25
    reset = replace(table, displacement=length[:, None])
    mine = next(one for one in closures(quiet, reset, noise) if (one.setup, one.repeat) == ('npp', 1))
    assert mine.reset_between and mine.length_m == 3.0 - 2.75
    assert mine.duration_s == pytest.approx(table.time_s[backward[0]] - table.time_s[forward[0]])
    run = table.run.copy()
    run[backward] = run[forward[0]]
    one_run = replace(reset, run=run)
    direct = next(one for one in closures(quiet, one_run, noise) if (one.setup, one.repeat) == ('npp', 1))
    assert not direct.reset_between and direct.length_m == 6.25 and direct.unseen_s == 0.0
    # Two arrivals of three axes with independent errors come to √2 of one along any unit vector.
    assert direct.length_sigma_m == pytest.approx(np.sqrt(2.0) * noise.position, rel=1e-2)
    assert direct.length_sigma_m < mine.length_sigma_m
    assert direct.closes is False and 'reset' not in said([direct])


def test_a_cycle_that_is_not_whole_has_no_closure(quiet, whole):
    table = whole.metres.table
    rows = ~((table.setup == 0) & (table.repeat == 0) & (table.direction < 0) & (table.index == 0))
    short, noise = table.select(rows), replace(whole.fit.noise, sensor=whole.fit.noise.sensor[rows])
    assert len(closures(quiet, short, noise)) == 7 * 8 - 1


def test_drift_is_the_closure():
    """A structure with a known drift: each closure is its way along the line of sight between two times."""
    log = log_of({'structural_thermal_drift': {'amp': [6e-5, 4e-5, -5e-5], 'tau': 100.0}})
    found = evaluate(log).closure
    assert sum(not one.closes for one in found) > len(found) / 3
    begin, ways = int(log.steps.time_ns[0]), []
    for one in found:
        first, last = (np.exp(-(t - begin) * 1e-9 / 100.0) for t in one.time_ns)
        way = np.array([6e-5, 4e-5, -5e-5]) @ setup_direction(log.description.machine, one.setup) * (first - last)
        assert one.length_m == pytest.approx(way, abs=4.0 * one.length_sigma_m + 0.03 * abs(way)), one.setup
        ways.append(way)
    assert np.corrcoef(ways, [one.length_m for one in found])[0, 1] > 0.9


def test_json_and_page(quiet, whole, tmp_path, capsys):
    write_log(quiet, tmp_path / 'bag')
    main(['evaluate', str(tmp_path / 'bag'), '--json'])
    answer = json.loads(capsys.readouterr().out)['closure']
    assert len(answer) == 56 and answer[0]['runs'] == ['ppp/0/+', 'ppp/0/-'] and answer[0]['reset_between'] is True
    assert {'length_m', 'length_sigma_m', 'spot_m', 'time_ns', 'temperature_C'} <= set(answer[0])
    assert answer[0]['temperature_C']['air'][0] == pytest.approx(20.3, abs=0.1)
    html = closure_section(whole.solution.closure, 3)
    assert 'does each cycle return to its zero' in html and 'A reset of the interferometer lies between' in html
    assert html.count('<tr>') == 57 and '→' in html
    assert closure_section((), 3) == ''


def test_cycles_without_a_reading_where_they_begin_are_said(quiet, whole):
    """As of a regulated beam that does not settle within the dwell."""
    table, noise = whole.metres.table, whole.fit.noise
    blind = (table.setup == table.setup_names.index('npp')) & (table.index == 0)
    length = np.where(blind[:, None], np.nan, table.displacement)
    text = said(closures(quiet, replace(table, displacement=length), noise))
    assert text.startswith('4') and '8 of 56 cycles have no reading' in text and '(npp, repeat 0, …)' in text
    none = said(closures(quiet, replace(table, displacement=np.full_like(length, np.nan)), noise))
    assert none.startswith('56 of 56 cycles have no reading')
