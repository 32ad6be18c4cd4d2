"""Files of controls: what they say first, what is read back, what a control would not take."""

import numpy as np
import pytest

from stepdiag_ros.compensate.control import Place, even, thinned
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.functional import in_machine_coordinates
from stepdiag_ros.compensate.taken import Trim, added, difference, places
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.machine import AXES, CURVES

from .applied import ORIGIN, VOLUME, machine_of

PLACE = Place(machine_of('YXFZ'), ORIGIN)


def drawn(names, count: int = 9, seed: int = 1, straight=()) -> dict[str, Trim]:
    rng = np.random.default_rng(seed)
    taken = {}
    for name in names:
        position = np.linspace(0.0, VOLUME[AXES.index(name[2])], count)
        value = np.concatenate([[0.0], rng.normal(0.0, 5e-6, count - 1)])
        if name in straight:
            position, value = position[[0, -1]], value[[0, -1]]
        taken[name] = Trim(position, value, value)
    return taken


@pytest.mark.parametrize('kind', list(CONTROLS))
def test_what_is_written_is_read_back(kind):
    control = CONTROLS[kind]
    taken = drawn(control.carries, straight=control.straight)
    if control.reverses:    # an axis by itself may act otherwise in each direction
        taken |= {f'E{a}{a}': Trim(t.position, t.forward, t.reverse + 3e-6)
                  for a in AXES for t in [taken[f'E{a}{a}']]}
    again = control.read(control.write(taken, PLACE), PLACE)
    assert set(again) == set(taken)
    for name, trim in taken.items():
        back = again[name].at(trim.position)
        assert back.forward == pytest.approx(trim.forward, abs=2e-9)
        assert back.reverse == pytest.approx(trim.reverse, abs=2e-9)


def test_what_no_manual_confirms_stands_in_the_first_line():
    for kind, mark in (('sinumerik', ';'), ('isg', '//'), ('etalon', '//')):
        control = CONTROLS[kind]
        for name, text in control.write(drawn(control.carries), PLACE).items():
            if name.endswith('_eec.mpf'):
                continue    # $AA_ENC_COMP is confirmed
            assert text.startswith(f'{mark} ') and 'NOT confirmed' in text.splitlines()[0]
    assert CONTROLS['linuxcnc'].open_question == ''
    assert 'NOT confirmed' in CONTROLS['heidenhain'].open_question


def test_axes_of_which_nothing_is_known_get_no_file():
    one = drawn(['EXX'])
    assert set(CONTROLS['linuxcnc'].write(one, PLACE)) == {'x.comp', 'joints.ini'}
    assert set(CONTROLS['sinumerik'].write(one, PLACE)) == {'x_eec.mpf'}
    assert set(CONTROLS['heidenhain'].write(one, PLACE)) == {'X_AXIS.COM', 'CONFIG.CMA'}
    assert set(CONTROLS['isg'].write(one, PLACE)) == {'x.csv'}
    assert '[EYY]' not in CONTROLS['etalon'].write(one, PLACE)['errors.txt']


# LinuxCNC ------------------------------------------------------------------------------------------------------

def test_linuxcnc_takes_256_rows_and_stops_at_the_first_that_is_none():
    position = np.linspace(0.0, 0.4, 400)
    value = 1e-6 * np.sin(8.0 * position)
    files = CONTROLS['linuxcnc'].write({'EXX': Trim(position, value, value)}, PLACE)
    assert len(files['x.comp'].splitlines()) == 256
    back = CONTROLS['linuxcnc'].read(files, PLACE)['EXX'].at(position)
    assert back.forward == pytest.approx(value, abs=2e-9)
    cut = '0.0 0.001 0.001\n100.0 0.002 0.002\n# a comment\n200.0 9.0 9.0\n'
    read = CONTROLS['linuxcnc'].read({'x.comp': cut}, PLACE)['EXX']
    assert len(read.position) == 2 and read.forward[-1] == pytest.approx(-2e-6)


def test_linuxcnc_tables_of_reached_positions_are_told_from_trims():
    """Type 0 holds where the axis got to: trim = nominal − reached, as usrmotLoadComp has it."""
    reached = '0.0 0.0 -0.001\n100.0 100.004 100.003\n200.0 200.005 200.004\n'
    ini = '[JOINT_0]\nCOMP_FILE = tables/x.comp\nCOMP_FILE_TYPE = 0\n'
    for files in ({'x.comp': reached}, {'x.comp': reached, 'mill.ini': ini}):
        trim = CONTROLS['linuxcnc'].read(files, PLACE)['EXX']
        assert trim.forward == pytest.approx([0.0, 4e-6, 5e-6])
        assert trim.reverse == pytest.approx([-1e-6, 3e-6, 4e-6])
    with pytest.raises(StepdiagError, match='was not given'):
        CONTROLS['linuxcnc'].read({'mill.ini': ini}, PLACE)
    with pytest.raises(StepdiagError, match='names no COMP_FILE for joint 1'):
        CONTROLS['linuxcnc'].read({'mill.ini': ini, 'x.comp': reached, 'y.comp': reached}, PLACE)


def test_linuxcnc_backlash_of_the_ini_file_acts_where_there_is_no_table():
    ini = '[JOINT_1]\nBACKLASH = 0.010  \n'
    trim = CONTROLS['linuxcnc'].read({'mill.ini': ini}, PLACE)['EYY']
    assert (trim.forward[0], trim.reverse[0]) == pytest.approx((-5e-6, 5e-6))
    table = {'mill.ini': ini + 'COMP_FILE = y.comp\nCOMP_FILE_TYPE = 1\n', 'y.comp': '0 0.001 0.001\n300 0.002 0.002\n'}
    assert CONTROLS['linuxcnc'].read(table, PLACE)['EYY'].forward == pytest.approx([-1e-6, -2e-6])


# Files that cannot be added to -----------------------------------------------------------------------------------

@pytest.mark.parametrize(('kind', 'files', 'said'), [
    ('linuxcnc', {'x.comp': 'hello\n'}, 'x.comp'),
    ('linuxcnc', {'x.comp': '0 0 0\n0 0 0\n'}, 'do not rise'),
    ('linuxcnc', {'x.comp': '0 0.1 0\n1 0.9 0\n'}, 'COMP_FILE_TYPE'),
    ('linuxcnc', {'mill.ini': '[JOINT_0]\nBACKLASH = much\n'}, 'BACKLASH'),
    ('sinumerik', {'a.mpf': '$AA_ENC_COMP[0,0,X1]=0.1\n'}, 'MIN'),
    ('sinumerik', {'a.mpf': '$AN_CEC[0,0] 0.1\n'}, 'line 1'),
    ('sinumerik', {'c.mpf': '$AN_CEC[0,0]=0\n$AN_CEC_INPUT_AXIS[0]=(X1)\n$AN_CEC_OUTPUT_AXIS[0]=(Y1)\n'
                            '$AN_CEC_MULT_BY_TABLE[0]=2\n'}, 'multiplies'),
    ('sinumerik', {'c.mpf': '$AN_CEC[0,0]=0\n$AN_CEC_INPUT_AXIS[0]=(Q1)\n'}, 'no axis'),
    ('heidenhain', {'X.COM': 'NR AXISPOS X\n'}, 'BEGIN'),
    ('heidenhain', {'X.COM': 'BEGIN X.COM MM\nNR AXISPOS X\n0 1\n[END]\n'}, '3 numbers'),
    ('heidenhain', {'X.COM': 'BEGIN X.COM INCH\nNR AXISPOS X\n0 1 2\n[END]\n'}, 'mm'),
    ('isg', {'x.csv': 'Z X EXX\n0 0 0\n'}, 'head'),
    ('etalon', {'e.txt': '[C0Y]\nVALUE = 0.001\n'}, 'C0Y'),
    ('etalon', {'e.txt': '[EXX]\nGridpoints = {\n0 nan\n}\n'}, '2 numbers')])
def test_files_that_are_not_understood_cost_one_line(kind, files, said):
    with pytest.raises(StepdiagError) as caught:
        CONTROLS[kind].read(files, PLACE)
    assert said in str(caught.value) and '\n' not in str(caught.value)


# Helpers -----------------------------------------------------------------------------------------------------------

def test_sums_and_differences_of_curves():
    one, two = drawn(['EXX', 'EYX'], 9), drawn(['EXX', 'EZX'], 7, seed=2)
    total = added(one, two)
    x = np.linspace(-0.1, 0.6, 50)
    assert total['EXX'].at(x).forward == pytest.approx(one['EXX'].at(x).forward + two['EXX'].at(x).forward, abs=1e-15)
    back = difference(total, two)
    assert back['EXX'].at(x).forward == pytest.approx(one['EXX'].at(x).forward, abs=1e-15)
    assert back['EZX'].at(x).mean == pytest.approx(0.0, abs=1e-15)
    assert len(places([0.0, 1.0, 1.0 + 1e-10], [0.5])) == 3


def test_even_steps_hold_all_positions_where_they_can():
    assert even(np.array([0.0, 0.1, 0.25, 0.4]), 1000) == pytest.approx(np.arange(9) * 0.05)
    assert len(even(np.array([0.0, 0.1, 0.1 + np.pi / 100, 0.4]), 100)) <= 100


def test_thinning_drops_what_a_line_replaces():
    position = np.linspace(0.0, 1.0, 11)
    bent = np.abs(position - 0.5)
    kept = thinned(Trim(position, bent, bent), 3)
    assert kept.position == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ', 'YXFZ'])
def test_machine_coordinates_there_and_back(chain):
    machine, taken = machine_of(chain), drawn(CURVES)
    back = in_machine_coordinates(in_machine_coordinates(taken, machine, ORIGIN), machine, ORIGIN, back=True)
    for name, trim in taken.items():
        assert back[name].forward == pytest.approx(trim.forward, abs=1e-18)
