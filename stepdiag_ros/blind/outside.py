"""Effects that are not in the vocabulary: the right answer to them is "something else".

Some have nothing in common with any effect of the vocabulary, some were made to look like one:
thermal bending like squareness drift, a twist on reversal like backlash, a mirror that slips
like one that creeps, mode hopping like a drift of the air, hum on the detector like vibration.
What no log of this plan could tell from an effect of the vocabulary is not drawn: a step that an
axis loses in a run shifts the distance by a constant, as a slip of the counter does.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.hidden import Hidden, Stage, direction, place_of
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.log import CalibrationLog


class Outside(Hidden):
    """Base of them."""

    outside = True


class StickSlip(Outside):
    """now and then an arrival is short by a random amount, until the next move shakes it loose"""

    name, typical, largest, random = 'stick_slip', 2e-6, 1e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._error = np.where(rng.random(8000) < rng.uniform(0.05, 0.25), 1.0, 0.0) \
            * rng.exponential(1.0, 8000)

    def before_pose(self, moment: Moment) -> None:
        short = self.size * self._error[moment.arrival % len(self._error)]
        moved = moment.moved[:, None] == np.arange(3)
        moment.position = moment.position - np.where(moved, moment.approach, 0.0) * short[:, None]


class AmplifierSaturation(Outside):
    """the reading is compressed beyond a part of the range, as the square of the excess"""

    name, typical, largest = 'amplifier_saturation', 2e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._range = float(np.linalg.norm(stage.travel))
        self._knee = rng.uniform(0.3, 0.6)
        self.facts = {'knee': self._knee}

    def after_light(self, moment: Moment) -> None:
        excess = np.maximum(moment.length / self._range - self._knee, 0.0) / (1.0 - self._knee)
        moment.length = moment.length - self.size * excess ** 2


class ThermalBending(Outside):
    """a guideway bends with time: its straightness changes its shape (like squareness drift)"""

    name, typical, largest = 'thermal_bending', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profile, kind = stage.profile(rng)
        self._axis = int(rng.integers(3))
        self._across = (self._axis + int(rng.integers(1, 3))) % 3
        self._waves = float(rng.choice([1.0, 2.0]))
        self.facts = {'profile': kind, 'axis': self._axis, 'across': self._across, 'waves': self._waves}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        bow = self.size * self._profile(moment.seconds) * np.sin(np.pi * self._waves * place)
        moment.shift = moment.shift + bow[:, None] * np.eye(3)[self._across]


class MirrorSlip(Outside):
    """the mirror jumps in its mount in the middle of a run (like mount creep)"""

    name, unit, typical, largest = 'mirror_slip', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        begin, end = stage.runs[rng.integers(len(stage.runs))]
        self._time = float(begin + (end - begin) * rng.uniform(0.2, 0.8))
        self._vector = direction(rng, 2)
        self.facts = {'time_s': self._time}

    def before_light(self, moment: Moment) -> None:
        moment.mirror = moment.mirror + self.size * (
            (moment.seconds >= self._time)[:, None] * self._vector)


class SpotCrosstalk(Outside):
    """the spot's sideways motion leaks into the distance through the electronics, bent"""

    name, unit, typical, largest = 'spot_crosstalk', 'm at 1 mm', 2e-6, 2e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector = direction(rng, 2)
        self.facts = {'direction': self._vector.tolist()}

    def after_light(self, moment: Moment) -> None:
        along = moment.spot @ self._vector / 1e-3
        moment.length = moment.length + self.size * np.tanh(along)[:, None]


class AirTurbulence(Outside):
    """the air is turbulent: noise with a 1/f spectrum on the distance, more of it over a long path"""

    name, typical, largest, random = 'air_turbulence', 1e-7, 2e-5, True
    LINES = 120

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._frequency = np.exp(rng.uniform(np.log(0.02), np.log(5.0), self.LINES))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, self.LINES)
        self._power = rng.uniform(0.5, 1.5)

    def after_light(self, moment: Moment) -> None:
        # Lines drawn evenly in the logarithm of frequency with equal amplitudes are 1/f.
        turbulence = np.zeros(len(moment.seconds))
        for frequency, phase in zip(self._frequency, self._phase, strict=True):
            turbulence += np.sin(2.0 * np.pi * frequency * moment.seconds + phase)
        path = moment.length / float(np.linalg.norm(self.stage.travel))
        moment.length = moment.length + self.size * np.sqrt(2.0 / self.LINES) \
            * turbulence[:, None] * np.maximum(path, 0.0) ** self._power


class ReversalTwist(Outside):
    """cables twist the head by an angle that depends on the direction of motion (like backlash)"""

    name, unit, typical, largest = 'reversal_twist', 'rad', 1e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._vector = int(rng.integers(3)), direction(rng)
        self.facts = {'axis': self._axis, 'vector': self._vector.tolist()}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        drag = self.size * moment.approach[:, self._axis] * (0.5 + place)
        moment.turn = moment.turn + drag[:, None] * self._vector


class AdcQuantisation(Outside):
    """the detector's converter has lost its lower bits"""

    name, typical, largest, random = 'adc_quantisation', 5e-6, 5e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._shift = rng.random(2)

    def spoil(self, log: CalibrationLog) -> CalibrationLog:
        counts = np.rint(log.spot.values / self.size + self._shift) - self._shift
        return replace(log, spot=replace(log.spot, values=counts * self.size))


class MainsHum(Outside):
    """the mains hum on one channel of the detector (like vibration)"""

    name, typical, largest, random, inside = 'mains_hum', 3e-7, 5e-5, True, 'random'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector, self._phase = direction(rng, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        self._mains = float(rng.choice([50.0, 60.0])) * (1.0 + 1e-3 * rng.standard_normal())
        self.facts = {'mains_Hz': self._mains}

    def after_light(self, moment: Moment) -> None:
        wave = np.sin(2.0 * np.pi * self._mains * moment.seconds + self._phase[0]) \
            + 0.4 * np.sin(4.0 * np.pi * self._mains * moment.seconds + self._phase[1])
        moment.spot = moment.spot + self.size * wave[:, None] * self._vector


class BeamWalkOff(Outside):
    """the returning beam walks off the receiver and the phase with it: the spot's square and cube"""

    name, unit, typical, largest = 'beam_walk_off', 'm at 1 mm', 1e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._bend = rng.normal(0.0, 0.4)

    def after_light(self, moment: Moment) -> None:
        walk = np.linalg.norm(moment.spot, axis=1) / 1e-3
        moment.length = moment.length + (self.size * (walk ** 2 + self._bend * walk ** 3))[:, None]


class ModeHopping(Outside):
    """the laser hops between two modes: lengths are scaled now by one, now by the other factor"""

    name, unit, typical, largest = 'mode_hopping', '1', 5e-7, 5e-5

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        begin, end = stage.runs[:, 0].min(), stage.runs[:, 1].max()
        self._hops = np.sort(rng.uniform(begin, end, int(rng.integers(25, 120))))
        self.facts = {'hops': len(self._hops)}

    def after_light(self, moment: Moment) -> None:
        other = np.sum(moment.seconds[:, None] >= self._hops, axis=1) % 2
        moment.length = moment.length * (1.0 + self.size * other)[:, None]


OUTSIDE = (StickSlip, AmplifierSaturation, ThermalBending, MirrorSlip, SpotCrosstalk, AirTurbulence,
           ReversalTwist, AdcQuantisation, MainsHum, BeamWalkOff, ModeHopping)
