"""What the workpiece's temperature does to parts: its own expansion, beside the machine's errors at 20 °C.

A part is made at the temperatures of scales T_s and workpiece T_w, and counts at 20 °C (ISO 1).  Errors of the machine
at 20 °C are free of both expansions; made at these temperatures and measured at 20 °C the part is off besides, at a
position x along an axis, by the differential expansion

    (α_s (T_s − 20 °C) − α_w (T_w − 20 °C)) x
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

REFERENCE = 20.0
"""[°C] of ISO 1."""
TOPIC, CELL = 'topic', 'cell'


@dataclass(frozen=True)
class PartExpansion:
    """Temperature of the workpiece [°C] and what it rests on (``by``: ``topic`` or ``cell``), its coefficient [1/K],
    each with its standard uncertainty; by curve name the differential expansion (k,) [m] at the positions of
    the positioning errors that are referred to 20 °C, with its standard uncertainty."""

    temperature: float
    temperature_sigma: float
    by: str
    expansion: float
    expansion_sigma: float
    differential_m: Mapping[str, np.ndarray]
    sigma_m: Mapping[str, np.ndarray]

    def to_json_dict(self) -> dict[str, Any]:
        def lists(curves: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
            return {name: [float(v) for v in values] for name, values in curves.items()}
        return {'said': self.words, 'by': self.by,
                'temperature_C': self.temperature, 'temperature_sigma_K': self.temperature_sigma,
                'expansion': self.expansion, 'expansion_sigma': self.expansion_sigma,
                'differential_m': lists(self.differential_m), 'differential_sigma_m': lists(self.sigma_m)}

    @property
    def words(self) -> str:
        """One sentence."""
        said = (f'the workpiece had {self.temperature:.2f} ± {2.0 * self.temperature_sigma:.2f} °C (k = 2, {self.by}) '
                f'with {1e6 * self.expansion:.2f} ± {2e6 * self.expansion_sigma:.2f} µm/(m·K) (k = 2)')
        ends = ', '.join(f'{name} {1e6 * values[-1]:+.3f} ± {2e6 * self.sigma_m[name][-1]:.3f} µm'
                         for name, values in self.differential_m.items())
        return said if not ends else \
            f'{said}; a part made at these temperatures is off besides, at 20 °C, by {ends} at the ends (k = 2)'


def part_expansion(temperature: float, temperature_sigma: float, by: str, expansion: tuple[float, float],
                   scales: Mapping[str, tuple[float, float, float, float]], positions: Mapping[str, np.ndarray]
                   ) -> PartExpansion:
    """``expansion``: of the workpiece with its standard uncertainty [1/K]; ``scales``: curve name → temperature [°C],
    its σ [K], coefficient, its σ [1/K] of the scale; ``positions`` (k,) [m] by curve name."""
    warm, differential, sigma = temperature - REFERENCE, {}, {}
    for name, (scale, scale_sigma, own, own_sigma) in scales.items():
        place = np.asarray(positions[name], float)
        differential[name] = (own * (scale - REFERENCE) - expansion[0] * warm) * place
        sigma[name] = np.linalg.norm([own * scale_sigma, own_sigma * (scale - REFERENCE),
                                      expansion[0] * temperature_sigma, expansion[1] * warm]) * np.abs(place)
    return PartExpansion(temperature, temperature_sigma, by, *expansion, differential, sigma)
