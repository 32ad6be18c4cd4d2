"""The index of air against published values, an independent equation and known slopes."""

import numpy as np
import pytest

from stepdiag_ros.model.air import FORMULA_SIGMA, index_slopes, refractive_index

HELIUM_NEON = 633e-9


def saturation(t):
    """Giacomo's saturation pressure [Pa], to turn the paper's vapour pressures into humidities."""
    kelvin = t + 273.15
    return np.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6343.1645 / kelvin)


@pytest.mark.parametrize(('t', 'p', 'refractivity'), [
    (20.0, 80e3, 21458.0), (20.0, 100e3, 26824.4), (20.0, 120e3, 32191.6), (10.0, 100e3, 27774.7),
    (30.0, 100e3, 25937.2)])
def test_dry_air_of_ciddors_first_table(t, p, refractivity):
    """Ciddor 1996, table 1: phase refractivity ×1e8 at 633 nm and 450 ppm CO₂."""
    assert 1e8 * (float(refractive_index(t, p, 0.0, HELIUM_NEON)) - 1.0) == pytest.approx(refractivity, abs=0.1)


@pytest.mark.parametrize(('t', 'p', 'vapour', 'co2', 'refractivity'), [
    (19.526, 102094.8, 1065.0, 510e-6, 27392.9), (19.517, 102096.8, 1065.0, 510e-6, 27394.0),
    (19.173, 102993.0, 641.0, 450e-6, 27682.4), (19.188, 102918.8, 706.0, 450e-6, 27658.7),
    (19.532, 103603.2, 986.0, 600e-6, 27802.0)])
def test_moist_air_of_ciddors_second_table(t, p, vapour, co2, refractivity):
    """Ciddor 1996, table 2: moist air with its CO₂; the paper rounds temperature and pressure."""
    humidity = vapour / saturation(t)
    assert 1e8 * (float(refractive_index(t, p, humidity, HELIUM_NEON, co2)) - 1.0) \
        == pytest.approx(refractivity, abs=1.0)


@pytest.mark.parametrize(('wavelength', 'index'), [
    (321.456, 1.000283543), (500.0, 1.000273781), (633.0, 1.000271373), (1000.987, 1.000269038),
    (1500.8, 1.00026819)])
def test_values_of_nist_over_the_wavelengths(wavelength, index):
    """NIST Engineering Metrology Toolbox, Ciddor equation: 20 °C, 101325 Pa, 50 %."""
    assert float(refractive_index(20.0, 101325.0, 0.5, 1e-9 * wavelength)) == pytest.approx(index, abs=1.2e-9)


@pytest.mark.parametrize(('t', 'p', 'humidity', 'index'), [
    (0.0, 101325.0, 0.5, 1.000291647), (40.123, 101325.0, 0.5, 1.000253031), (20.0, 50123.0, 0.5, 1.000133999),
    (20.0, 101325.0, 1.0, 1.000270949), (50.0, 120e3, 1.0, 1.000287924)])
def test_values_of_nist_over_the_air(t, p, humidity, index):
    assert float(refractive_index(t, p, humidity, HELIUM_NEON)) == pytest.approx(index, abs=2e-9)


def edlen(t, p, humidity, wavelength):
    """Edlén's equation as modified by Birch and Downs, Metrologia 31 (1994) 315: written apart from the model."""
    s = (1e-6 / wavelength)**2
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    dry = p * standard / 96095.43 * (1.0 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1.0 + 0.003661 * t)
    # The vapour term is stated for 20 °C; 292.75/T carries it to other temperatures (NIST).
    return 1.0 + dry - 292.75 / (t + 273.15) * humidity * saturation(t) * (3.7345 - 0.0401 * s) * 1e-10


def test_edlen_says_the_same_in_a_workshop():
    rng = np.random.default_rng(4)
    t, p, humidity = rng.uniform(15.0, 28.0, 200), rng.uniform(95e3, 104e3, 200), rng.uniform(0.2, 0.7, 200)
    for wavelength in (HELIUM_NEON, 1.53e-6):
        apart = refractive_index(t, p, humidity, wavelength) - edlen(t, p, humidity, wavelength)
        assert np.max(np.abs(apart)) < 2.0 * FORMULA_SIGMA


def test_slopes_a_metrologist_knows():
    temperature, pressure, humidity = index_slopes(20.0, 101325.0, 0.5)
    assert temperature == pytest.approx(-0.93e-6, rel=0.03)
    assert pressure == pytest.approx(2.65e-9, rel=0.02)
    assert humidity == pytest.approx(-0.87e-6, rel=0.06)
    more = float(refractive_index(20.0, 101325.0, 0.5, co2=550e-6) - refractive_index(20.0, 101325.0, 0.5))
    assert more == pytest.approx(1.43e-8, rel=0.03)


def test_arrays_and_vacuum():
    index = refractive_index(np.array([20.0, 25.0]), np.array([1e5, 1e5]), 0.3)
    assert index.shape == (2,)
    assert index[0] > index[1] > 1.0
    assert float(refractive_index(20.0, 0.0, 0.0)) == 1.0
