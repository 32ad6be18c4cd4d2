"""The cells of the table of where and how against worlds in which something acts there: an independent way to their
columns."""

import numpy as np
import pytest
from scipy.signal import lfilter

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.tuning import tune
from stepdiag_ros.gap.alternatives.where_and_how import _behind, table_families
from stepdiag_ros.gap.preprocess.observe import observe
from stepdiag_ros.model.machine import carried
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

TRAVEL = np.array([0.5, 0.4, 0.3])


class TiltingFloor(Effect):
    """The laser tilts as the table moves away."""

    name, family = 'tilting_floor', 'place'

    def before_light(self, moment):
        moment.laser = moment.laser + 2e-5 * (moment.commanded[:, [0]] / TRAVEL[0])**2 * np.array([0.6, 0.8])


class Climbing(Effect):
    """A carriage climbs on another flank one way."""

    name, family = 'climbing', 'direction'

    def before_pose(self, moment):
        place = moment.commanded[:, 1] / TRAVEL[1]
        moment.shift = moment.shift + (5e-6 * (moment.approach[:, 1] < 0.0) * place * (1.0 - place))[:, None] \
            * np.array([0.0, 0.0, 1.0])


class Sinking(Effect):
    """Z sinks while others move."""

    name, family = 'sinking', 'history'

    def before_pose(self, moment):
        rested = np.where(moment.moved < 3, (moment.moved - 2) % 3, 0)
        moment.position = moment.position - 4e-6 * rested[:, None] * np.array([0.0, 0.0, 1.0])


class WarmScrew(Effect):
    """The middle of X's screw warms."""

    name, family = 'warm_screw', 'shape'

    def before_pose(self, moment):
        place = moment.commanded[:, 0] / TRAVEL[0]
        grown = 1.0 - np.exp(-moment.seconds / 500.0)
        moment.position = moment.position + (8e-6 * grown * np.sin(np.pi * place))[:, None] * np.array([1.0, 0.0, 0.0])


class Twisting(Effect):
    """Y's guideway twists with time."""

    name, family = 'twisting', 'shape'

    def before_pose(self, moment):
        machine, turns = moment.description.machine, np.zeros((3, len(moment.seconds), 3))
        turns[1, :, 1] = 2e-5 * moment.seconds / 1000.0 * moment.commanded[:, 1] / TRAVEL[1]
        moment.shift = moment.shift + carried(machine.chain, moment.commanded, 0.0 * turns, turns, machine.tool)
        moment.turn = moment.turn + turns[1]


class Nodding(Effect):
    """The machine sinks on one of its feet."""

    name, family = 'nodding', 'time'

    def before_pose(self, moment):
        turn = np.outer(2e-5 * (1.0 - np.exp(-moment.seconds / 400.0)), [0.6, 0.8, 0.0])
        moment.turn = moment.turn + turn
        moment.shift = moment.shift + np.cross(turn, moment.commanded + moment.description.machine.tool - TRAVEL)


class Rubber(Effect):
    """Each move rocks the machine on feet of rubber."""

    name, family = 'rubber', 'history'

    def before_pose(self, moment):
        along = np.where(moment.moved[:, None] == np.arange(3), moment.approach * [1.0, 0.7, 0.0], 0.0)
        turn = 2e-5 * np.exp(-np.maximum(moment.since_arrival, 0.0) / 1.3)[:, None] * np.cross([0.0, 0.0, 1.0], along)
        moment.turn = moment.turn + turn
        moment.shift = moment.shift + np.cross(turn, moment.commanded + moment.description.machine.tool - TRAVEL)


class Cage(Effect):
    """The rollers of X stand otherwise in each run."""

    name, family, begins = 'cage', 'shape', ()

    def before_pose(self, moment):
        machine, turns = moment.description.machine, np.zeros((3, len(moment.seconds), 3))
        run = np.searchsorted(self.begins, moment.seconds, side='right')
        turns[0, :, 1] = 2e-5 * np.cos(2.4 * run) * np.cos(np.pi * moment.commanded[:, 0] / TRAVEL[0])
        moment.shift = moment.shift + carried(machine.chain, moment.commanded, 0.0 * turns, turns, machine.tool)
        moment.turn = moment.turn + turns[0]


class Ghost(Effect):
    """Light from the back of a window runs beside the beam."""

    name, family = 'ghost', 'fringes'

    def after_light(self, moment):
        swing = np.sin(2.0 * np.pi * (moment.spot @ (np.cos(np.pi / 4), np.sin(np.pi / 4))) / 4.1e-4 + 0.7)
        moment.spot = moment.spot + 5e-6 * swing[:, None] * np.array([0.3, 0.9])


class Sagging(Effect):
    """The beam sags with the square of its way."""

    name, family = 'sagging', 'distance'

    def after_light(self, moment):
        moment.spot = moment.spot + 2e-5 * moment.length[:, :1]**2 * np.array([0.6, 0.8])


@pytest.fixture(scope='module')
def still(case):
    """The quiet cell in which nothing acts, as the diagnosis sees it, and the table's forms for it."""
    cell = parse_cell(case.quiet)
    view = observe(simulate_log(cell)).view
    return cell, view, table_families(view)


@pytest.mark.parametrize('kind', some(
    TiltingFloor, Climbing, Sinking, WarmScrew, Nodding, Ghost, Sagging, later=[Twisting, Rubber, Cage]))
def test_what_acts_in_a_cell_does_what_its_form_does(still, kind):
    cell, view, families = still
    effect = kind()
    effect.begins = [view.elapsed[view.run == run].min() for run in np.unique(view.run)]
    moved = observe(simulate_log(cell, effects=[effect])).view.reading - view.reading
    # Free is what a run's reset takes away, how the axes came to its first stop, how each setup is aligned; and what
    # acts in one direction alone is half a bow of the guideway.
    runs, setups = (np.array([each == k for k in np.unique(each)]) for each in (view.run, view.setup))
    beams, place = np.arange(view.reading.shape[1]) < view.beams, view.commanded[:, 1] / TRAVEL[1]
    free = [runs[:, :, None] * beams, (setups[:, None, :, None] * view.by_laser).reshape(-1, *view.reading.shape)]
    if kind.family == 'direction':
        free.append(((place * (1.0 - place))[:, None] * view.by_shift[2])[None])
    if kind.family == 'history':
        first = (runs & (view.axis > 2))[:, None, :, None]
        free.append((first * np.eye(view.reading.shape[1])[:, None]).reshape(-1, *view.reading.shape))
    resets = np.concatenate(free)
    least = np.inf
    for form in families[kind.family]:
        tried = form if form.retune is None else _tuned(form, moved, resets)
        least = min(least, _left(tried, moved, resets))
    assert least < 0.03


def _left(form, moved, resets):
    """Share of what moved that a form leaves."""
    free = resets.reshape(len(resets), -1).T
    mine = np.asarray(form.columns).reshape(len(form.names), -1).T * form.scale
    columns = np.concatenate([mine, 1e-6 * free], axis=1)
    data = moved.ravel()
    whole = data - free @ np.linalg.lstsq(free, data, rcond=None)[0]
    rest = data - columns @ np.linalg.lstsq(columns, data, rcond=1e-12)[0]
    return np.linalg.norm(rest) / np.linalg.norm(whole)


def _tuned(form, moved, resets):
    return tune(form, lambda tried: -_left(tried, moved, resets), within=1.3, close=0.01)


@pytest.mark.parametrize('tau', [3.0, 60.0])
def test_what_follows_slowly_is_behind_by_what_its_equation_says(case, tau):
    """Places that are taken half-way between two stops, followed in small steps of time."""
    view = case.observe().view
    order = np.argsort(view.time, kind='stable')
    times, places = view.time[order], view.commanded[order, 0]
    half, fine = 0.5 * (times[1:] + times[:-1]), np.linspace(times[0], times[-1], 400_000)
    target, step = places[np.searchsorted(half, fine)], fine[1] - fine[0]
    bent = lfilter([step / tau], [1.0, step / tau - 1.0], target, zi=[(1.0 - step / tau) * target[0]])[0]
    expected = np.interp(times, fine, bent) - places
    assert _behind(view, view.commanded[:, [0]], tau)[order, 0] == pytest.approx(expected, abs=0.01 * np.ptp(places))


def test_cells_that_a_name_has_are_not_in_the_table(case):
    """A shift of an axis by its own direction is its backlash."""
    view = case.observe().view
    labels = [form.label for form in table_families(view)['direction']]
    for letter in 'XYZ':
        assert any(label.startswith(f'{letter}: shifted by the direction of') for label in labels)
        assert not any(label.startswith(f'{letter}: shifted by the direction of {letter}') for label in labels)


def test_on_one_line_a_length_that_follows_the_direction_is_backlash(case):
    """A real stage's reversal error of 50 µm was an error of the length, or what follows the last move, as likely as
    backlash: where the laser looks along the one axis that moves the three are one thing, and it has a name."""
    begin, end = case.quiet.index('  ppp:'), case.quiet.index('  lin_x:')
    text = case.quiet[:begin] + case.quiet[end:]
    line = '\n'.join(row for row in text.split('\n') if not row.startswith(('  lin_y:', '  lin_z:')))
    labels = {name: {form.label for forms in table_families(observe(simulate_log(parse_cell(of))).view).values()
                     for form in forms} for name, of in (('line', line), ('all', case.quiet))}
    for same in ('displacement: off by the direction of X', 'X: shifted by which axis moved last'):
        assert same in labels['all'] and same not in labels['line']
    assert 'spot: off by the direction of X' in labels['line']
