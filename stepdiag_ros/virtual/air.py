"""The air of a virtual cell: its weather and the index that follows from it."""

from collections.abc import Sequence

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.virtual.cell import Air


def conditions(air: Air, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Temperature [°C], pressure [Pa] and humidity [0..1] after ``seconds`` (n,)."""
    hours = np.asarray(seconds, float) / 3600.0
    return (air.temperature + air.temperature_drift * hours,
            air.pressure + air.pressure_drift * hours,
            np.clip(air.humidity + air.humidity_drift * hours, 0.0, 1.0))


def index_at(air: Air, seconds: np.ndarray) -> np.ndarray:
    """Index of air (n,) after ``seconds`` (n,)."""
    return refractive_index(*conditions(air, seconds))


def scale_temperature(air: Air, seconds: np.ndarray) -> np.ndarray:
    """Temperatures (n, 3) [°C] of the scales of X, Y, Z after ``seconds`` (n,)."""
    hours = np.asarray(seconds, float)[:, None] / 3600.0
    return np.array(air.scale_temperature) + np.array(air.scale_drift) * hours


def environment(air: Air, seconds: np.ndarray, effects: Sequence[Effect] = ()) -> dict[str, np.ndarray]:
    """What sensors in the cell would see (n,), by the names of
    :attr:`~stepdiag_ros.model.log.CalibrationLog.environment`: the weather and what the effects add."""
    seconds = np.atleast_1d(np.asarray(seconds, float))
    seen = dict(zip(('air_temperature', 'air_pressure', 'humidity'), conditions(air, seconds),
                    strict=True))
    seen |= {f'scale_temperature/{axis}': value for axis, value in zip(
        'xyz', scale_temperature(air, seconds).T, strict=True)}
    for effect in effects:
        for name, change in effect.environment(seconds).items():
            seen[name] = seen[name] + change
    return seen
