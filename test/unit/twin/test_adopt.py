"""The cell that a diagnosis writes: the simulator run from it gives the log again, to the noise floor."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.noise import whiteners
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.model.description import Noise
from stepdiag_ros.twin.adopt import adopt
from stepdiag_ros.virtual.cell import Cell, parse_cell
from stepdiag_ros.virtual.offline import simulate_log
from test.some import some

CASES = {'backlash': {'B': [4e-6, 3e-6, 5e-6]},
         # So large that machine and effect have to be found in turn.
         'ambient_light': {'level': 0.03, 'swing': 0.15, 'period': 300.0},
         'mirror_curvature': {'radius': 1200.0, 'astigmatism': 0.0},
         'structural_thermal_drift': {'amp': [9e-5, -6e-5, 1.2e-4], 'tau': 300.0},
         'count_slip': {'jump': 6e-6, 'arrival': 60.0}}
SLOW = {'structural_thermal_drift': 2.0}
"""Seconds at a stop for what needs time to show."""
FLOOR = 1.15
"""Reduced χ² of log minus noise-free simulation: 1 is the log's own noise."""
LONG = ('ambient_light', 'mirror_curvature', 'structural_thermal_drift')
SHORT_AND_LONG = some(*(name for name in CASES if name not in LONG), later=LONG)


def adopted(diagnosis: Diagnosis, **without: None) -> tuple[Cell, dict, tuple[str, ...]]:
    written, notes = adopt(diagnosis)[:2]
    text = yaml.safe_dump(written, sort_keys=False)     # what cannot be written as YAML fails here
    cell = parse_cell(text, 'adopted.yaml')
    return replace(cell, **without) if without else cell, written, notes


def disagreement(diagnosis: Diagnosis, cell: Cell) -> float:
    """Reduced χ² of the log's stops against those that the cell makes without noise, in the log's noise; the
    reset of each run is free, as it is for the laser."""
    quiet = replace(cell, description=replace(cell.description, noise=Noise(0.0, 0.0, 0.0, 0.0)))
    real, made = diagnosis.nominal.table, reduce_log(simulate_log(quiet))
    assert made.run_ids == real.run_ids and np.array_equal(made.index, real.index)
    difference = np.concatenate([real.displacement - made.displacement, real.spot - made.spot], axis=1)
    resets = np.zeros((difference.size, len(real.run_ids)))
    for run in range(len(real.run_ids)):
        mask = np.zeros_like(difference)
        mask[real.run == run, :-2] = 1.0
        resets[:, run] = mask.ravel()
    fit = diagnosis.joint.fit
    white = whiteners(real, diagnosis.joint.noise, fit.arrival, fit.present)
    z = np.concatenate([w(difference.ravel()) for w in white])
    free = np.concatenate([w(resets) for w in white])
    left = z - free @ np.linalg.lstsq(free, z, rcond=None)[0]
    return float(left @ left / (len(left) - len(real.run_ids)))


@pytest.mark.parametrize('name', SHORT_AND_LONG)
def test_simulator_reproduces_the_log(diagnosed, name):
    diagnosis = diagnosed(name, CASES[name], None, SLOW.get(name, 0.1))
    cell, _, notes = adopted(diagnosis)
    assert list(cell.effects) == [name], notes
    assert disagreement(diagnosis, cell) < FLOOR


@pytest.mark.parametrize('name', SHORT_AND_LONG)
def test_without_the_effect_it_does_not(diagnosed, name):
    """The check above can fail: the same cell without the effect is far from the log."""
    diagnosis = diagnosed(name, CASES[name], None, SLOW.get(name, 0.1))
    cell, _, _ = adopted(diagnosis, effects={})
    assert disagreement(diagnosis, cell) > 1.5 * FLOOR


def test_parameters_are_the_true_ones(diagnosed):
    zero = {'x': 3e-4, 'y': -2e-4}
    _, written, _ = adopted(diagnosed('psd_zero_offset', zero))
    assert written['effects']['psd_zero_offset'] == pytest.approx(zero, abs=1e-6)
    _, written, _ = adopted(diagnosed('backlash', CASES['backlash']))
    assert written['effects']['backlash']['B'] == pytest.approx(CASES['backlash']['B'], abs=6e-7)


def test_noise_is_that_of_the_log(diagnosed):
    cell, _, _ = adopted(diagnosed(''))
    noise = cell.description.noise
    assert noise.position_repeatability == pytest.approx(3.0e-7, rel=0.3)
    assert noise.displacement == pytest.approx(5.0e-9, rel=0.3)
    assert cell.effects == {}


def test_a_given_cell_is_the_base(diagnosed):
    diagnosis = diagnosed('backlash', CASES['backlash'])
    base = yaml.safe_load(diagnosis.log.description.to_yaml()) | {
        'seed': 77, 'motion': {'dwell': 0.1, 'mount': 20.0}, 'air': {'temperature': 23.0}, 'effects': None}
    written, _ = adopt(diagnosis, base)[:2]
    assert (written['seed'], written['air'], written['motion']) == (77, base['air'], base['motion'])
    assert list(written['effects']) == ['backlash']
    with pytest.raises(StepdiagError, match='backlash already'):
        adopt(diagnosis, base | {'effects': {'backlash': {'B': 1e-6}}})
