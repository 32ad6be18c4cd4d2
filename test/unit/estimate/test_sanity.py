"""Mistakes of commissioning: each is made in a healthy log and must be named; healthy logs show none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.noise import arrivals
from stepdiag_ros.estimate.planned import filled, observe, planned_table
from stepdiag_ros.estimate.sanity import ACROSS, SCALE, check_readings, gradient
from stepdiag_ros.estimate.sanity_fit import check, mistakes
from stepdiag_ros.model.path import setup_direction
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log

ROOT = Path(__file__).resolve().parents[3]
STEPS = 3


@pytest.fixture
def healthy(plan_of, draw_errors, misaligned):
    """``make(size)``: description and stops of a machine with noise, misalignments up to ``size`` [rad]."""
    def make(size=3e-4, steps=STEPS, seed=5):
        description = plan_of(steps=steps)
        rng = np.random.default_rng(seed)
        table = planned_table(description)
        numbers, shift = arrivals(table), np.empty((len(table), 3))
        for axis in range(3):
            _, own = np.unique(numbers[:, axis], return_inverse=True)
            shift[:, axis] = rng.normal(0.0, 3e-7, own.max() + 1)[np.ravel(own)]
        readings = observe(description, table, draw_errors(description.machine, steps, framed=False),
                           misaligned(description, size), shift=shift, turn=rng.normal(0.0, 2e-7, (len(table), 3)))
        readings += rng.normal(0.0, 1.0, readings.shape) * np.array([5e-10, 2e-8, 2e-8])
        scatter = {'displacement_scatter': np.full((len(table), 1), 5e-9),
                   'spot_scatter': np.full((len(table), 2), 2e-7)}
        return description, replace(filled(table, readings), **scatter)
    return make


def with_rows(table, column, setup, change):
    """The table with ``change(values)`` for a column's rows of one setup (None: of all)."""
    rows = np.ones(len(table), bool) if setup is None else table.setup == table.setup_names.index(setup)
    values = getattr(table, column).copy()
    values[rows] = change(values[rows])
    return replace(table, **{column: values})


def with_setup(description, name, **changed):
    return replace(description, setups={**description.setups, name: replace(description.setups[name], **changed)})


def exchanged(table, one, other):
    """The table with the names of two setups exchanged."""
    names = {one: other, other: one}
    return replace(table, setup_names=tuple(names.get(name, name) for name in table.setup_names))


@pytest.mark.parametrize('size', [3e-4, 1e-3, 5e-3])
def test_a_healthy_log_shows_no_mistake(healthy, size):
    description, table = healthy(size)
    assert check_readings(description, table) == []


def test_a_healthy_logs_gradient_is_far_from_the_limits(healthy):
    description, table = healthy(1e-3)
    for number, name in enumerate(table.setup_names):
        seen = gradient(table, np.flatnonzero(table.setup == number))
        moved = np.isfinite(seen)
        nominal = setup_direction(description.machine, name)[moved]
        scale = seen[moved] @ nominal / (nominal @ nominal)
        assert abs(scale - 1.0) < SCALE / 20.0
        assert np.linalg.norm(seen[moved] - scale * nominal) < ACROSS / 20.0


@pytest.mark.parametrize(('factor', 'name', 'words'), [
    (-1.0, 'sign', 'turn the sign'), (0.5, 'unit', 'half'), (2.0, 'unit', 'twice'), (1e3, 'unit', 'in mm'),
    (-1e3, 'unit', 'backwards'), (1e6, 'unit', 'in µm'), (1.03, 'scale', 'wavelength'), (1e-3, 'unit', 'thousandth')])
def test_a_wrong_factor_is_named(healthy, factor, name, words):
    description, table = healthy()
    [finding] = check_readings(description, with_rows(table, 'displacement', None, lambda v: v * factor))
    assert finding.name == name and words in str(finding)
    assert '7 of 7 setups' in finding.found


def test_a_beam_that_does_not_follow_is_named(healthy):
    description, table = healthy()
    rng = np.random.default_rng(1)
    [finding] = check_readings(description, with_rows(
        table, 'displacement', 'pnp', lambda v: rng.normal(0.0, 1e-7, v.shape)))
    assert finding.name == 'still' and 'pnp' in finding.found


def test_a_base_unit_along_another_diagonal_is_named(healthy):
    description, table = healthy()
    source = table.commanded[table.setup == table.setup_names.index('ppp')]
    other = setup_direction(description.machine, 'npp')
    along = (source - source[0]) @ other
    [finding] = check_readings(description, with_rows(table, 'displacement', 'ppp', lambda v: along[:, None]))
    assert finding.name == 'setup name' and 'npp' in finding.found


def test_a_diagonal_under_anothers_name_is_named(healthy):
    description, table = healthy()
    found = check_readings(description, exchanged(table, 'ppp', 'nnp'))
    assert [f.name for f in found] == ['setup name', 'setup name']
    assert 'setup nnp' in found[0].found and 'diagonal ppp' in found[0].found


def test_another_order_of_the_axes_is_named(healthy):
    description, table = healthy()
    other = replace(description, plan=replace(description.plan, order='ZYX'))
    [finding] = check_readings(other, table)
    assert finding.name == 'order' and finding.change == 'set plan.order: XYZ'


def test_another_order_than_was_recorded_is_named(healthy, draw_errors):
    """The machine moved Z, Y, X; the log says X, Y, Z: readings of the one at the positions of the other."""
    description, table = healthy()
    other = replace(description, plan=replace(description.plan, order='ZYX'))
    moved = planned_table(other)
    readings = observe(other, moved, draw_errors(description.machine, STEPS))
    [finding] = check_readings(description, filled(table, readings))
    assert finding.name == 'order' and 'ZYX' in str(finding)


@pytest.mark.parametrize('axes', ['Y', 'Z', 'XY'])
def test_axes_that_run_backwards_are_named(healthy, axes):
    description, table = healthy()
    sign = np.where([letter in axes for letter in 'XYZ'], -1.0, 1.0)
    [finding] = check_readings(description, with_rows(table, 'commanded', None, lambda v: v * sign))
    assert finding.name == 'axis backwards' and f'commanded {" and ".join(axes)}:' in finding.change


def test_a_single_run_that_reads_otherwise_is_named(healthy):
    """Turned in one run of two, readings seemed to be half of what the machine moved."""
    description, table = healthy()
    run = int(table.run[np.flatnonzero(table.setup == table.setup_names.index('pnp'))[0]])
    values = np.where((table.run == run)[:, None], -table.displacement, table.displacement)
    [finding] = check_readings(description, replace(table, displacement=values))
    assert finding.name == 'sign' and finding.found.startswith(f'run {table.run_ids[run]}: ')


def test_another_number_of_steps_is_named(healthy):
    description, table = healthy()
    [finding] = check_readings(replace(description, plan=replace(description.plan, steps=STEPS + 1)), table)
    assert finding.name == 'steps' and finding.change == f'set plan.steps: {STEPS}'


def test_exchanged_axes_are_named(healthy):
    description, table = healthy()
    d = setup_direction(description.machine, 'ppp')[[1, 0, 2]]
    source = table.commanded[table.setup == table.setup_names.index('ppp')]
    [finding] = check_readings(description, with_rows(
        table, 'displacement', 'ppp', lambda v: ((source - source[0]) @ d)[:, None]))
    assert finding.name == 'axes' and 'YXZ' in finding.found


def test_a_volume_that_the_stops_do_not_span_is_named(healthy):
    description, table = healthy()
    wrong = replace(description, machine=replace(description.machine, volume=(0.8, 0.6, 0.4)))
    [finding] = check_readings(wrong, table)
    assert finding.name == 'volume' and 'set machine.volume: [0.8, 0.6, 0.5]' in finding.change


def test_linear_setups_under_each_others_name_are_named(healthy):
    description, table = healthy()
    found = check_readings(description, exchanged(table, 'lin_x', 'lin_y'))
    assert {f.name for f in found} == {'axis'}


@pytest.mark.parametrize(('factor', 'unit'), [(1e3, 'mm'), (1e6, 'µm')])
def test_spots_in_another_unit_are_named(healthy, factor, unit):
    description, table = healthy(3e-3)
    [finding] = check_readings(description, with_rows(table, 'spot', None, lambda v: v * factor))
    assert finding.name == 'spot unit' and f'in {unit};' in finding.change


def test_a_dead_channel_of_the_detector_is_named(healthy):
    description, table = healthy()
    [finding] = check_readings(description, with_rows(table, 'spot', None, lambda v: v * [1.0, 0.0]))
    assert finding.name == 'spot still' and 'y is' in finding.found


@pytest.mark.parametrize(('name', 'turned'), [
    ('psd x', ((-1, 0), (0, 1))), ('psd y', ((1, 0), (0, -1))), ('psd swapped', ((0, 1), (1, 0))),
    ('psd turned', ((0, -1), (1, 0)))])
def test_a_detector_mounted_wrongly_is_named(healthy, name, turned):
    description, table = healthy()
    wrong = with_rows(table, 'spot', None, lambda v: v @ np.array(turned, float).T)
    [finding] = check(description, wrong)
    assert finding.name == name and 'reduced χ² falls from' in finding.found


def test_spots_many_times_too_large_are_named(healthy):
    description, table = healthy()
    [finding] = check(description, with_rows(table, 'spot', None, lambda v: 10.0 * v))
    assert finding.name == 'psd scale'
    assert float(finding.found.split('some ')[1].split(' ')[0]) == pytest.approx(10.0, rel=0.4)


def test_a_detector_with_both_signs_turned_is_another_machine(healthy):
    """No log contradicts it: other angles, taken up by positioning and straightness."""
    description, table = healthy()
    wrong = with_rows(table, 'spot', None, lambda v: -v)
    assert fit(description, wrong).chi2 < 2.0 * fit(description, table).chi2


@pytest.mark.parametrize(('name', 'turned'), [('psd y', ((1, 0), (0, -1))), ('psd swapped', ((0, 1), (1, 0)))])
def test_a_detector_mounted_wrongly_in_one_setup_is_named(healthy, name, turned):
    description, table = healthy()
    [finding] = check(description, with_rows(table, 'spot', 'pnp', lambda v: v @ np.array(turned, float).T))
    assert finding.name == name and finding.found.startswith('psd/spot of setup pnp')


@pytest.mark.parametrize('scale', [2.0, 3.0])
def test_spots_of_another_scale_in_one_setup_are_named(healthy, scale):
    """A gain of 2 was `ambient_light`, at 1.0."""
    description, table = healthy()
    [finding] = check(description, with_rows(table, 'spot', 'pnp', lambda v: scale * v))
    assert finding.name == 'psd scale' and finding.found.startswith('psd/spot of setup pnp')
    assert float(finding.found.split('some ')[1].split(' ')[0]) == pytest.approx(scale, rel=0.2)


def test_a_wrong_standoff_is_named(healthy):
    description, table = healthy()
    wrong = with_setup(description, 'npp', standoff=0.65)
    [finding] = check(wrong, table)
    assert finding.name == 'standoff' and 'setups.npp.standoff' in finding.change
    assert float(finding.found.split('they fit ')[1].split(' ')[0]) == pytest.approx(0.35, abs=2e-3)


def test_standoffs_that_were_all_measured_from_elsewhere_are_named(healthy):
    description, table = healthy()
    wrong = replace(description, setups={name: replace(setup, standoff=setup.standoff - 0.05)
                                         for name, setup in description.setups.items()})
    [finding] = check(wrong, table)
    assert finding.name == 'standoff' and 'setups.*.standoff' in finding.change
    assert float(finding.found.split('and ')[1].split(' ')[0]) == pytest.approx(0.05, abs=2e-3)


@pytest.mark.parametrize(('where', 'wrong'), [
    ('machine.tool', lambda d: replace(d, machine=replace(d.machine, tool=(0.0, 0.0, -150.0)))),
    ('setups.npp.standoff', lambda d: with_setup(d, 'npp', standoff=350.0)),
    ('setups.npp.psd_offset', lambda d: with_setup(d, 'npp', psd_offset=(20.0, 0.0)))])
def test_lengths_of_the_cell_in_millimetres_are_named(healthy, where, wrong):
    description, table = healthy()
    [finding] = check_readings(wrong(description), table)
    assert finding.name == 'unit of the cell' and finding.found.startswith(where) and 'metres' in finding.change


def test_positions_with_a_work_offset_are_named(healthy):
    description, table = healthy()
    [finding] = check_readings(description, with_rows(table, 'commanded', None, lambda v: v + [0.2, 0.0, -0.3]))
    assert finding.name == 'origin' and '(200.000, 0.000, -300.000) mm' in finding.found


@pytest.mark.parametrize(('late_s', 'named'), [(0.01, False), (0.04, True), (-0.04, True), (0.4, True)])
def test_stamps_that_are_off_by_more_than_a_part_of_a_dwell_are_named(late_s, named):
    """They made scales of 0.9 to 1.8 and diagonals of other directions; a clock that is less off is diagnosed."""
    log = simulate_log(load_cell(ROOT / 'cells' / 'demo.yaml'), setups=('ppp', 'lin_x'), rate=500.0)
    late = replace(log.displacement, time_ns=log.displacement.time_ns + round(late_s * 1e9))
    found = mistakes(replace(log, displacement=late))
    assert [finding.name for finding in found] == (['clock'] if named else [])


def test_runs_under_one_direction_repeat_only_those_of_their_own_order(healthy):
    """Called +1 alike, runs forward and backward were taken for repeats: half the volume for noise, and all was ok."""
    description, table = healthy()
    known = fit(description, table)
    named = fit(description, with_rows(table, 'direction', None, np.ones_like))
    assert named.noise.position == pytest.approx(known.noise.position, rel=0.1)


def test_a_solution_of_a_healthy_log_is_ok(healthy):
    description, table = healthy()
    solution = solution_of(fit(description, table), table)
    assert solution.status == 'ok' and solution.to_json_dict()['sanity'] == []
