"""The band with a border against the dense normal equations."""

import numpy as np
import pytest

from stepdiag_ros.estimate.banded import BandedNormal
from stepdiag_ros.estimate.dense import normal_equations, weighted
from stepdiag_ros.estimate.enhanced import PRIOR_FRAME_RAD, frame_rows, prior_precision, prior_sigmas
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel, whiteners
from stepdiag_ros.estimate.parameters import parameters_of
from stepdiag_ros.estimate.planned import planned_table

THREE = ((0.0, 0.0), (0.03, 0.0), (0.0, 0.03))


def both(description, holes=0.0, seed=1, damping=0.0):
    """Steps by the dense equations and by the band, and the dense standard deviations; bandwidth."""
    rng = np.random.default_rng(seed)
    table = planned_table(description)
    parameters = parameters_of(description, table)
    model = ForwardModel(description, table, parameters)
    theta = rng.normal(0.0, 1e-5, parameters.size)
    theta[parameters.offset_first:] = 0.35
    _, jacobian, arrival = model.jacobian(theta)
    present = rng.random((len(table), arrival.shape[2])) >= holes
    noise = NoiseModel(3e-7, 2e-7, np.full(present.shape, 1e-8), 'given')
    white = whiteners(table, noise, arrival, present)
    residual = np.where(present, rng.normal(0.0, 1e-6, present.shape), 0.0).ravel()
    precision = prior_precision(parameters)
    pull = precision @ theta
    normal = normal_equations(jacobian, white) + (1.0 + damping) * precision
    scale = 1.0 / np.sqrt(np.diag(normal))
    inverse = np.linalg.inv(normal * scale[:, None] * scale) * scale[:, None] * scale
    dense = inverse @ (jacobian.T @ weighted(residual, white) - pull)
    band = BandedNormal(table, noise, arrival, present, prior_sigmas(parameters), frame_rows(parameters),
                        PRIOR_FRAME_RAD,
                        min(parameters.setup_first.values()))
    return dense, band.solve(jacobian, residual, pull, damping), np.sqrt(np.diag(inverse)), band


@pytest.mark.parametrize('chain', ['FXYZ', 'XYFZ'])
@pytest.mark.parametrize('beams', [((0.0, 0.0),), THREE])
def test_the_step_is_the_same(plan_of, chain, beams):
    """To rounding, which the border magnifies: three beams see the frame almost as well as each other."""
    dense, banded, sigma, _ = both(plan_of(4, 2, beams, chain))
    assert np.abs((dense - banded) / sigma).max() < (1e-2 if len(beams) == 1 else 0.5)
    assert np.abs((dense - banded) / sigma).max() < 0.03 * np.abs(dense / sigma).max()


@pytest.mark.parametrize('names', [('ppp',), ('lin_x',), ('npp', 'lin_z')])
def test_few_setups(plan_of, names):
    dense, banded, sigma, _ = both(plan_of(3, 2, names=names))
    assert np.abs((dense - banded) / sigma).max() < 1e-2


def test_readings_may_be_missing(plan_of):
    dense, banded, sigma, _ = both(plan_of(4, 2), holes=0.3)
    assert np.abs((dense - banded) / sigma).max() < 1e-2


@pytest.mark.parametrize('damping', [4.0, 1e4])
def test_narrowed_widths(plan_of, damping):
    dense, banded, sigma, _ = both(plan_of(4, 2), damping=damping)
    assert np.abs((dense - banded) / sigma).max() < 1e-2


def test_the_band_does_not_widen_with_the_steps(plan_of):
    few, many = (both(plan_of(steps, 1))[3].bandwidth for steps in (6, 14))
    assert many < 1.3 * few
