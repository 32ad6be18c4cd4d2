"""A beam that is held on the retroreflector, on a virtual clock: one plane of cells/held_beam.yaml without noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.estimate.held_beam import held_beams
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.description import Description, Noise
from stepdiag_ros.model.regulation import GAIN, PERIOD_S, sight, steering_frame
from stepdiag_ros.virtual.cell import load_cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log

FILE = Path(__file__).resolve().parents[3] / 'cells' / 'held_beam.yaml'
QUIET = Noise(0.0, 0.0, 0.0, 0.0)


def plane(**changes):
    """The cell's XY alone, one repeat, without noise."""
    cell = load_cell(FILE)
    description = cell.description
    setups = {'around_xy': replace(description.setups['around_xy'], repeats=1, **changes)}
    return replace(cell, description=replace(description, setups=setups, noise=QUIET))


@pytest.fixture(scope='module')
def held():
    return simulate_log(plane())


@pytest.fixture(scope='module')
def followed():
    return simulate_log(plane(regulated=False))


def test_the_beam_is_held_in_motion_and_at_rest(held):
    cell = plane()
    moving = simulate_log(cell, in_motion=True).spot.values
    # At the feed the beam trails by v·T/gain, doubled at the detector; the loop's gain is least where it is nearest.
    _, distance = sight(cell.description, 'around_xy')
    trail = 2.0 * 0.02 * PERIOD_S / (GAIN * distance.min() / distance.max())
    assert np.isfinite(moving).all() and 0.5 * trail < np.abs(moving).max() < 1.2 * trail
    # At rest it comes within the mirrors' smallest step.
    table = reduce_log(held)
    step = 2.0 * distance.max() * cell.instruments.detector.steering.step_rad
    ends = np.array([held.spot.values[last - 10:last] for _, last in table_rows(held, table)])
    assert np.abs(ends).max() < step


def table_rows(log, table):
    return np.stack([np.searchsorted(log.spot.time_ns, when) for when in (table.dwell_ns, table.done_ns)], axis=1)


def test_lengths_are_those_of_a_beam_that_meets_the_centre(held, followed):
    one, other = reduce_log(held), reduce_log(followed)
    away = one.displacement[:, 0] - other.displacement[:, 0]
    for run in np.unique(one.run):
        assert np.ptp(away[one.run == run]) < 1e-9
    # Not so without the spot: the cosine of what was missed.
    raw = [held.displacement.values[a:b, 0].mean() for a, b in one.displacement_rows]
    missed = np.array(raw) - other.displacement[:, 0]
    assert np.ptp(missed[one.run == 0]) > 5e-9


def test_a_dwell_without_light_is_left_out_and_said(held):
    table = reduce_log(held)
    begin, end = table_rows(held, table)[3]
    values = held.spot.values.copy()
    values[begin:end] = np.nan
    dark = reduce_log(replace(held, spot=replace(held.spot, values=values)))
    assert np.flatnonzero(np.isnan(dark.displacement[:, 0])).tolist() == [3]
    assert any('no light near' in w and 'around_xy' in w for w in dark.warnings)


def test_angles_are_recorded_where_they_are_measured(held, tmp_path):
    again = read_log(write_log(held, tmp_path / 'bag'))
    for name in ('time_ns', 'values', 'setup'):
        np.testing.assert_array_equal(getattr(again.beam_angle, name), getattr(held.beam_angle, name))
    assert again.description.setups['around_xy'].regulated and again.description.setups['around_xy'].feed == 0.02
    cell = plane()
    detector = replace(cell.instruments.detector, steering=replace(cell.instruments.detector.steering, inputs=()))
    without = simulate_log(replace(cell, instruments=replace(cell.instruments, detector=detector)))
    assert not len(without.beam_angle)
    np.testing.assert_array_equal(without.displacement.values, held.displacement.values)


def test_angles_that_are_none_are_left_out_and_said(held, tmp_path):
    values = held.beam_angle.values.copy()
    values[3], values[4] = np.nan, 1e9
    again = read_log(write_log(replace(held, beam_angle=replace(held.beam_angle, values=values)), tmp_path / 'bag'))
    assert len(again.beam_angle) == len(held.beam_angle) - 2
    assert any('psd/beam_angle: left out 2 angle(s)' in warning for warning in again.warnings)


def test_the_evaluation_says_how_the_beam_was_held_and_whether_its_angles_agree():
    cell = load_cell(FILE)
    setups = {name: replace(setup, repeats=1) for name, setup in cell.description.setups.items() if name[-1] != 'z'}
    log = simulate_log(replace(cell, description=replace(cell.description, setups=setups)))
    beam = evaluate(log).extra['stations']['around_xy']['beam']
    assert 0.0 < beam['spot_rms_m'] < 2e-4
    # The corner is 59 mm from the station, whose height above the plane lengths tell to some half a millimetre.
    assert beam['angle_rms_rad'] < 2e-3
    swapped = replace(log, beam_angle=replace(log.beam_angle, values=log.beam_angle.values[:, ::-1]))
    assert any('psd/beam_angle' in warning for warning in evaluate(swapped).warnings)
    silent = replace(log, beam_angle=type(log.beam_angle).empty(2))
    assert evaluate(silent).extra['stations']['around_xy']['beam']['angle_rms_rad'] is None


def test_measured_angles_are_the_directions_up_to_the_turn_of_the_base(held):
    cell = plane()
    turn, station = cell.misalignments['around_xy'].laser, cell.misalignments['around_xy'].station
    setup = cell.description.setups['around_xy']
    found, warnings = held_beams(held, reduce_log(held), {'around_xy': {'position_m': np.add(setup.station, station)}})
    assert found['around_xy']['angle_rms_rad'] < 4e-5 and not warnings
    u, v, _ = steering_frame(cell.description.machine, setup)
    np.testing.assert_allclose(found['around_xy']['turn_rad'], turn[0] * u + turn[1] * v, atol=8e-5)


@pytest.mark.parametrize(('change', 'complaint'), [
    (('steering: {range: 0.6, inputs: [4, 5]}', 'steering: {range: 0.1}'), 'around_x.*range'),
    (('inputs: [4, 5]', 'inputs: [3, 5]'), 'two others'),
    (('station: [-0.046, -0.037, -0.10], ', ''), 'regulated.*station|around'),
    (('regulated: true, feed: 0.02', 'regulated: true, psd: false'), 'regulated'),
    (('feed: 0.02', 'feed: -1'), 'feed'),
])
def test_a_cell_that_cannot_hold_its_beam_is_refused(change, complaint):
    text = FILE.read_text(encoding='utf-8')
    assert change[0] in text
    with pytest.raises(StepdiagError, match=complaint):
        parse_cell(text.replace(*change, 1), 'held')


def test_a_description_without_the_keys_is_what_it_was():
    description = load_cell(FILE).description
    assert Description.from_yaml(description.to_yaml()) == description
    plain = replace(description.setups['around_xy'], regulated=False, feed=None)
    text = replace(description, setups={'around_xy': plain}).to_yaml()
    assert 'regulated' not in text and 'feed' not in text.replace('test: {feed: 0.1}', '')
    with pytest.raises(StepdiagError, match='setups.around_xy.regulated is 1; write true or false'):
        Description.from_yaml(description.to_yaml().replace('regulated: true', 'regulated: 1'))
