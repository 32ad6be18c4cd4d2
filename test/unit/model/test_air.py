"""The index of air against published values and known slopes."""

import numpy as np
import pytest

from stepdiag_ros.model.air import refractive_index


def test_standard_air_in_the_visible():
    """633 nm, 20 °C, 101325 Pa, dry air: 1.000271800 by Bönsch and Potulski, within a few 1e-8 of Edlén."""
    assert float(refractive_index(20.0, 101325.0, 0.0, 633e-9)) - 1.0 == pytest.approx(2.718e-4, abs=2e-7)


def test_slopes_a_metrologist_knows():
    at = (20.0, 101325.0, 0.5)
    temperature = float(refractive_index(20.5, *at[1:]) - refractive_index(19.5, *at[1:]))
    pressure = float(refractive_index(20.0, 101425.0, 0.5) - refractive_index(20.0, 101225.0, 0.5)) / 200.0
    humidity = float(refractive_index(20.0, 101325.0, 0.6) - refractive_index(20.0, 101325.0, 0.4)) / 0.2
    assert temperature == pytest.approx(-0.93e-6, rel=0.03)
    assert pressure == pytest.approx(2.68e-9, rel=0.02)
    assert humidity == pytest.approx(-0.87e-6, rel=0.06)


def test_arrays_and_vacuum():
    index = refractive_index(np.array([20.0, 25.0]), np.array([1e5, 1e5]), 0.3)
    assert index.shape == (2,)
    assert index[0] > index[1] > 1.0
    assert float(refractive_index(20.0, 0.0, 0.0)) == 1.0
