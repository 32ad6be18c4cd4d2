"""What a cell believes of its surroundings: the air where no topic tells, the material of scales and workpiece.

Both travel in the cell description (keys ``air`` and ``material``); an older reader ignores them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stepdiag_ros.errors import StepdiagError

QUANTITIES = ('temperature', 'pressure', 'humidity')
LIMITS = {'temperature': (-20.0, 60.0), 'pressure': (5.0e4, 1.2e5), 'humidity': (0.0, 1.0),
          'co2': (0.0, 0.01), 'wavelength': (0.3e-6, 1.69e-6)}
"""What is read as air at all, [°C, Pa, 1, mol/mol, m]: a hectopascal or a per cent is a mistake."""
UNSTATED_EXPANSION = 5.0e-6
"""Standard uncertainty [1/K] of an expansion coefficient that comes without one: glass or steel."""
UNSTATED_TEMPERATURE = 0.5
"""Standard uncertainty [K] of a temperature that the cell states without one."""


@dataclass(frozen=True)
class AirValues:
    """Air beside the beam as the cell's owner knows it; None: not said.

    ``temperature`` [°C], ``pressure`` [Pa], ``humidity`` [0..1]; ``co2`` [mol/mol]; ``wavelength`` [m] of the
    laser in vacuum.  ``sigma``: standard uncertainties of the first three, where they are stated.
    """

    temperature: float | None = None
    pressure: float | None = None
    humidity: float | None = None
    co2: float | None = None
    wavelength: float | None = None
    sigma: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        said = {key: value for key, value in vars(self).items() if key != 'sigma' and value is not None}
        return said | ({'sigma': dict(self.sigma)} if self.sigma else {})


@dataclass(frozen=True)
class Expansion:
    """Expansion coefficient of a scale or workpiece and its standard uncertainty [1/K]; its temperature [°C] and that
    one's [K] where the cell states it and no topic tells."""

    expansion: float
    sigma: float = UNSTATED_EXPANSION
    temperature: float | None = None
    temperature_sigma: float = UNSTATED_TEMPERATURE

    def to_dict(self) -> dict[str, float]:
        said = {'expansion': self.expansion, 'sigma': self.sigma}
        return said if self.temperature is None else said | {
            'temperature': self.temperature, 'temperature_sigma': self.temperature_sigma}


def air_of(get: Any, body: Any) -> AirValues | None:
    """``air`` of a cell description; ``get`` reads checked values."""
    if body is None:
        return None
    get.mapping(body, 'air')
    known = {key: get.number(body, f'air.{key}') for key in LIMITS if body.get(key) is not None}
    for key, value in known.items():
        low, high = LIMITS[key]
        if not low <= value <= high:
            raise StepdiagError(f'{get.source}: air.{key} is {value:g}; give a number from {low:g} to {high:g}')
    sigma = get.mapping(body.get('sigma') or {}, 'air.sigma')
    return AirValues(**known, sigma={key: get.number(sigma, f'air.sigma.{key}', minimum=0.0)
                                     for key in QUANTITIES if sigma.get(key) is not None})


def scales_of(get: Any, body: Any) -> dict[str, Expansion]:
    """``material.scales`` of a cell description by axis letter ``x``, ``y``, ``z``; those that are given."""
    if body is None:
        return {}
    scales = get.mapping(body, 'material').get('scales')
    if scales is None:
        return {}
    found = {}
    for axis, given in get.mapping(scales, 'material.scales').items():
        path = f'material.scales.{axis}'
        if axis not in ('x', 'y', 'z'):
            raise StepdiagError(f'{get.source}: {path}: unknown axis; name x, y, z')
        found[axis] = _expansion(get, given, path)
    return found


def workpiece_of(get: Any, body: Any) -> Expansion | None:
    """``material.workpiece`` of a cell description; None where it is not given."""
    given = None if body is None else get.mapping(body, 'material').get('workpiece')
    return None if given is None else _expansion(get, given, 'material.workpiece')


def _expansion(get: Any, given: Any, path: str) -> Expansion:
    """One material."""
    get.mapping(given, path)
    temperature = None if given.get('temperature') is None else get.number(given, f'{path}.temperature')
    low, high = LIMITS['temperature']
    if temperature is not None and not low <= temperature <= high:
        raise StepdiagError(f'{get.source}: {path}.temperature is {temperature:g}; give °C from {low:g} to {high:g}')
    return Expansion(get.number(given, f'{path}.expansion', minimum=0.0),
                     get.number(given, f'{path}.sigma', default=UNSTATED_EXPANSION, minimum=0.0), temperature,
                     get.number(given, f'{path}.temperature_sigma', default=UNSTATED_TEMPERATURE, minimum=0.0))


def scales_to_dict(scales: Mapping[str, Expansion]) -> dict[str, Any]:
    return {axis: own.to_dict() for axis, own in scales.items()}
