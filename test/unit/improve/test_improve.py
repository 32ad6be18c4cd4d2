"""Levels, backup and what the next calibration says, on logs of the virtual cell; no control needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.compensate.applied import bare, taken_off, without_applied
from stepdiag_ros.compensate.control import Place
from stepdiag_ros.compensate.taken import left_of
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.prediction import deviation, without_rigid_motion
from stepdiag_ros.improve import backup, levels
from stepdiag_ros.improve.outcome import outcome
from stepdiag_ros.linuxcnc import configuration
from stepdiag_ros.linuxcnc.ini import get
from stepdiag_ros.virtual.cell import load_cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

from ..compensated import compensated_log

CELL = Path(__file__).resolve().parents[3] / 'cells' / 'linuxcnc.yaml'


@pytest.fixture(scope='module')
def cell():
    return load_cell(CELL)


@pytest.fixture(scope='module')
def log(cell):
    return simulate_log(cell)


@pytest.fixture(scope='module')
def first(log):
    return evaluate(log)


@pytest.fixture
def control(cell, tmp_path):
    machine = cell.description.machine
    configuration.write(tmp_path, configuration.simulated(machine.name, machine.volume, machine.origin, 0.5, 2.0))
    return tmp_path


def without_screws(solution, taken):
    """What an evaluation finds of the machine under screw tables: its errors less what they take off."""
    left = left_of(solution.errors, taken)
    value = [left.square[name] if knot < 0 else left.curves[name](solution.positions[name])[knot]
             for name, knot in solution.names]
    return replace(solution, value=np.array(value))


@pytest.mark.parametrize('level', levels.LEVELS)
def test_a_level_makes_the_machine_better_and_says_by_how_much(level, cell, log, first, control):
    change = levels.change(level, first, cell.description.machine, levels.held(control), matrixkins=True)
    assert change.refusals == ()
    share = {'tables': 0.9, 'matrix': 0.9, 'volume': 0.05}[level]
    assert change.made.worst_after[0] < share * change.made.worst_before[0]
    configuration.write(control, change.files)
    assert levels.held(control).carries == level
    assert bool(change.applied) == (level == 'volume')


def test_a_compensated_machine_is_evaluated_with_the_compensation_put_back(cell, log, first, control):
    """Its angles act nowhere any more, which no rigid-body machine does: only with the compensation put back is the
    log one of a machine with 21 errors, and what remains is what remains in truth."""
    machine = cell.description.machine
    change = levels.change('volume', first, machine, levels.held(control))
    off = taken_off(change.applied, machine)
    again = compensated_log(replace(cell, seed=cell.seed + 1), off)
    assert evaluate(again).reduced_chi2 > 2.0
    under = bare(again, change.applied)
    second = evaluate(under)
    assert second.reduced_chi2 < 1.4
    found = outcome(change, first, {}, second, under)
    assert found.as_predicted and found.better and found.factor > 10.0
    shown = found.to_json_dict()
    assert shown['before']['largest_m'] == pytest.approx(found.factor * shown['after']['largest_m'])
    assert shown['after']['coverage'] == 0.95 and 1e-7 < shown['after']['U_m'] < found.off_bound_m
    points = change.made.before.points
    joints = points - off(points)
    truth = without_rigid_motion(points, deviation(cell.geometry, machine, joints) + joints - points)
    assert np.linalg.norm(truth, axis=1).max() < found.off_bound_m
    # Nothing done is not as predicted, and is reported so.
    idle = outcome(change, first, {}, evaluate(without_applied(log, off)), log)
    assert not idle.as_predicted and not idle.better


def test_the_volume_takes_up_screw_tables_that_are_there(cell, log, first, control):
    """Machine under tables, then volumetric: what is taken off is what volumetric alone takes off a bare machine."""
    machine = cell.description.machine
    bare = levels.change('volume', first, machine, levels.held(control)).applied
    tables = levels.change('tables', first, machine, levels.held(control))
    configuration.write(control, tables.files)
    under = evaluate(log)    # of the machine under the tables: its errors less what they take off
    taken = levels.CONTROL['tables'].read(levels.held(control).present, Place(machine, np.array(machine.origin)))
    again = levels.change('volume', without_screws(under, taken), machine, levels.held(control))
    points = again.made.before.points
    np.testing.assert_allclose(taken_off(again.applied, machine)(points), taken_off(bare, machine)(points), atol=2e-9)
    assert get(again.files['machine.ini'], 'JOINT_0', 'COMP_FILE') == []


def test_open_directions_are_refused(cell, log, first, control):
    from stepdiag_ros.estimate.solution import Unidentifiable
    blind = replace(first, unidentifiable=(Unidentifiable(('EYY slope',), 'nobody looked'),))
    change = levels.change('volume', blind, cell.description.machine, levels.held(control))
    assert any('EYY' in text for text in change.refusals)
    assert not levels.change('volume', blind, cell.description.machine, levels.held(control), partial=True).refusals


def test_what_is_left_out_counts_in_the_uncertainty(cell, log, first, control):
    """An open slope of EYY: of value zero in what is written, as uncertain as it is in what is said of the machine."""
    from stepdiag_ros.estimate.solution import Unidentifiable
    row = [i for i, (name, _) in enumerate(first.names) if name == 'EYY']
    position = np.asarray(first.positions['EYY'])
    wide = first.covariance.copy()
    wide[np.ix_(row, row)] += np.outer(position, position) * 1e-4**2
    blind = replace(first, covariance=wide, unidentifiable=(Unidentifiable(('EYY slope',), 'nobody looked'),))
    machine = cell.description.machine
    for level in ('tables', 'volume'):
        found = levels.change(level, blind, machine, levels.held(control), partial=True)
        assert found.refusals == ()
        most = found.made.worst_after[1]
        # Under tables much else is left, to which 16 µm across add little.
        assert most > {'tables': 0.5e-4, 'volume': 1.5e-4}[level] * position[-1], level
        known = levels.change(level, first, machine, levels.held(control))
        assert most > 2.0 * known.made.worst_after[1], level


def test_lost_motion_is_taken_out_and_into_screw_tables(cell, control):
    """The tables are those of the machine without lost motion, and the lost motion itself in both directions."""
    from stepdiag_ros.cli.known import known_errors
    machine = cell.description.machine
    lost = np.array([4.0e-6, 0.0, 0.0])
    text = CELL.read_text(encoding='utf-8') + '\neffects: {backlash: {B: [4.0e-6, 0.0, 0.0]}}\n'
    known = known_errors(simulate_log(parse_cell(text, str(CELL))), 'bag')
    value, spread = known.reversal['X']
    assert abs(value - lost[0]) < spread < 1e-6
    assert any('backlash' in note for note in known.notes)
    for name in ('EXX', 'EYY'):
        position, found, sigma = known.solution.curve(name)
        curve = to_reference_lines(cell.geometry).curves[name]
        assert np.all(np.abs(found - curve(position))[1:] < 3.5 * sigma[1:])
    tables = levels.change('tables', known.solution, machine, levels.held(control), reversal=known.reversal)
    configuration.write(control, tables.files)
    place = Place(machine, np.array(machine.origin))
    taken = levels.CONTROL['tables'].read(levels.held(control).present, place)
    np.testing.assert_allclose(taken['EXX'].reverse - taken['EXX'].forward, value, atol=1e-8)
    # The component knows no directions: what these tables do about the lost motion stays in a table.
    volume = levels.change('volume', without_screws(known.solution, taken), machine, levels.held(control))
    assert any('lost motion of X goes into a screw table' in note for note in volume.notes)
    configuration.write(control, volume.files)
    there = levels.held(control)
    both = levels.CONTROL['volume'].read(there.present, place)
    assert set(there.files) == {'x.comp', 'volume.txt'}
    np.testing.assert_allclose(both['EXX'].reverse - both['EXX'].forward, value, atol=1e-8)
    np.testing.assert_allclose(both['EXX'].at(taken['EXX'].position).mean,
                               known.solution.curve('EXX')[1], atol=2e-9)


def test_without_an_origin_nothing_is_written(cell, first, control):
    with pytest.raises(StepdiagError, match=r'machine\.origin'):
        levels.change('volume', first, replace(cell.description.machine, origin=None), levels.held(control))


@pytest.mark.parametrize(('old', 'new', 'said'), [
    ('trivkins coordinates=XYZ', 'matrixkins', 'matrix that stepdiag did not write'),
    ('LINEAR_UNITS = mm', 'LINEAR_UNITS = inch', 'LINEAR_UNITS is inch'),
    ('LINEAR_UNITS = mm\n', '', 'LINEAR_UNITS is missing'),
    ('coordinates=XYZ', 'coordinates=XYYZ', 'coordinates=XYYZ'), ('JOINTS = 3', 'JOINTS = 4', 'JOINTS 4'),
    ('trivkins', 'corexykins', 'corexykins'), ('COORDINATES = X Y Z', 'COORDINATES = X Z Y', 'COORDINATES XZY'),
    ('[EMC]', '#INCLUDE joints.inc\n[EMC]', '#INCLUDE')])
def test_a_control_that_cannot_be_added_to_is_not_measured(control, old, new, said):
    ini = control / 'machine.ini'
    assert old in ini.read_text()
    ini.write_text(ini.read_text().replace(old, new))
    with pytest.raises(StepdiagError) as caught:
        levels.held(control)
    assert said in str(caught.value) and '\n' not in str(caught.value)


def test_undo_puts_back_every_byte(cell, first, control):
    before = {path.relative_to(control): path.read_bytes() for path in control.rglob('*') if path.is_file()}
    for level in ('tables', 'volume'):
        change = levels.change(level, first, cell.description.machine, levels.held(control))
        backup.keep(control, change.files)
        configuration.write(control, change.files)
    backup.undo(control)
    assert set(levels.held(control).files) == {'x.comp', 'y.comp', 'z.comp'}
    backup.undo(control)
    after = {path.relative_to(control): path.read_bytes() for path in control.rglob('*') if path.is_file()}
    assert after == before
    with pytest.raises(StepdiagError, match='nothing to undo'):
        backup.undo(control)


def test_undo_keeps_what_was_edited_since(cell, first, control):
    """And bytes that are no UTF-8, which somebody's comments may hold."""
    ini = control / 'machine.ini'
    ini.write_bytes(ini.read_bytes() + b'# f\xfcr M\xfcller\n')
    original = ini.read_bytes()
    change = levels.change('volume', first, cell.description.machine, levels.held(control))
    backup.keep(control, change.files)
    configuration.write(control, change.files)
    assert b'# f\xfcr M\xfcller\n' in ini.read_bytes()
    edited = ini.read_bytes() + b'[FILTER]\n'
    ini.write_bytes(edited)
    back, aside = backup.undo(control)
    assert 'machine.ini' in back and aside == ['machine.ini.edited1']
    assert ini.read_bytes() == original and (control / aside[0]).read_bytes() == edited


def test_half_a_backup_is_none(control):
    (control / backup.BACKUPS / '001').mkdir(parents=True)
    with pytest.raises(StepdiagError, match='nothing to undo'):
        backup.undo(control)
