"""The one machine: pose, repeatability, air, effects."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.machine import tool_pose
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.sensor import measure
from stepdiag_ros.virtual.acting import ALLOWED
from stepdiag_ros.virtual.cell import Air, Cell, parse_cell
from stepdiag_ros.virtual.history import History
from stepdiag_ros.virtual.offline import START_NS, execute
from stepdiag_ros.virtual.world import World

TEXT = """\
seed: 11
machine: {name: small, volume: [0.2, 0.16, 0.12], tool: [0.01, 0.0, -0.1]}
plan: {steps: 3, repeats: 2}
setups:
  ppp: {standoff: 0.2, psd_offset: [0.02, 0.0], beams: [[0, 0], [0.02, 0], [0, 0.02]]}
  nnp: {standoff: 0.2, psd_offset: [0.02, 0.0]}
misalignments: {drawn: {laser: 3e-4, mirror: 2e-4}}
"""
QUIET = Noise(0.0, 0.0, 0.0, 0.0)


def cell_of(noise: Noise | None = None, **changes) -> Cell:
    cell = parse_cell(TEXT)
    if noise is not None:
        cell = replace(cell, description=replace(cell.description, noise=noise))
    return replace(cell, **changes)


def ran(cell):
    history = History()
    runs = execute(cell, history, START_NS, cell.setup_names)
    return World(cell, history, START_NS), runs


def test_a_quiet_machine_at_rest_is_the_contract_s():
    cell = cell_of(QUIET)
    world, runs = ran(cell)
    for run in runs:
        positions = np.array([visit.position for visit in run.traverse.visits])
        pose = tool_pose(cell.geometry, positions, np.array(cell.description.machine.tool))
        setup = cell.description.setups[run.setup]
        length, spot = measure(cell.description.machine, setup, cell.misalignments[run.setup], *pose)
        reading = world.read(run.done_ns, run.setup)
        # What is left of the servo's creep after a whole dwell is far below a picometre.
        np.testing.assert_allclose(reading.length, length, rtol=0, atol=1e-12)
        np.testing.assert_allclose(reading.spot, spot, rtol=0, atol=1e-12)


def test_repeatability_stays_until_the_axis_moves_again():
    noise = Noise(0.0, 0.0, 1e-6, 0.0)
    world, runs = ran(cell_of(noise))
    run = runs[0]
    path = stops(world.cell.description, run.setup)
    moment, _ = world.moment(run.done_ns, run.setup)
    error = moment.position - path.positions
    for stop in range(1, len(path)):
        moved = error[stop] != error[stop - 1]
        changed = np.abs(error[stop] - error[stop - 1]) > 1e-12
        assert moved[path.axis[stop]]
        assert np.flatnonzero(changed).tolist() == [path.axis[stop]]
    assert 3e-7 < error.std() < 3e-6


def test_angle_repeatability_is_new_at_each_arrival_and_turns_only():
    noise = Noise(0.0, 0.0, 0.0, 1e-6)
    world, runs = ran(cell_of(noise))
    quiet, _ = ran(cell_of(QUIET))
    times = np.concatenate([run.done_ns for run in runs])
    point, attitude = world.pose(*world.moment(times, 'ppp'))
    still, straight = quiet.pose(*quiet.moment(times, 'ppp'))
    np.testing.assert_array_equal(point, still)
    turn = np.stack([(attitude - straight)[:, 2, 1], (attitude - straight)[:, 0, 2],
                     (attitude - straight)[:, 1, 0]], axis=1)
    # A run back begins where the one there ended: nothing has moved, nothing has turned.
    stands = np.zeros(len(times), bool)
    stands[np.cumsum([len(run.done_ns) for run in runs[:-1]])] = [
        before.setup == after.setup for before, after in pairwise(runs)]
    changes = np.abs(np.diff(turn, axis=0))
    assert stands.any() and np.all(changes[stands[1:]] == 0.0) and np.all(changes[~stands[1:]] > 0.0)
    np.testing.assert_allclose(turn.std(axis=0), 1e-6, rtol=0.4)


def test_the_world_does_not_depend_on_who_asks_when():
    world, runs = ran(cell_of())
    times = np.sort(np.concatenate([run.dwell_ns for run in runs]))
    whole = world.read(times, 'ppp').length
    again, _ = ran(cell_of())
    pieces = [again.read(part, 'ppp').length for part in np.array_split(times[::-1], 7)]
    np.testing.assert_array_equal(np.concatenate(pieces)[::-1], whole)


def test_a_growing_history_changes_nothing_that_was():
    cell = cell_of()
    full, _ = ran(cell)
    history = History()
    world = World(cell, history, START_NS)
    for record in full.history.records:
        history._store(record)
        now = np.array([record['start_ns'] + 1_000_000])
        np.testing.assert_array_equal(world.read(now, 'ppp').length, full.read(now, 'ppp').length)


def test_air_that_is_divided_out_and_air_that_is_not():
    vacuum = cell_of(QUIET, air=Air(compensated=False, temperature_drift=100.0))
    divided = cell_of(QUIET, air=Air(compensated=True, temperature_drift=100.0))
    (a, runs), (b, _) = ran(vacuum), ran(divided)
    times = runs[0].done_ns
    raw, clean = a.read(times, 'ppp'), b.read(times, 'ppp')
    assert np.all(raw.index == 1.0)
    assert np.all(np.abs(clean.index - 1.00027) < 2e-5) and np.ptp(clean.index) > 1e-8
    np.testing.assert_allclose(raw.length, clean.length * clean.index[:, None], rtol=1e-14)


def test_an_effect_acts():
    cell = cell_of(QUIET)
    world, runs = ran(cell)
    back = ran(replace(cell, effects={'backlash': {'B': [4e-6, 0.0, 0.0]}}))[0]
    run = next(r for r in runs if r.setup == 'ppp' and r.traverse.name == '+')
    change = back.read(run.done_ns[1:], 'ppp').length - world.read(run.done_ns[1:], 'ppp').length
    direction = np.array(cell.description.machine.volume) / np.linalg.norm(cell.description.machine.volume)
    np.testing.assert_allclose(change[:, 0], -2e-6 * direction[0], rtol=2e-3)


@pytest.mark.parametrize(('effects', 'words'), [
    ({'gremlins': {}}, 'no effect of this name'),
    ({'backlash': {'size': 1.0}}, 'unknown parameter size'),
    ({'mine': {'file': 'nowhere.py'}}, 'give --effect'),
])
def test_effects_that_cannot_be(effects, words):
    with pytest.raises(StepdiagError, match=words):
        World(cell_of(effects=effects), History(), START_NS)


def test_an_effect_of_one_s_own(tmp_path, monkeypatch):
    (tmp_path / 'mine.py').write_text("""
from stepdiag_ros.effects.base import Effect, Moment, Parameter

class Mine(Effect):
    name = 'mine'
    parameters = (Parameter('size', 'm', 0.0, 1.0),)

    def after_light(self, moment: Moment) -> None:
        moment.length = moment.length + self.size
        moment.quality = 0.0 * moment.quality + 50.0 + moment.rng.normals('q', 0, 1)[0, 0]
""")
    monkeypatch.setenv(ALLOWED, str(tmp_path / 'mine.py'))
    cell = replace(cell_of(QUIET), source=str(tmp_path / 'cell.yaml'),
                   effects={'mine': {'file': 'mine.py', 'size': 0.25}})
    world, runs = ran(cell)
    plain, _ = ran(cell_of(QUIET))
    times = runs[0].done_ns
    np.testing.assert_allclose(world.read(times, 'ppp').length - plain.read(times, 'ppp').length, 0.25)
    assert 40.0 < world.read(times, 'ppp').quality[0] < 60.0
