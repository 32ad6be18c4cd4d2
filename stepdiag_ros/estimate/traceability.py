"""Whether a result is in metres, and at which temperature: what every answer carries beside its numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.estimate.workpiece import PartExpansion

REFERENCE_TEMPERATURE = 20.0
"""[°C] of ISO 1."""
INSTRUMENT, TOPICS, CONSTANT, CELL, NOBODY = (
    'instrument', 'topics', 'instrument constant', 'cell', 'nobody')
"""Who divided the index of air out: the instrument, following the air; the evaluation, by the environment topics;
the instrument, by one constant that nothing checks; the evaluation, by the cell's `air:` values; nobody."""
WORDS = {INSTRUMENT: 'the instrument divided the index of air out',
         TOPICS: 'the index of air is divided out by the environment topics',
         CONSTANT: 'the instrument divided by one constant index, and no topic shows what the air did meanwhile',
         CELL: "the index of air is divided out by the cell's air: values",
         NOBODY: 'not corrected for air'}


@dataclass(frozen=True)
class Traceability:
    """How a result is tied to the metre and to 20 °C.

    ``air``: one of :data:`WORDS`; ``index``: mean index of air that counts, 1.0 where not corrected;
    ``index_sigma``: standard uncertainty of the index, one value for the whole log [1].
    ``reference_temperature``: 20.0 where the positioning errors are referred to it, else None.
    ``measured_at``: mean scale temperatures [°C] by axis letter, of the axes that have a sensor.
    ``correction_m``: what was added to a positioning error to refer it to 20 °C, by name, (k,) [m] at its positions;
    ``correction_sigma_m``: its standard uncertainty.
    ``remarks``: what a reader must know before acting on the result, a sentence each.
    ``budget``: ``cell`` where the cell states one of its own, else ``standard``.  ``workpiece``: what its temperature
    does to parts, or in words what is not known of it.
    """

    air: str = INSTRUMENT
    index: float = 1.0
    index_sigma: float = 0.0
    reference_temperature: float | None = None
    measured_at: Mapping[str, float] = field(default_factory=dict)
    correction_m: Mapping[str, np.ndarray] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    budget: str = 'standard'
    workpiece: PartExpansion | str = 'temperature and expansion of the workpiece are unknown'
    correction_sigma_m: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def traceable(self) -> bool:
        """Whether the lengths are metres: somebody took the air into account."""
        return self.air != NOBODY

    @property
    def status(self) -> str:
        """``ok``, or that the lengths are none: the status of a result that is good otherwise."""
        return 'ok' if self.traceable else WORDS[NOBODY]

    @property
    def temperature_words(self) -> str:
        """At which temperature the result holds, in words."""
        if self.reference_temperature is not None:
            return f'referred to {self.reference_temperature:g} °C'
        if self.measured_at:
            referred = [axis for axis in self.measured_at if f'E{axis.upper() * 2}' in self.correction_m]
            places = ', '.join(f'{axis.upper()} {value:.2f} °C' for axis, value in self.measured_at.items()
                               if axis not in referred)
            some = ', '.join(f'E{axis.upper() * 2}' for axis in referred)
            rest = f'at the temperature of the scales while they were measured ({places}), not referred to 20 °C' \
                if places else 'at the temperature of the measurement, which is unknown'
            return f'{some} referred to {REFERENCE_TEMPERATURE:g} °C; the others {rest}' if some else rest
        return 'at the temperature of the measurement, which is unknown'

    @property
    def workpiece_words(self) -> str:
        """What is known of the workpiece, in words."""
        return self.workpiece if isinstance(self.workpiece, str) else self.workpiece.words

    def to_json_dict(self) -> dict[str, Any]:
        return {'workpiece': self.workpiece_words if isinstance(self.workpiece, str) else self.workpiece.to_json_dict(),
                'air': self.air, 'traceable': self.traceable, 'index': self.index, 'index_sigma': self.index_sigma,
                'reference_temperature': self.reference_temperature,
                'measured_at_C': dict(self.measured_at) or None, 'temperature': self.temperature_words,
                'correction_to_20C_m': {name: [float(v) for v in values]
                                        for name, values in self.correction_m.items()},
                'correction_to_20C_sigma_m': {name: [float(v) for v in self.correction_sigma_m[name]]
                                              for name in self.correction_m},
                'budget': self.budget, 'remarks': list(self.remarks)}
