"""Errors that many readings share: as unknowns beside the others, against the textbook; and almost without noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.shared import weigh
from stepdiag_ros.virtual.cell import parse_cell
from stepdiag_ros.virtual.offline import simulate_log

LINES = """
schema: 1
seed: 5
machine: {name: lines, chain: FXYZ, volume: [0.2, 0.16, 0.12], tool: [0.0, 0.0, -0.12]}
plan: {steps: 4, order: XYZ, repeats: 2}
setups:
  x_1: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0, 0], to: [0.2, 0, 0]}
  x_2: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0.16, 0], to: [0.2, 0.16, 0]}
  x_3: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0, 0.12], to: [0.2, 0, 0.12]}
  y_1: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0, 0], to: [0, 0.16, 0]}
  y_2: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0.2, 0, 0], to: [0.2, 0.16, 0]}
  y_3: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0, 0.12], to: [0, 0.16, 0.12]}
  z_1: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0, 0], to: [0, 0, 0.12]}
  z_2: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0.2, 0, 0], to: [0.2, 0, 0.12]}
  z_3: {standoff: 0.2, psd_offset: [0.02, 0.0], from: [0, 0.16, 0], to: [0, 0.16, 0.12]}
noise: {displacement: NOISE, spot: NOISE, position_repeatability: NOISE, angle_repeatability: NOISE}
geometry: {drawn: {positioning: 8.0e-6, straightness: 4.0e-6, angle: 2.0e-5, squareness: 1.5e-5}}
misalignments: {drawn: {laser: 2.0e-4, mirror: 2.0e-4, psd_zero: 0.0}}
air: {sensors: []}
motion: {feed: 0.5, acceleration: 8.0, jerk: 800.0, in_position: 1.0e-12, settling: 0.0, dwell: 0.06, mount: 2.0}
sampling: {interferometer: 200.0, psd: 200.0, block: 0.05}
"""


def fitted(sigma: float) -> tuple[SimpleNamespace, np.ndarray]:
    """A fit of 40 readings, 7 unknowns, 3 shared errors, with readings of ``sigma`` as its noise."""
    rng = np.random.default_rng(2)
    jacobian, columns = rng.normal(size=(40, 7)), rng.normal(size=(40, 3))
    halves = [SimpleNamespace(rows=np.arange(a, a + 20), factor=sigma * np.eye(20)) for a in (0, 20)]
    return SimpleNamespace(
        present=np.ones((20, 2), bool), jacobian=sparse.csr_array(jacobian), whiteners=halves,
        precision=0.1 * np.eye(7), residual=rng.normal(size=(20, 2)) * sigma, theta=rng.normal(size=7)), columns


def test_it_is_the_best_estimate_under_both_kinds_of_error():
    result, columns = fitted(0.5)
    jacobian, reporting = result.jacobian.toarray(), np.eye(7)
    inverse = np.linalg.inv(0.25 * np.eye(40) + columns @ columns.T)
    covariance = np.linalg.inv(jacobian.T @ inverse @ jacobian + result.precision)
    found = weigh(result, reporting, columns)
    np.testing.assert_allclose(found.half, covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.gain, covariance @ jacobian.T @ inverse, rtol=1e-9, atol=1e-10)
    step = covariance @ (jacobian.T @ inverse @ result.residual.ravel() - result.precision @ result.theta)
    np.testing.assert_allclose(found.shift, step, rtol=1e-9, atol=1e-10)


def test_what_visits_to_one_place_share_is_weighed_as_what_it_is():
    """Two visits to 20 places: what they share, √2 as large and of each visit its own, has the same best estimate."""
    result, columns = fitted(0.5)
    place = np.random.default_rng(3).normal(size=(20, 7))
    result.jacobian = sparse.csr_array(np.vstack([place, place]))
    columns[20:] = columns[:20]
    form = 0.8 * np.vstack([np.eye(20), np.eye(20)])
    jacobian = result.jacobian.toarray()
    inverse = np.linalg.inv(0.25 * 2.0**2 * np.eye(40) + columns @ columns.T + form @ form.T)
    covariance = np.linalg.inv(jacobian.T @ inverse @ jacobian + result.precision)
    each = sparse.csr_array(np.sqrt(2.0) * 0.8 * np.eye(40))
    found = weigh(result, np.eye(7), columns, misfit=2.0, stopwise=each)
    np.testing.assert_allclose(found.half, covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.gain, covariance @ jacobian.T @ inverse, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize('sigma', [1e-7, 1e-11])
def test_readings_almost_without_noise_leave_what_is_shared(sigma):
    """Then 40 readings of 7 unknowns and 3 shared errors determine all of them."""
    result, columns = fitted(sigma)
    found = weigh(result, np.eye(7), columns)
    assert (np.diag(found.half) > 0.0).all() and (np.sqrt(np.diag(found.half)) < 2.0 * sigma).all()
    np.testing.assert_allclose(found.gain @ result.jacobian.toarray(), np.eye(7), atol=1e-4)


@pytest.mark.parametrize('noise', ['0.0', '5.0e-15'])
def test_parallel_lines_alone_and_without_noise_have_an_answer(noise):
    solution = evaluate(simulate_log(parse_cell(LINES.replace('NOISE', noise), 'lines')))
    assert np.isfinite(solution.value).all() and np.isfinite(solution.sigma).all()
    named = {name.split()[0] for entry in solution.unidentifiable for name in entry.names}
    assert not {'EXX', 'EYY', 'EZZ'} & named
