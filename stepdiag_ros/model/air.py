"""The refractive index of air.

After P. E. Ciddor, *Refractive index of air: new equations for the visible and near infrared*, Applied
Optics 35 (1996) 1566–1573, appendix B: the densities of dry air and of water vapour by the equation of
state of the BIPM (Davis 1992), each with its own dispersion.  It holds from 0.3 µm to 1.69 µm and so at the
interferometer's 1.53 µm, where Edlén's equation is an extrapolation.
"""

from functools import partial

import numpy as np

WAVELENGTH = 1.53e-6
"""Vacuum wavelength [m] of the IDS3010's laser."""
CO2 = 450.0e-6
"""Share of carbon dioxide in the air of a workshop [mol/mol]; 100 ppm more are 1.4e-8 of the index."""
FORMULA_SIGMA = 2.5e-8
"""Standard uncertainty of the index by the equation alone; Ciddor states 2e-8 to 5e-8 for air in general."""
_GAS_CONSTANT, _WATER = 8.314510, 0.018015          # J/(mol K), kg/mol
_STEPS = (0.1, 10.0, 0.01)


def refractive_index(temperature: np.ndarray, pressure: np.ndarray, humidity: np.ndarray,
                     wavelength: float = WAVELENGTH, co2: float = CO2) -> np.ndarray:
    """Index of air at ``temperature`` [°C], ``pressure`` [Pa], relative ``humidity`` [0..1].

    ``wavelength`` [m] in vacuum, 0.3e-6 to 1.69e-6; ``co2`` [mol/mol].
    """
    t, p = np.asarray(temperature, float), np.asarray(pressure, float)
    kelvin, ppm, wave2 = t + 273.15, 1.0e6 * co2, (1.0e-6 / wavelength) ** 2
    saturation = np.exp(1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6343.1645 / kelvin)
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    # Of no air at all there is no vapour either.
    vapour = np.where(p > 0.0, np.asarray(humidity, float) * enhancement * saturation / np.maximum(p, 1e-9), 0.0)
    dry = 1.0e-8 * (5792105.0 / (238.0185 - wave2) + 167917.0 / (57.362 - wave2)) \
        * (1.0 + 0.534e-6 * (ppm - 450.0))
    wet = 1.022e-8 * (295.235 + 2.6422 * wave2 - 0.032380 * wave2**2 + 0.004028 * wave2**3)
    molar = 1.0e-3 * (28.9635 + 12.011e-6 * (ppm - 400.0))
    per_kelvin = p / (_compressibility(t, p, vapour) * _GAS_CONSTANT * kelvin)
    dry_standard = 101325.0 * molar / (_compressibility(15.0, 101325.0, 0.0) * _GAS_CONSTANT * 288.15)
    wet_standard = 1333.0 * _WATER / (_compressibility(20.0, 1333.0, 1.0) * _GAS_CONSTANT * 293.15)
    return 1.0 + dry * per_kelvin * molar * (1.0 - vapour) / dry_standard \
        + wet * per_kelvin * _WATER * vapour / wet_standard


def _compressibility(t: np.ndarray, p: np.ndarray, vapour: np.ndarray) -> np.ndarray:
    """Compressibility of moist air; ``t`` [°C], ``p`` [Pa], ``vapour`` [mol/mol]."""
    ratio = p / (t + 273.15)
    return (1.0 - ratio * (1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
                           + (5.707e-6 - 2.051e-8 * t) * vapour + (1.9898e-4 - 2.376e-6 * t) * vapour**2)
            + ratio**2 * (1.83e-11 - 0.765e-8 * vapour**2))


def index_slopes(temperature: float, pressure: float, humidity: float, wavelength: float = WAVELENGTH,
                 co2: float = CO2) -> tuple[float, float, float]:
    """Derivatives of the index by temperature [1/K], pressure [1/Pa] and humidity [1]."""
    index = partial(refractive_index, wavelength=wavelength, co2=co2)
    point, slopes = [temperature, pressure, humidity], []
    for place, step in enumerate(_STEPS):
        ends = [float(index(*(value + sign * step * (i == place) for i, value in enumerate(point))))
                for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    return tuple(slopes)
