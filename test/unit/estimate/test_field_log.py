"""A log by another maker without effects, with known errors: the acceptance of the enhanced method."""

import json

import numpy as np
import pytest

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.estimate.enhanced import fit
from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.gauge import STRAIGHTNESS, to_reference_lines
from stepdiag_ros.estimate.propagate import coverage_factor
from stepdiag_ros.estimate.reduce import reduce_log
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors


@pytest.fixture
def log_and_truth(shared):
    folder = shared / 'field_logs' / 'open'
    if not (folder / 'log_05').exists():
        pytest.skip(f'shared data missing: no {folder}/log_05 (set STEPDIAG_SHARED)')
    truth = json.loads((folder / 'truth.json').read_text())['log_05']
    assert not truth['effects']
    return read_log(folder / 'log_05'), truth['geometry']


def with_intercept(position, value):
    """Straightness from its least-squares line with intercept: free of which point was called zero."""
    return value - np.polyval(np.polyfit(position, value, 1), position)


def test_a_log_without_effects(log_and_truth):
    log, geometry = log_and_truth
    solution = evaluate(log)
    assert solution.status == 'ok'
    assert 0.9 < solution.reduced_chi2 < 1.1
    volume = log.description.machine.volume
    curves = {}
    for name in CURVES:
        value = np.array(geometry[name])
        curves[name] = Curve(np.linspace(0.0, volume['XYZ'.index(name[2])], len(value)), value)
    truth = to_reference_lines(GeometricErrors(curves, geometry['square']))
    _, matrix = [n for n, _ in solution.names], solution.covariance
    pulls, loose = [], []
    for name in CURVES:
        position, value, sigma = solution.curve(name)
        want = truth.curves[name](position)
        loose.append(np.abs(value - want)[1:] / sigma[1:])
        if name in STRAIGHTNESS:
            rows = [i for i, (n, _) in enumerate(solution.names) if n == name]
            design = np.stack([np.ones_like(position), position], axis=1)
            project = np.eye(len(position)) - design @ np.linalg.pinv(design)
            own = np.sqrt(np.diag(project @ matrix[np.ix_(rows, rows)] @ project.T))
            pulls.append((with_intercept(position, value) - with_intercept(position, want)) / own)
        else:
            pulls.append((value - want)[1:] / sigma[1:])
    square = np.array([(solution.squareness(n)[0] - truth.square[n]) / solution.squareness(n)[1]
                       for n in SQUARENESS])
    # The noise behind σ comes from the repeats: k of a two-sided 95.45 % interval with their degrees of
    # freedom (GUM G.3), 2.01 to 2.02 here.
    table = reduce_log(log)
    k = coverage_factor(np.array(min(fit(log.description, table).noise.dof)))
    assert 2.0 < k < 2.03
    share = np.mean(np.abs(np.concatenate([*pulls, square])) < k)
    assert share >= 0.95
    # Counted from position 0 one arrival there moves a whole curve: the pulls go together.
    assert np.mean(np.concatenate(loose) < 2.0) > 0.85
    assert np.concatenate(loose).max() < 5.0


def test_the_same_log_gives_the_same_bits(log_and_truth):
    log, _ = log_and_truth
    one, two = evaluate(log), evaluate(log)
    assert one.value.tobytes() == two.value.tobytes()
    assert one.covariance.tobytes() == two.covariance.tobytes()
