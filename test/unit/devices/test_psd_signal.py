"""Photocurrents to spots."""

import numpy as np
import pytest

from stepdiag_ros.devices.psd_signal import SpotOptics


def test_the_formula_of_the_lateral_detector():
    spot, intensity = SpotOptics(length=0.010).spot(np.array([[1.0, 3.0, 2.0, 2.0], [2.0, 2.0, 3.0, 1.0]]))
    np.testing.assert_allclose(spot, [[0.0025, 0.0], [0.0, -0.0025]], atol=1e-18)
    np.testing.assert_allclose(intensity, 4.0)


@pytest.mark.parametrize('optics', [
    SpotOptics(), SpotOptics(0.02, 0.3, (1.1, 0.9), (1e-4, -2e-4)), SpotOptics(rotation=np.pi / 2)])
def test_volts_and_spot_are_inverse(optics):
    spots = np.random.default_rng(0).uniform(-2e-3, 2e-3, (50, 2))
    back, intensity = optics.spot(optics.volts(spots, np.full(50, 8.0)))
    np.testing.assert_allclose(back, spots, atol=1e-16)
    np.testing.assert_allclose(intensity, 8.0)


def test_rotation_turns_from_the_detector_s_x_to_u():
    spot, _ = SpotOptics(rotation=np.pi / 2).spot(np.array([[1.0, 3.0, 2.0, 2.0]]))
    np.testing.assert_allclose(spot, [[0.0, 0.0025]], atol=1e-18)


def test_no_light_no_spot():
    optics = SpotOptics()
    spot, intensity = optics.spot(np.array([[0.001, 0.001, 0.001, 0.001], [2.0, 2.0, 2.0, 2.0]]))
    assert np.isnan(spot[0]).all() and np.isfinite(spot[1]).all()
    assert intensity[0] == pytest.approx(0.002)
    beyond = optics.volts(np.array([[0.006, 0.0]]), np.array([8.0]))
    np.testing.assert_array_equal(beyond, 0.0)
