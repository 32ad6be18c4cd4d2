"""The air and the scales that a log was taken in, and how well each is known."""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.model.air import CO2, WAVELENGTH, index_slopes, refractive_index

NO_AIR = 3.0e-4 / np.sqrt(3.0)
"""Standard uncertainty of lengths that nobody corrected for air: an index somewhere from 1 to 1.0003."""
UNSEEN_VARIATION = 6.2e-7
"""Standard deviation of the index in a workshop that nobody watches over a calibration: 1 K and 200 Pa, half
widths of rectangular distributions."""
MOST_SCALE = 24.0e-6
"""Expansion [1/K] of aluminium: no scale expands more."""
ANY_SCALE = MOST_SCALE / np.sqrt(3.0)
"""Standard uncertainty [1/K] of the expansion of scales of which nothing is known: glass ceramics to aluminium."""
UNREFERRED = 0.5 * ANY_SCALE
"""Standard uncertainty [1] of a positioning error's slope at a temperature that is not referred to 20 °C: such scales
stay within about 0.5 K while they are measured.  Less where sensors show that they were nearer than that to 20 °C."""
PLAUSIBLE = {'temperature': (22.5, 12.5 / np.sqrt(3.0)), 'pressure': (96.0e3, 8.0e3 / np.sqrt(3.0)),
             'humidity': (0.5, 0.5 / np.sqrt(3.0))}
"""Value and standard uncertainty of what neither topics nor the cell tell: workshops from 10 °C to 35 °C, up to
1000 m above the sea, dry or wet."""


@dataclass(frozen=True)
class Conditions:
    """Where the log was taken: means of the air [°C, Pa, 0..1] and of the scales X, Y, Z [°C].

    ``air_sigma``: standard uncertainties [K, Pa, 1] of the air beyond its sensors'; ``unknown``: of the whole index,
    ``variation``: of what it does during a run and from run to run, uncorrected [1].
    ``expansion``, ``expansion_sigma`` (3,) [1/K]: NaN where the cell does not say; ``referred`` (3,): whether the
    axis's positioning error is referred to 20 °C; ``away`` (3,) [K]: root mean square distance of a scale from 20 °C,
    NaN where no sensor shows it.  ``scale_sigma`` (3,) [K]: of temperatures of scales that the cell states, 0 of those
    that a sensor shows.
    """

    temperature: float = 20.0
    pressure: float = 101325.0
    humidity: float = 0.5
    scales: tuple[float, float, float] = (20.0, 20.0, 20.0)
    wavelength: float = WAVELENGTH
    co2: float = CO2
    air_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unknown: float = 0.0
    variation: float = 0.0
    expansion: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    expansion_sigma: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    referred: tuple[bool, bool, bool] = (True, True, True)
    away: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    scale_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def air(self) -> tuple[float, float, float]:
        return self.temperature, self.pressure, self.humidity

    @property
    def index(self) -> float:
        return float(refractive_index(*self.air, self.wavelength, self.co2))

    def index_slope(self, kind: str) -> float:
        """Derivative of the index of air by temperature [1/K], pressure [1/Pa] or humidity [1]."""
        place = ('air_temperature', 'air_pressure', 'humidity').index(kind)
        return index_slopes(*self.air, self.wavelength, self.co2)[place]

    def index_sigma(self, temperature: float, pressure: float, humidity: float) -> float:
        """Standard uncertainty of the index by those of the three quantities [K, Pa, 1]."""
        return float(np.linalg.norm(np.array([temperature, pressure, humidity])
                                    * index_slopes(*self.air, self.wavelength, self.co2)))
