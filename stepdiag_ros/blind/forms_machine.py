"""How machine, control and clocks misbehave in the sealed world."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import ANY, Hidden, Stage, chosen_axes, direction
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog, Samples


class ScaleThermalExpansion(Hidden):
    """scales warm on profiles of their own and grow from a point that is not the origin; size: warming"""

    name, unit, typical, largest = 'scale_thermal_expansion', 'degC', 0.3, 15.0

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profiles, kinds = stage.profiles(rng, 3)
        self._weight = chosen_axes(rng)
        self._coefficient = float(rng.choice([8e-6, 1.05e-5, 1.2e-5]))
        self._fixed = stage.travel * rng.choice([0.0, 0.5, 1.0], 3)
        self.facts = {'profiles': kinds, 'weight': self._weight.tolist(),
                      'per_kelvin': self._coefficient, 'fixed_m': self._fixed.tolist()}

    def warming(self, seconds):
        return self.size * self._weight * np.stack([c(seconds) for c in self._profiles], axis=1)

    def before_pose(self, moment: Moment) -> None:
        grown = self._coefficient * self.warming(moment.seconds)
        moment.position = moment.position + grown * (moment.commanded - self._fixed)


class StructuralThermalDrift(Hidden):
    """each direction on a profile of its own"""

    name, typical, largest = 'structural_thermal_drift', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profiles, kinds = stage.profiles(rng, 3, ANY)
        self._weight = direction(rng)
        self.facts = {'profiles': kinds, 'direction': self._weight.tolist()}

    def before_pose(self, moment: Moment) -> None:
        moment.shift = moment.shift + self.size * self._weight * np.stack(
            [c(moment.seconds) for c in self._profiles], axis=1)


class Backlash(Hidden):
    """lost motion that varies along the axis and with the load that another axis brings"""

    name, typical, largest = 'backlash', 1e-6, 3e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._weight = np.abs(chosen_axes(rng))
        self._wave, self._phase = rng.uniform(0.0, 0.4, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
        self._periods = rng.uniform(0.5, 2.0, 3)
        self._load = rng.uniform(-0.3, 0.3, 3)
        self.facts = {'weight': self._weight.tolist(), 'wave': self._wave.tolist(),
                      'load': self._load.tolist()}

    def before_pose(self, moment: Moment) -> None:
        place = moment.commanded / self.stage.travel
        lost = self._weight * (
            1.0 + self._wave * np.sin(2.0 * np.pi * self._periods * place + self._phase)
            + self._load * np.roll(place - 0.5, 1, axis=1))
        moment.position = moment.position - 0.5 * self.size * lost * moment.approach


class ServoSettling(Hidden):
    """a fast and a slow time constant, the fast one swinging; longer after long moves"""

    name, typical, largest, inside = 'servo_settling', 3e-7, 3e-5, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._weight = np.abs(chosen_axes(rng))
        self._fast, self._slow = rng.uniform(0.03, 0.12), rng.uniform(0.1, 0.5)
        self._share, self._swing = rng.uniform(0.2, 0.6), rng.uniform(0.0, 6.0)
        self.facts = {'weight': self._weight.tolist(), 'fast_s': self._fast, 'slow_s': self._slow,
                      'swing_Hz': self._swing}

    def before_pose(self, moment: Moment) -> None:
        since = np.maximum(moment.since_arrival, 0.0)
        left = (self._share * np.exp(-since / self._fast) * np.cos(2.0 * np.pi * self._swing * since)
                + (1.0 - self._share) * np.exp(-since / self._slow))
        moved = moment.moved[:, None] == np.arange(3)
        moment.position = moment.position - self.size * self._weight * np.where(
            moved, moment.approach, 0.0) * left[:, None]


class NonRigidCoupling(Hidden):
    """one or two axes whose motion depends on another's place: saddles of sines and powers"""

    name, typical, largest = 'non_rigid_coupling', 1e-6, 8e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._terms = []
        for _ in range(int(rng.choice([1, 2], p=[0.7, 0.3]))):
            own, other = rng.permutation(3)[:2]
            self._terms.append((int(own), int(other), int(rng.integers(3)), rng.uniform(0.6, 2.2),
                                rng.uniform(0.8, 2.0), bool(rng.random() < 0.4),
                                float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0))))
        self.facts = {'own_other_motion': [t[:3] for t in self._terms],
                      'angular': [t[5] for t in self._terms]}

    def before_pose(self, moment: Moment) -> None:
        # Rounding may leave a start corner a hair below zero.
        place = np.clip(moment.commanded / self.stage.travel, 0.0, 1.0)
        tool = np.array(self.stage.cell.description.machine.tool)
        for own, other, motion, rise, bend, angular, weight in self._terms:
            value = self.size * weight * np.sin(0.5 * np.pi * rise * place[:, own]) \
                * place[:, other] ** bend
            vector = value[:, None] * np.eye(3)[motion]
            if not angular:
                moment.shift = moment.shift + vector
                continue
            # The same metres at the end of an arm of half the travel, as a turn.
            vector = vector / (0.5 * float(self.stage.travel.max()))
            arm = moment.commanded * (np.arange(3) != own) + tool
            moment.turn = moment.turn + vector
            moment.shift = moment.shift + np.cross(vector, arm)


class SquarenessDrift(Hidden):
    """one to three of the angles change, each on a profile of its own"""

    name, unit, typical, largest = 'squareness_drift', 'rad', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profiles, kinds = stage.profiles(rng, 3)
        self._weight = chosen_axes(rng)
        self.facts = {'profiles': kinds, 'EC0Y_EB0Z_EA0Z': self._weight.tolist()}

    def before_pose(self, moment: Moment) -> None:
        square = self.size * self._weight * np.stack([c(moment.seconds) for c in self._profiles], axis=1)
        _, y, z = moment.commanded.T
        moment.shift = moment.shift + np.stack(
            [-square[:, 0] * y + square[:, 1] * z, -square[:, 2] * z, 0.0 * z], axis=1)


class Vibration(Hidden):
    """two frequencies in different directions whose amplitudes grow during the log"""

    name, typical, largest, inside = 'vibration', 2e-8, 5e-6, 'random'
    random = True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._frequency = np.exp(rng.uniform(np.log(3.0), np.log(60.0), 2))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        self._vector = np.stack([direction(rng), rng.uniform(0.2, 0.9) * direction(rng)])
        self._growth = rng.uniform(0.0, 2.0)
        self.facts = {'frequency_Hz': self._frequency.tolist(), 'vector': self._vector.tolist(),
                      'growth': self._growth}

    def before_pose(self, moment: Moment) -> None:
        swing = np.sin(2.0 * np.pi * self._frequency * moment.seconds[:, None] + self._phase)
        strength = self.size * (1.0 + self._growth * moment.seconds / self.stage.span_s)
        moment.shift = moment.shift + strength[:, None] * (swing @ self._vector)


class ClockSkew(Hidden):
    """one sensor's stamps are off, by an offset and by a clock that runs a little wrong"""

    name, unit, typical, largest = 'clock_skew', 's', 0.01, 0.08
    inside, drawn = 'stamps', (3e-3, 6e-2)

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._sensor = str(rng.choice(['interferometer', 'psd', 'both']))
        self._sign = float(rng.choice([-1.0, 1.0]))
        self._drift = rng.uniform(-0.3, 0.3)
        self.facts = {'sensor': self._sensor, 'sign': self._sign, 'drift': self._drift}

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        changed = {}
        if self._sensor != 'psd':
            changed['displacement'] = self._late(log.displacement)
        if self._sensor != 'interferometer':
            changed['spot'] = self._late(log.spot)
        return replace(log, **changed)

    def _late(self, samples: Samples) -> Samples:
        # A block carries one stamp, so it is late as a whole.
        first = np.concatenate([[True], np.diff(samples.block) != 0])
        begin = samples.time_ns[first][np.cumsum(first) - 1]
        share = (begin - begin[0]) * 1e-9 / self.stage.span_s
        late = self._sign * self.size * (1.0 + self._drift * share)
        return replace(samples, time_ns=samples.time_ns + np.rint(late * 1e9).astype(np.int64))


