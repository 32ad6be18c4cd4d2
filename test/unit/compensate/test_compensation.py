"""Tables applied by implementations of their own, angles and levers present: what is reported about them is true."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.compensate.compensation import K, compensation
from stepdiag_ros.compensate.controls import CONTROLS
from stepdiag_ros.compensate.functional import functional_point
from stepdiag_ros.compensate.open_directions import without
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.solution import Solution, Unidentifiable
from test.some import some

from .applied import APPLIED, ORIGIN, VOLUME, goes, grid, machine_of, made, only

ROUNDING_M = 2e-8
"""What six digits of a millimetre and products of errors leave."""


def off(solution: Solution, machine, target: np.ndarray, command: np.ndarray) -> np.ndarray:
    return goes(solution, machine, command) - (target + np.asarray(machine.tool))


@pytest.mark.parametrize('kind', list(CONTROLS))
@pytest.mark.parametrize(('chain', 'seed'), some(('YXFZ', 3), later=[('FXYZ', 1), ('XFYZ', 2)]))
def test_what_is_predicted_is_what_happens(kind, chain, seed):
    """The files as text, applied by another implementation to a machine with rotations over levers."""
    machine, solution = machine_of(chain), made(seed, sigma=2e-7, knots=5)
    found = compensation(solution, machine, CONTROLS[kind], ORIGIN).checked()
    target = found.after.points
    before = off(solution, machine, target, target)
    after = off(solution, machine, target, APPLIED[kind](found.files, target, 1, machine=machine))
    assert found.before.deviation_m == pytest.approx(before, abs=1e-12)
    assert found.after.deviation_m == pytest.approx(after, abs=ROUNDING_M)
    worse = np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1)
    assert np.all(worse <= K * found.after.size_sigma_m + ROUNDING_M)
    assert np.mean(after**2) < 0.99 * np.mean(before**2)


@pytest.mark.parametrize('kind', ['sinumerik', 'heidenhain'])
def test_along_its_line_a_table_leaves_nothing(kind):
    """Angles times lever and squareness are in the tables: on the line only what the corner has is left."""
    machine, solution = machine_of(), made(5, sigma=5e-6)
    point = functional_point(machine, line=np.array([0.1, 0.2, 0.15]))
    found = compensation(solution, machine, CONTROLS[kind], ORIGIN, point)
    assert found.line_alone is None
    for axis in range(3):
        target = np.tile(point.line, (30, 1))
        target[:, axis] = np.linspace(0.0, VOLUME[axis], 30)
        left = off(solution, machine, target, APPLIED[kind](CONTROLS[kind].write(found.change, found.place), target, 1))
        assert np.abs(left - left[0]).max() < ROUNDING_M
        assert np.abs(off(solution, machine, target, target)).max() > 2e-6


def test_yaw_over_its_lever_is_not_made_worse():
    """EXX of 15 µm where yaw takes 30 µm off over the lever: a table of EXX at arm zero makes 15 into 30 µm."""
    ramp = np.linspace(0.0, 1.0, 9)
    solution = only(EXX=15e-6 * ramp, ECX=1e-4 * ramp)
    machine = machine_of(tool=(0.0, 0.0, 0.0))
    target = grid()
    before = np.linalg.norm(off(solution, machine, target, target), axis=1).max()
    naive = target - np.column_stack([np.interp(target[:, 0], np.linspace(0, VOLUME[0], 9), 15e-6 * ramp),
                                      *np.zeros((2, len(target)))])
    worse = np.linalg.norm(off(solution, machine, target, naive), axis=1).max()
    assert (before, worse) == pytest.approx((15e-6, 30e-6), rel=1e-3)
    found = compensation(solution, machine, CONTROLS['linuxcnc'], ORIGIN)
    assert found.files == {}
    with pytest.raises(StepdiagError, match='no table of this kind makes this machine better'):
        found.checked()


def test_tables_of_a_line_that_harm_are_refused_and_held_back_otherwise():
    machine, solution = machine_of(), made(11, sigma=2e-7, angle=4e-5)
    exact = compensation(solution, machine, CONTROLS['linuxcnc'], ORIGIN, exact=True)
    assert any('would become worse beyond its U' in reason for reason in exact.refusals)
    assert exact.files == {} and exact.before_files == {}
    held = compensation(solution, machine, CONTROLS['linuxcnc'], ORIGIN).checked()
    assert held.line_alone is not None
    assert held.worst_after[0] < held.worst_before[0]


@pytest.mark.long
def test_many_knots_are_held_back_as_well():
    """More places than one solution takes at once, more knots than places are judged at."""
    machine = machine_of()
    for knots in (21, 31):
        held = compensation(made(11, sigma=2e-7, knots=knots), machine, CONTROLS['linuxcnc'], ORIGIN).checked()
        assert held.line_alone is not None
        target = held.after.points
        after = off(made(11, sigma=2e-7, knots=knots), machine, target, APPLIED['linuxcnc'](held.files, target, 1))
        worse = np.linalg.norm(after, axis=1) - held.before.size_m
        assert np.all(worse <= K * np.maximum(held.before.size_sigma_m, held.after.size_sigma_m) + ROUNDING_M)


def test_what_the_kind_of_table_cannot_carry_is_computed():
    ramp = np.linspace(0.0, 1.0, 9)
    machine = machine_of(tool=(0.0, 0.0, 0.0))
    found = compensation(only(EXX=1e-5 * ramp, EAZ=2e-5 * ramp, ECX=1e-5 * ramp), machine, CONTROLS['sinumerik'],
                         ORIGIN)
    # Z carries the tool and nothing else: a pitch of Z over no tool does nothing; yaw of X acts over half of Y.
    assert found.not_carried['EAZ'] == pytest.approx(0.0, abs=1e-12)
    assert found.not_carried['ECX'] == pytest.approx(1e-5 * 0.15, rel=1e-6)
    assert found.not_carried['EXX'] == pytest.approx(0.0, abs=1e-12)
    # Left is the yaw less that in the middle, over all of Y: 0 less half the ramp at one end, the ramp less its half at
    # the other, equally large.  A value of it is known to 5 · 20 nrad (one standard uncertainty), the first exactly.
    one = 2.0 * 1e-7 * 0.3
    assert any(found.not_carried_spread['ECX'] == pytest.approx(spread, rel=1e-6) for spread in (one, one * 2.0**0.5))


def test_the_place_of_the_volume_must_be_known():
    with pytest.raises(StepdiagError, match='--origin'):
        compensation(made(1), machine_of(), CONTROLS['linuxcnc'])


def test_open_directions_are_refused_with_the_run_that_settles_them_or_left_out():
    solution = made(3, knots=5)
    open_ = Unidentifiable(('EYY slope', 'ppp laser u'), 'the readings depend on their combination only')
    solution = Solution(solution.method, solution.positions, solution.names, solution.value, solution.covariance,
                        unidentifiable=(open_,))
    refused = compensation(solution, machine_of(), CONTROLS['linuxcnc'], ORIGIN)
    assert refused.files == {}
    assert any('EYY' in reason and 'lin_y' in reason and '--partial' in reason for reason in refused.refusals)
    partial = compensation(solution, machine_of(), CONTROLS['linuxcnc'], ORIGIN, partial=True)
    assert partial.refusals == () and 'y.comp' not in partial.files and 'x.comp' in partial.files


def test_errors_known_worse_than_they_are_large_make_no_table():
    ramp = np.linspace(0.0, 1.0, 9)
    found = compensation(only(sigma=8e-6, EXX=5e-6 * ramp), machine_of(), CONTROLS['sinumerik'], ORIGIN)
    assert any('is known to U' in reason for reason in found.refusals)


def test_lengths_that_are_not_metres_make_no_table():
    found = compensation(made(1), machine_of(), CONTROLS['isg'], ORIGIN, air='not corrected for air')
    assert found.refusals == ('not corrected for air',) and found.files == {}


@pytest.mark.parametrize('status', ['not converged: its steps came to no end',
                                    'not ok: the residuals are 9 times as large as the noise (reduced χ² 81)'])
def test_an_evaluation_that_describes_no_machine_makes_no_table(status):
    found = compensation(replace(made(1), status=status), machine_of(), CONTROLS['isg'], ORIGIN)
    assert found.files == {} and any(status in reason for reason in found.refusals)
    # A log that merely lacks something says so, and U says how much it lacks.
    assert compensation(replace(made(1), status='not ok: no tilts in setup ppp'), machine_of(), CONTROLS['isg'],
                        ORIGIN).files


@pytest.mark.parametrize('kind', some('isg', later=CONTROLS))
def test_on_top_of_what_the_control_applies(kind):
    """Measured with tables in force: the sum is written, the change is what was measured, the way back is there."""
    machine, control = machine_of(), CONTROLS[kind]
    first = compensation(made(21, sigma=5e-7), machine, control, ORIGIN).checked()
    second = made(22, sigma=5e-7)
    found = compensation(second, machine, control, ORIGIN, present=first.files).checked()
    target = found.after.points
    was = APPLIED[kind](first.files, target, 1, machine=machine) - target
    both = APPLIED[kind](found.files, target, 1, machine=machine) - target
    left = off(second, machine, target, target + both - was)
    assert found.after.deviation_m == pytest.approx(left, abs=2 * ROUNDING_M)
    for name, text in first.files.items():
        assert found.before_files[f'before/{name}'] == text
    back = {name.removeprefix('before/'): text for name, text in first.before_files.items()}
    assert APPLIED[kind](back, target, 1, machine=machine) == pytest.approx(target, abs=1e-12)


def loaded(memory: dict[str, str], files) -> dict[str, str]:
    """A Sinumerik's variables after loading files over what is there: what no file names stays."""
    named = [re.fullmatch(r'(\$[^=]+)=(.*)', line) for text in files.values() for line in text.splitlines()]
    return memory | {match[1]: match[2] for match in named if match}


def acting(memory: dict[str, str]) -> dict[str, str]:
    """The variables as the files that the independent reader of these tests takes."""
    lines = [f'{name}={value}' for name, value in memory.items()]
    return {'cec.mpf': '\n'.join(lines), **{f'{axis}_eec.mpf': '\n'.join(lines) for axis in 'xyz'}}


def test_a_sinumerik_keeps_no_table_that_is_no_longer_wanted():
    """Loading clears nothing.  A table of another number, and those of a reversal that the files before did not have,
    are zero afterwards, and zero again or as they were on the way back; files of other names too."""
    machine, control = machine_of(), CONTROLS['sinumerik']
    apply = APPLIED['sinumerik']
    ramp = np.linspace(0.0, 1.0, 9)
    old = compensation(only(EYX=1e-5 * ramp, EXX=6e-6 * ramp), machine, control, ORIGIN).checked().files
    old = {'all.mpf': '\n'.join(re.sub(r'(CEC\w*\[)0', r'\g<1>10', text) for text in old.values())}
    found = compensation(made(22, sigma=2e-7), machine, control, ORIGIN, present=old,
                         reversal={'Z': (-3e-6, 1e-8)}).checked()
    target = found.after.points
    held = loaded({}, old)
    now = loaded(held, found.files)
    for way in (1, -1):
        alone = apply(acting(loaded({}, found.files)), target, way)
        assert apply(acting(now), target, way) == pytest.approx(alone, abs=1e-12)
        back = loaded(now, found.before_files)
        assert apply(acting(back), target, way) == pytest.approx(apply(acting(held), target, way), abs=1e-12)
    assert found.before_files['before/all.mpf'] == old['all.mpf']
    # From a control that held nothing: nothing acts after the way back, reversal included.
    first = compensation(made(22, sigma=2e-7), machine, control, ORIGIN, reversal={'Z': (-3e-6, 1e-8)}).checked()
    gone = loaded(loaded({}, first.files), first.before_files)
    for way in (1, -1):
        assert apply(acting(gone), target, way) == pytest.approx(target, abs=1e-12)


def test_tables_of_axes_that_were_not_measured_stay_in_force():
    """A .CMA names what is in force: one of X alone would switch the tables of Y and Z off."""
    machine, control = machine_of(), CONTROLS['heidenhain']
    first = compensation(made(21, sigma=2e-7), machine, control, ORIGIN).checked()
    every = made(22, sigma=2e-7)
    alone = without(every, tuple(name for name, _ in every.names if name[2] != 'X'))
    found = compensation(alone, machine, control, ORIGIN, present=first.files).checked()
    assert all(f'{axis}_AXIS' in found.files['CONFIG.CMA'] for axis in 'XYZ')
    was, now = (control.read(files, found.place) for files in (first.files, found.files))
    for name in ('EXY', 'EYY', 'EZZ'):
        assert now[name].forward == pytest.approx(was[name].forward, abs=1e-9)


@pytest.mark.parametrize('kind', some(
    'linuxcnc', later=['linuxcnc-volume', 'linuxcnc-matrix', 'sinumerik', 'heidenhain']))
def test_reversal_goes_into_both_directions(kind):
    machine, solution = machine_of(), made(7, sigma=2e-7, knots=5)
    lost = 6e-6
    found = compensation(solution, machine, CONTROLS[kind], ORIGIN, reversal={'Y': (lost, 1e-6)}).checked()
    without = compensation(solution, machine, CONTROLS[kind], ORIGIN).checked()
    target = grid(4)
    for direction in (1, -1):
        extra = np.subtract(*(APPLIED[kind](tables.files, target, direction, machine=machine)
                              for tables in (found, without)))
        # The axis stops half the lost motion short of where it goes, so it is sent that much further.
        assert extra[:, 1] == pytest.approx(direction * lost / 2, abs=ROUNDING_M)
        assert extra[:, [0, 2]] == pytest.approx(0.0, abs=ROUNDING_M)
    small = compensation(solution, machine, CONTROLS[kind], ORIGIN, reversal={'Y': (lost, 7e-6)})
    assert small.files == without.files


def test_a_place_outside_the_volume_is_refused():
    with pytest.raises(StepdiagError, match='reference line lies at Y'):
        functional_point(machine_of(), line=np.array([0.1, 0.31, 0.0]))
