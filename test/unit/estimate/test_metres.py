"""Lengths in metres and errors at 20 °C: what is taken out, by whom, and what is reported where nobody can."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.metres import divided_by, in_metres, with_one_index
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.log import DWELL, ScalarSeries
from stepdiag_ros.model.machine import Curve, GeometricErrors
from stepdiag_ros.model.path import setup_direction, start_corner

from .vacuum import cell, describing, log_of, without_topics

DRIFT = ('drift: {temperature: 0.2', 'drift: {temperature: 20.0')
GOOD = ('positioning: 8.0e-6', 'positioning: 1.0e-6')
CONSTANT = ('effects: {}', 'effects: {air_refraction_drift: {dT: 3.0, dP: 300.0, tau: 100.0}}')


@pytest.fixture(scope='module')
def vacuum():
    of = cell()
    return of, log_of(of)


@pytest.fixture(scope='module')
def known(vacuum):
    return evaluate(vacuum[1])


def pulls(solution, errors, names=('EXX', 'EYY', 'EZZ')):
    truth = to_reference_lines(errors)
    found = []
    for name in names:
        place, value, sigma = solution.curve(name)
        found += list((value - truth.curves[name](place))[1:] / sigma[1:])
    return np.abs(found)


def at_20(of):
    """The cell whose machine the scales' temperatures have stretched: what is measured in it."""
    curves = dict(of.geometry.curves)
    for axis, letter in enumerate('XYZ'):
        own, material = curves[f'E{letter * 2}'], of.description.scales[letter.lower()]
        warm = material.expansion * (of.air.scale_temperature[axis] - 20.0)
        curves[f'E{letter * 2}'] = Curve(own.position, own.value + warm * np.asarray(own.position))
    return replace(of, geometry=GeometricErrors(curves, of.geometry.square))


@pytest.mark.parametrize('changes', [(), (DRIFT,), (('compensated: false', 'compensated: true'), CONSTANT, (
    'drift: {temperature: 0.2, pressure: -40.0', 'drift: {temperature: 0.0, pressure: 0.0'))],
    ids=['vacuum', 'vacuum, changing air', 'divided by a constant'])
def test_topics_correct_the_lengths(changes):
    of = cell(*changes)
    solution = evaluate(log_of(at_20(of)))
    assert solution.status == 'ok'
    assert solution.traceable
    assert solution.traceability.air == 'topics'
    assert solution.traceability.reference_temperature == 20.0
    assert pulls(solution, of.geometry).max() < 4.0
    # 2.7e-4 of 0.2 m are 53 µm: nothing of that is left.
    assert abs(solution.curve('EXX')[1][-1] - to_reference_lines(of.geometry).curves['EXX'].value[-1]) < 1.5e-6


def test_the_dead_path_by_another_road(vacuum):
    """Optical lengths written down from their definition come back as distances, forward and backward."""
    of, log = vacuum
    table = reduce_log(log)
    rng, machine = np.random.default_rng(2), of.description.machine
    index = 1.00027 + 2e-6 * rng.standard_normal(len(table))
    truth, shown = np.empty(len(table)), np.empty(len(table))
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        name = table.setup_names[table.setup[rows[0]]]
        distance = of.description.setups[name].standoff + (
            table.commanded[rows] - start_corner(machine, name)) @ setup_direction(machine, name)
        truth[rows] = distance - distance[0]
        shown[rows] = (index[rows] * distance - index[rows[0]] * distance[0]) / 1.0002
    recorded = replace(table, displacement=shown[:, None], refractive_index=np.full(len(table), 1.0002))
    assert np.max(np.abs(divided_by(of.description, recorded, index).displacement[:, 0] - truth)) < 1e-15
    # The dead path matters: leaving it out is wrong by up to a micrometre here.
    assert np.max(np.abs(shown * 1.0002 / index - truth)) > 3e-7


def test_nobody_knows_the_air(vacuum):
    of, log = vacuum
    solution = evaluate(describing(without_topics(log), air=None))
    tied = solution.traceability
    assert solution.status == 'not corrected for air'
    assert not solution.traceable
    assert (tied.air, tied.index, tied.reference_temperature) == ('nobody', 1.0, None)
    assert any('refractive_index 1.0' in warning for warning in solution.warnings)
    assert pulls(solution, at_20(of).geometry).max() < 2.0
    assert solution.curve('EXX')[2][-1] == pytest.approx(3e-4 / np.sqrt(3.0) * 0.2, rel=0.05)
    assert tied.temperature_words == 'at the temperature of the measurement, which is unknown'


def test_the_cells_values_count_where_no_topic_tells(vacuum):
    of, log = vacuum
    log = without_topics(log)
    tied = evaluate(log).traceability
    assert tied.air == 'cell'
    assert tied.index == pytest.approx(refractive_index(20.3, 101100.0, 0.42), abs=1e-12)
    # 0.5 K, 100 Pa, 10 %: 0.47, 0.26 and 0.09 in 1e-6.
    assert tied.index_sigma == pytest.approx(5.5e-7, rel=0.05)
    assert 'for the whole log alike' in tied.remarks[0]


def test_an_instrument_that_follows_the_air_is_left_as_it_is():
    log = log_of(cell(('compensated: false', 'compensated: true'), DRIFT))
    metres = in_metres(describing(log, scales={}))
    assert metres.air == 'instrument'
    assert np.array_equal(metres.table.displacement, reduce_log(log).displacement)


def test_a_constant_that_nothing_checks_is_uncertain():
    quiet = ('drift: {temperature: 0.2, pressure: -40.0', 'drift: {temperature: 0.0, pressure: 0.0')
    log = log_of(cell(('compensated: false', 'compensated: true'), quiet))
    known, unknown = evaluate(log), evaluate(describing(without_topics(log), air=None))
    assert known.traceability.air == 'topics'
    assert unknown.traceability.air == 'instrument constant'
    assert unknown.traceability.index_sigma > 5.0 * known.traceability.index_sigma
    # A stop without a reading is no vacuum length: with topics or without, the others are what they were.
    stop = np.flatnonzero(log.steps.phase == DWELL)[4]
    begin, end = log.steps.time_ns[stop:stop + 2]
    dark = (log.displacement.time_ns >= begin) & (log.displacement.time_ns < end)
    lost = replace(log, displacement=replace(log.displacement, health=np.where(dark, 0, log.displacement.health)))
    table = reduce_log(lost)
    assert np.sum(table.displacement_count == 0) == 1
    assert np.array_equal(table.refractive_index, reduce_log(log).refractive_index)
    assert in_metres(lost).air == 'topics'
    assert in_metres(describing(without_topics(lost), air=None)).air == 'instrument constant'


def test_a_topic_in_hectopascal_is_left_out_and_said(vacuum):
    _, log = vacuum
    pressure = log.environment['air_pressure']
    wrong = ScalarSeries(pressure.time_ns, pressure.value / 100.0, pressure.variance)
    solution = evaluate(replace(log, environment=log.environment | {'air_pressure': wrong}))
    assert any('environment/air_pressure: reads about 1011' in remark for remark in solution.traceability.remarks)
    assert solution.traceability.index == pytest.approx(1.000267, abs=1e-6)


@pytest.mark.parametrize(('reads', 'words'), [(293.0, 'reads about 293, outside -20 to 60; it is left out'),
                                              (0.0, 'times; it is left out, check that its sensor is connected')])
def test_a_scale_in_kelvin_or_without_a_sensor_is_left_out_and_said(vacuum, reads, words):
    _, log = vacuum
    told = log.environment['scale_temperature/x']
    wrong = log.environment | {'scale_temperature/x': replace(told, value=np.full_like(told.value, reads))}
    metres = in_metres(replace(log, environment=wrong))
    assert any(remark.startswith('environment/scale_temperature/x: reads') and words in remark
               for remark in metres.remarks)
    assert 'x' not in metres.measured_at and 'y' in metres.measured_at


@pytest.mark.parametrize(('says', 'how'), [(1.0, 'divided out twice'), (None, '')])
def test_an_index_that_was_divided_out_twice_is_said(says, how):
    log = log_of(cell(('compensated: false', 'compensated: true'), GOOD))
    index = log.displacement.refractive_index
    told = replace(log.displacement, refractive_index=np.full_like(index, says) if says else index)
    said = [w for w in evaluate(replace(log, displacement=told)).warnings if 'along all axes alike' in w]
    assert [how in w for w in said] == ([True] if how else [])


def test_an_index_that_was_never_divided_out_is_said():
    log = log_of(cell(GOOD))
    told = replace(log.displacement, refractive_index=np.full_like(log.displacement.refractive_index, 1.000268))
    [said] = [w for w in evaluate(replace(log, displacement=told)).warnings if 'along all axes alike' in w]
    assert 'not divided out' in said


def test_readings_beyond_the_steps_change_nothing(vacuum, known):
    """A live log ends where its bag goes on: both must give the same bits."""
    _, log = vacuum
    begin, end = log.steps.time_ns[0], log.steps.time_ns[-1]
    cut = {name: ScalarSeries(*(part[(s.time_ns >= begin) & (s.time_ns <= end)]
                                for part in (s.time_ns, s.value, s.variance)))
           for name, s in log.environment.items()}
    assert np.array_equal(evaluate(replace(log, environment=cut)).value, known.value)


def test_the_correction_to_20_degrees_is_shown(vacuum, known):
    of, log = vacuum
    warm = known
    plain = evaluate(describing(log, scales={}))
    shown = warm.traceability.correction_m['EXX']
    assert shown == pytest.approx(-1.15e-5 * 2.0 * warm.curve('EXX')[0], rel=2e-3)
    assert warm.curve('EXX')[1] - plain.curve('EXX')[1] == pytest.approx(shown, abs=3e-8)
    assert plain.traceability.reference_temperature is None
    assert plain.traceability.measured_at['x'] == pytest.approx(22.0, abs=0.01)
    assert 'not referred to 20 °C' in plain.traceability.temperature_words
    document = warm.to_json_dict()
    assert document['reference_temperature'] == 20.0
    assert document['traceability']['correction_to_20C_m']['EZZ'][-1] == pytest.approx(-8e-6 * 3.0 * 0.12, rel=2e-3)
    both = (document['errors']['EXX'][key][-1] for key in ('sigma', 'sigma_repeatability'))
    assert next(both) > next(both) > 0.0


def test_one_axis_that_is_referred_to_20_degrees_is_told_from_the_others(vacuum):
    _, log = vacuum
    tied = evaluate(describing(log, scales={'x': log.description.scales['x']})).traceability
    assert tied.reference_temperature is None and tied.correction_m.keys() == {'EXX'}
    words = tied.temperature_words
    assert words.startswith('EXX referred to 20 °C; the others at the temperature of the scales')
    assert 'X 2' not in words and 'Y 2' in words and 'Z 2' in words


def test_the_diagnosis_gets_lengths_and_keeps_the_drift():
    """One index for the whole log: as an instrument that divides by a constant would have recorded it."""
    log = log_of(cell(DRIFT))
    table = reduce_log(log)
    one = with_one_index(log, table)
    ratio = table.displacement / one.displacement
    assert np.nanmax(np.abs(ratio - one.refractive_index[:, None])) < 1e-12
    assert np.ptp(one.refractive_index) == 0.0
    assert one.refractive_index[0] == pytest.approx(1.000267, abs=1e-6)
    unknown = describing(without_topics(log), air=None)
    assert with_one_index(unknown, table) is table


def test_scales_near_20_degrees_need_no_material():
    """Half a kelvin of any material counts where no sensor shows the scales; less where one shows them near 20 °C."""
    stated = log_of(cell(('scale_temperature: [22.0, 22.5, 23.0]', 'scale_temperature: [20.02, 22.5, 20.0]'),
                         ('x: {expansion: 1.15e-5', 'x: {expansion: 2.3e-5')))
    log = describing(stated, scales={})
    shown, unknown = evaluate(log), evaluate(without_topics(log, *(f'scale_temperature/{axis}' for axis in 'xyz')))
    # A scale that is stated to be of aluminium is no worse known than one of which nothing is stated.
    assert evaluate(stated).curve('EXX')[2][-1] < shown.curve('EXX')[2][-1]
    assert shown.curve('EXX')[2][-1] < 0.5 * unknown.curve('EXX')[2][-1]
    assert shown.curve('EYY')[2][-1] == pytest.approx(unknown.curve('EYY')[2][-1], rel=1e-2)
    assert unknown.curve('EXX')[2][-1] == pytest.approx(0.5 * 24e-6 / np.sqrt(3.0) * 0.2, rel=0.1)
