"""The refractive index of air.

After Bönsch and Potulski, *Measurement of the refractive index of air and comparison with
modified Edlén's formulae*, Metrologia 35 (1998) 133–139, with Giacomo's saturation pressure of
water vapour (Metrologia 18 (1982) 33).  At the interferometer's 1.53 µm the dispersion term is
extrapolated from the visible: an error of a few parts in 10⁸, which no change of the air alters.
"""

import numpy as np

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
