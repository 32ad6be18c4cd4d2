"""How the detector misbehaves in the sealed world."""

import numpy as np

from stepdiag_ros.blind.hidden import ANY, Hidden, Stage, direction
from stepdiag_ros.effects.base import Moment

HALF_EDGE = 5e-3
"""[m] from the detector's centre to its edge."""


class PsdZeroOffset(Hidden):
    """an offset that differs a little from setup to setup"""

    name, typical, largest = 'psd_zero_offset', 5e-6, 2e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        main = direction(rng, 2)
        self._offset = {name: main + 0.1 * rng.standard_normal(2) for name in stage.cell.setup_names}
        self.facts = {'direction': main.tolist()}

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot + self.size * self._offset[moment.setup]


class PsdGain(Hidden):
    """gains apart in x and y, and sinking a little in the course of the log"""

    name, unit, typical, largest = 'psd_gain', '1', 0.02, 0.4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._gain = rng.uniform(-1.0, 1.0, 2)
        self._gain /= np.abs(self._gain).max()
        self._ageing = rng.uniform(-0.15, 0.15)
        self.facts = {'gain': self._gain.tolist()}

    def after_light(self, moment: Moment) -> None:
        late = 1.0 + self._ageing * moment.seconds / self.stage.span_s
        moment.spot = moment.spot * (1.0 + self.size * late[:, None] * self._gain)


class PsdNonlinearity(Hidden):
    """pincushion with cross terms, unlike in x and y; size: relative error at the edge"""

    name, unit, typical, largest = 'psd_nonlinearity', '1', 0.05, 0.6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        sign = rng.choice([-1.0, 1.0])
        self._cubic = sign * rng.uniform(0.5, 1.0, 2)
        self._cross = sign * rng.uniform(0.2, 1.0, 2)
        self._quintic = 0.5 * rng.standard_normal(2)
        self.facts = {'cubic': self._cubic.tolist(), 'cross': self._cross.tolist()}

    def after_light(self, moment: Moment) -> None:
        x = moment.spot / HALF_EDGE
        square = x ** 2
        bend = self._cubic * square + self._cross * square[:, ::-1] + self._quintic * square ** 2
        moment.spot = moment.spot * (1.0 + self.size * bend)


class PsdRotation(Hidden):
    """turned by nearly the same angle in each setup"""

    name, unit, typical, largest = 'psd_rotation', 'rad', 0.02, 0.35

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        sign = rng.choice([-1.0, 1.0])
        self._turn = {name: sign * (1.0 + 0.1 * rng.standard_normal())
                      for name in stage.cell.setup_names}

    def after_light(self, moment: Moment) -> None:
        angle = self.size * self._turn[moment.setup]
        x, y = moment.spot.T
        moment.spot = np.stack([np.cos(angle) * x - np.sin(angle) * y,
                                np.sin(angle) * x + np.cos(angle) * y], axis=1)


class AmbientLight(Hidden):
    """lamps go on and off while daylight changes slowly; size: background over signal

    ``beam``: light in the beam of setups in which there is less than the full.
    """

    name, unit, typical, largest = 'ambient_light', '1', 0.02, 0.4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._daylight, kind = stage.profile(rng, ANY)
        self._switch = np.sort(rng.uniform(0.0, stage.span_s, int(rng.integers(1, 6))))
        self._lamp = rng.uniform(0.2, 1.0)
        self.beam: dict[str, float] = {}
        self.facts = {'profile': kind, 'switched_s': self._switch.tolist()}

    def after_light(self, moment: Moment) -> None:
        lamp = np.sum(moment.seconds[:, None] >= self._switch, axis=1) % 2
        day = self._daylight(moment.seconds)
        light = self.size * (np.abs(day) + self._lamp * lamp) / self.beam.get(moment.setup, 1.0)
        moment.spot = moment.spot / (1.0 + light)[:, None]
        moment.intensity = moment.intensity * (1.0 + light)
