"""A log without sockets: events, samples and environment as the contract has them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.log import DONE, DWELL, MOVE, NONE
from stepdiag_ros.model.machine import tool_pose
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.sensor import measure
from stepdiag_ros.virtual.acting import ALLOWED
from stepdiag_ros.virtual.cell import load_cell
from stepdiag_ros.virtual.offline import simulate_log
from stepdiag_ros.virtual.truth import truth

DEMO = Path(__file__).resolve().parents[3] / 'cells' / 'demo.yaml'


@pytest.fixture(scope='module')
def cell():
    return load_cell(DEMO)


@pytest.fixture(scope='module')
def log(cell):
    return simulate_log(cell)


def test_events_run_through_the_plan(cell, log):
    steps, plan = log.steps, cell.description.plan
    assert steps.run_ids[:4] == ('ppp/0/+', 'ppp/0/-', 'ppp/1/+', 'ppp/1/-')
    assert len(steps.run_ids) == 2 * plan.repeats * len(cell.setup_names)
    assert np.all(np.diff(steps.time_ns) > 0)
    assert steps.phase.reshape(-1, 3).tolist() == [[MOVE, DWELL, DONE]] * (len(steps) // 3)
    for run in range(len(steps.run_ids)):
        mine = steps.run == run
        setup = steps.setup_names[steps.setup[mine][0]]
        path = stops(cell.description, setup)
        direction = int(steps.direction[mine][0])
        index = steps.index[mine][::3]
        assert index.tolist() == list(range(len(path)))[::direction]
        np.testing.assert_array_equal(steps.commanded[mine][::3], path.positions[index])
        axis = steps.axis[mine][::3]
        assert axis[0] == NONE
        moved = np.argmax(np.abs(np.diff(path.positions[index], axis=0)), axis=1)
        assert axis[1:].tolist() == moved.tolist()


def test_the_same_cell_gives_the_same_log_bit_by_bit(cell, log):
    again = simulate_log(load_cell(DEMO))
    np.testing.assert_array_equal(log.displacement.values, again.displacement.values)
    np.testing.assert_array_equal(log.spot.values, again.spot.values)
    np.testing.assert_array_equal(log.steps.time_ns, again.steps.time_ns)
    np.testing.assert_array_equal(log.environment['humidity'].value, again.environment['humidity'].value)
    other = simulate_log(replace(cell, seed=cell.seed + 1))
    assert not np.array_equal(log.displacement.values, other.displacement.values)


def test_samples_are_blocks_on_a_regular_grid(cell, log):
    samples = log.displacement
    per_block = round(cell.sampling.block * cell.sampling.interferometer)
    assert np.all(np.diff(samples.time_ns) > 0)
    assert np.all(np.diff(samples.block) >= 0)
    _, counts = np.unique(samples.block, return_counts=True)
    assert counts.max() == per_block
    same = np.diff(samples.block) == 0
    assert set(np.diff(samples.time_ns)[same].tolist()) == {1_000_000}
    assert samples.refractive_index.min() > 1.0002
    assert samples.health.min() > 50


def test_means_of_the_dwells_are_the_machine_s(cell):
    quiet = replace(cell, description=replace(cell.description, noise=Noise(0, 0, 0, 0)))
    log = simulate_log(quiet, in_motion=False)
    description = quiet.description
    for number, run_id in enumerate(log.steps.run_ids):
        setup, _, sign = run_id.split('/')
        path = stops(description, setup)
        order = path.positions[::1 if sign == '+' else -1]
        pose = tool_pose(quiet.geometry, order, np.array(description.machine.tool))
        length, spot = measure(description.machine, description.setups[setup],
                               quiet.misalignments[setup], *pose)
        events = log.steps.run == number
        begin = log.steps.time_ns[events & (log.steps.phase == DWELL)]
        end = log.steps.time_ns[events & (log.steps.phase == DONE)]
        for samples, expected, tolerance in ((log.displacement, length - length[0], 1e-8),
                                             (log.spot, spot, 1e-8)):
            for stop in range(len(path)):
                inside = (samples.time_ns >= begin[stop]) & (samples.time_ns < end[stop])
                assert inside.sum() >= 50
                np.testing.assert_allclose(samples.values[inside].mean(axis=0), expected[stop],
                                           rtol=0, atol=tolerance)


def test_noise_has_the_stated_size(cell, log):
    quiet = simulate_log(replace(cell, description=replace(
        cell.description, noise=replace(cell.description.noise, displacement=0.0, spot=0.0))))
    difference = log.displacement.values - quiet.displacement.values
    assert difference.std() == pytest.approx(cell.description.noise.displacement, rel=0.02)
    spots = log.spot.values - quiet.spot.values
    np.testing.assert_allclose(spots.std(axis=0), cell.description.noise.spot, rtol=0.02)


def test_dwell_only_logs_sample_nothing_in_motion(cell):
    log = simulate_log(cell, setups=('lin_x',), in_motion=False, rate=500.0)
    dwell = log.steps.time_ns[log.steps.phase == DWELL]
    done = log.steps.time_ns[log.steps.phase == DONE]
    time = log.displacement.time_ns
    stop = np.searchsorted(dwell, time, side='right') - 1
    assert np.all(time < done[stop])
    assert len(np.unique(stop)) == len(dwell) == 8
    assert log.steps.run_ids == ('lin_x/0/+', 'lin_x/0/-', 'lin_x/1/+', 'lin_x/1/-')


def test_environment_is_what_the_sensors_measure(cell, log):
    assert set(log.environment) == {'air_temperature', 'air_pressure', 'humidity'}
    temperature = log.environment['air_temperature']
    assert np.all(np.diff(temperature.time_ns) == 1_000_000_000)
    assert abs(temperature.value.mean() - cell.air.temperature) < 0.02
    blind = simulate_log(replace(cell, air=replace(cell.air, sensors=('scale',))), setups=('lin_x',))
    assert set(blind.environment) == {f'scale_temperature/{axis}' for axis in 'xyz'}


def test_a_clock_that_is_late_shifts_the_samples(cell, tmp_path, monkeypatch):
    (tmp_path / 'late.py').write_text("""
from stepdiag_ros.effects.base import Effect

class Late(Effect):
    name = 'late'

    def clock_offset(self, sensor):
        return 0.02 if sensor == 'psd' else 0.0
""")
    monkeypatch.setenv(ALLOWED, str(tmp_path / 'late.py'))
    late = replace(cell, source=str(tmp_path / 'c.yaml'), effects={'late': {'file': 'late.py'}})
    skewed, plain = (simulate_log(c, setups=('ppp',)) for c in (late, cell))
    np.testing.assert_array_equal(skewed.displacement.values, plain.displacement.values)
    # 20 ms are twenty samples: what was seen then is stamped now.
    run = 1500
    quiet = 12 * cell.description.noise.spot
    np.testing.assert_allclose(skewed.spot.values[20:run], plain.spot.values[:run - 20], atol=quiet)
    assert np.abs(skewed.spot.values[:run] - plain.spot.values[:run]).max() > quiet


def test_truth_holds_the_curves_at_the_plan_s_positions(cell):
    stated = truth(cell)
    assert stated['errors']['EXX']['position_m'] == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2])
    np.testing.assert_array_equal(stated['errors']['EXX']['value'], cell.geometry.curves['EXX'].value)
    assert stated['errors']['EC0Y']['value'] == cell.geometry.square['EC0Y']
    assert stated['misalignments']['npp']['laser_rad'] == list(cell.misalignments['npp'].laser)
