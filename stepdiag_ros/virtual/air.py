"""The air of a virtual cell and its refractive index.

Index of air after Bönsch and Potulski, *Measurement of the refractive index of air
and comparison with modified Edlén's formulae*, Metrologia 35 (1998) 133–139, with
Giacomo's saturation pressure of water vapour (Metrologia 18 (1982) 33).  At the
interferometer's 1.53 µm the dispersion term is extrapolated from the visible; the
error, a few parts in 10⁸, is common to simulation and compensation.
"""

import numpy as np

from stepdiag_ros.virtual.cell import Air

WAVELENGTH = 1.53e-6
"""Vacuum wavelength [m] of the IDS3010's laser."""


def refractive_index(temperature: np.ndarray, pressure: np.ndarray, humidity: np.ndarray,
                     wavelength: float = WAVELENGTH) -> np.ndarray:
    """Index of air at ``temperature`` [°C], ``pressure`` [Pa], relative ``humidity`` [0..1]."""
    t = np.asarray(temperature, float)
    p = np.asarray(pressure, float)
    sigma2 = (1.0e-6 / wavelength) ** 2
    standard = 1.0e-8 * (8091.37 + 2333983.0 / (130.0 - sigma2) + 15518.0 / (38.9 - sigma2))
    dry = standard * p / 93214.60 * (1.0 + 1.0e-8 * (0.5953 - 0.009876 * t) * p) \
        / (1.0 + 0.0036610 * t)
    kelvin = t + 273.15
    saturation = np.exp(1.2378847e-5 * kelvin ** 2 - 1.9121316e-2 * kelvin + 33.93711047
                        - 6343.1645 / kelvin)
    vapour = np.asarray(humidity, float) * saturation
    return 1.0 + dry - vapour * (3.8020 - 0.0384 * sigma2) * 1.0e-10


def conditions(air: Air, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Temperature [°C], pressure [Pa] and humidity [0..1] after ``seconds`` (n,)."""
    hours = np.asarray(seconds, float) / 3600.0
    return (air.temperature + air.temperature_drift * hours,
            air.pressure + air.pressure_drift * hours,
            np.clip(air.humidity + air.humidity_drift * hours, 0.0, 1.0))


def index_at(air: Air, seconds: np.ndarray) -> np.ndarray:
    """Index of air (n,) after ``seconds`` (n,)."""
    return refractive_index(*conditions(air, seconds))
