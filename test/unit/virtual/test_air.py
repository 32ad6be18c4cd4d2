"""The index of air against published values."""

import numpy as np
import pytest

from stepdiag_ros.virtual.air import conditions, index_at, refractive_index
from stepdiag_ros.virtual.cell import Air


@pytest.mark.parametrize(('temperature', 'pressure', 'humidity', 'expected'), [
    # NIST's engineering metrology toolbox (modified Edlén), 633 nm, 450 µmol/mol CO2.
    (20.0, 101325.0, 0.5, 1.000271374),
    (20.0, 101325.0, 0.0, 1.000271800),
])
def test_index_of_air_at_633_nm(temperature, pressure, humidity, expected):
    assert refractive_index(temperature, pressure, humidity, 632.99e-9) == pytest.approx(expected, abs=5e-8)


def test_rules_of_thumb():
    """About −1 ppm/K, +0.27 ppm/hPa, −0.9 ppm from dry to saturated at 20 °C."""
    base = refractive_index(20.0, 101325.0, 0.5)
    assert refractive_index(21.0, 101325.0, 0.5) - base == pytest.approx(-0.95e-6, abs=0.1e-6)
    assert refractive_index(20.0, 101425.0, 0.5) - base == pytest.approx(0.266e-6, abs=0.01e-6)
    assert refractive_index(20.0, 101325.0, 1.0) - refractive_index(20.0, 101325.0, 0.0) \
        == pytest.approx(-0.88e-6, abs=0.1e-6)


def test_air_drifts_as_the_cell_says():
    air = Air(temperature_drift=2.0, pressure_drift=-100.0, humidity_drift=-1.0)
    t, p, h = conditions(air, np.array([0.0, 1800.0]))
    np.testing.assert_allclose([t[1] - t[0], p[1] - p[0]], [1.0, -50.0])
    assert h.tolist() == [0.5, 0.0]
    # One kelvin, half a hectopascal and half the humidity by the rules of thumb above.
    assert np.diff(index_at(air, np.array([0.0, 1800.0])))[0] == pytest.approx(-0.62e-6, abs=0.1e-6)
