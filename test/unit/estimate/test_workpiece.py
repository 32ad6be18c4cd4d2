"""What the workpiece's temperature does to parts, by hand and from cell file, log and bag."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.methods import run_method
from stepdiag_ros.model.log import ScalarSeries

from .vacuum import cell, describing, log_of, without_topics

PART = ('    z: {expansion: 8.0e-6, sigma: 1.0e-6}\n', '    z: {expansion: 8.0e-6, sigma: 1.0e-6}\n  workpiece: '
        '{expansion: 2.3e-5, sigma: 1.0e-6, temperature: 24.0, temperature_sigma: 0.2}\n')


@pytest.fixture(scope='module')
def log():
    return log_of(cell(PART))


def test_the_differential_expansion_by_hand(log):
    """A length of 0.2 m, made while its scale had 22 °C and the part 24 °C, taken to 20 °C."""
    solution = evaluate(log)
    part = solution.traceability.workpiece
    made = 0.2 * (1.0 + 1.15e-5 * 2.0)      # a scale that is warm and read as if it were not makes parts long
    cold = made * (1.0 - 2.3e-5 * 4.0)
    assert part.differential_m['EXX'][-1] == pytest.approx(cold - 0.2, rel=5e-3)
    assert part.differential_m['EZZ'][-1] == pytest.approx(0.12 * (8e-6 * 3.0 - 2.3e-5 * 4.0), rel=5e-3)
    spread = 0.2 * np.linalg.norm([1.15e-5 * 0.1 / np.sqrt(3.0), 1e-6 * 2.0, 2.3e-5 * 0.2, 1e-6 * 4.0])
    assert part.sigma_m['EXX'][-1] == pytest.approx(spread, rel=5e-3)
    assert (part.by, part.temperature) == ('cell', 24.0)
    # The errors of the machine at 20 °C are what they are, whatever the part.
    assert np.array_equal(solution.value, evaluate(describing(log, workpiece=None)).value)
    document = solution.to_json_dict()['traceability']
    assert document['workpiece']['differential_m']['EXX'][-1] == part.differential_m['EXX'][-1]
    assert document['correction_to_20C_sigma_m']['EXX'][-1] > 0.0
    assert 'k = 2' in part.words and 'EXX' in part.words


def test_a_topic_goes_before_the_cell_and_travels_in_bags(log, tmp_path):
    scale = log.environment['scale_temperature/x']
    series = ScalarSeries(scale.time_ns, np.full(len(scale.value), 21.0), scale.variance)
    with_topic = replace(log, environment=log.environment | {'scale_temperature/workpiece': series})
    write_log(with_topic, tmp_path / 'bag')
    back = read_log(tmp_path / 'bag')
    assert back.description.workpiece == log.description.workpiece
    assert not back.warnings
    part = run_method('step_diagonal', back).traceability.workpiece
    assert (part.by, part.temperature) == ('topic', pytest.approx(21.0))
    assert part.temperature_sigma == pytest.approx(0.1 / np.sqrt(3.0))


def test_what_is_not_known_of_the_workpiece_is_said(log):
    plain = describing(log, workpiece=None)
    assert evaluate(plain).traceability.workpiece_words == 'temperature and expansion of the workpiece are unknown'
    untold = describing(log, workpiece=replace(log.description.workpiece, temperature=None))
    assert evaluate(untold).traceability.workpiece_words == 'the temperature of the workpiece is unknown'
    # Scales of which nothing is known: no difference of expansions can be stated.
    part = evaluate(without_topics(log, 'scale_temperature/x')).traceability.workpiece
    assert set(part.differential_m) == {'EYY', 'EZZ'}


def test_a_workpiece_that_makes_no_sense_costs_one_line():
    with pytest.raises(StepdiagError, match='material.workpiece.temperature'):
        cell(PART[:1] + (PART[1].replace('24.0', '240.0'),))
    with pytest.raises(StepdiagError, match='expansion'):
        cell((PART[0], PART[0] + '  workpiece: {temperature: 22.0}\n'))


def test_temperatures_of_scales_that_the_cell_states_count_where_no_topic_tells(log):
    scales = {axis: replace(own, temperature=t, temperature_sigma=0.4)
              for (axis, own), t in zip(log.description.scales.items(), (22.0, 22.5, 23.0), strict=True)}
    told = evaluate(describing(log, scales=scales))
    stated = evaluate(describing(without_topics(log, *(f'scale_temperature/{axis}' for axis in 'xyz')), scales=scales))
    assert stated.traceability.reference_temperature == 20.0
    assert stated.curve('EXX')[1] == pytest.approx(told.curve('EXX')[1], abs=2e-8)
    assert stated.curve('EXX')[2][-1] == pytest.approx(0.2 * np.hypot(1.15e-5 * 0.4, 1e-6 * 2.0), rel=0.15)
    assert stated.curve('EXX')[2][-1] > 1.5 * told.curve('EXX')[2][-1]
