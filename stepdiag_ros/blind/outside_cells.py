"""Effects from outside that act where some effect of the vocabulary does and follow what no effect there follows.

Guideways that remember the direction or the weather, axes that move each other, detectors and beams that repeat,
leak or stick, air in layers.  Those that a log could not tell from an effect of the vocabulary acting where it
acts are not among them: a dent in the mirror is the mirror's form, a crash that tilts a column is its squareness.
"""

import numpy as np

from stepdiag_ros.blind.hidden import Stage, direction, place_of
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.blind.outside_more import states
from stepdiag_ros.effects.base import Moment
from stepdiag_ros.model.machine import carried
from stepdiag_ros.model.sensor import station


def _two(rng: np.random.Generator) -> tuple[int, int]:
    """Two different axes."""
    first, second = rng.permutation(3)[:2]
    return int(first), int(second)


class ScrewWarmMiddle(Outside):
    """a screw warms where it works most: positions in the middle of an axis move, its ends do not"""

    name, typical, largest = 'screw_warm_middle', 2e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profile, kind = stage.profile(rng)
        self._axis, self._middle, self._width = int(rng.integers(3)), rng.uniform(0.3, 0.7), rng.uniform(0.15, 0.3)
        self.facts = {'profile': kind, 'axis': self._axis, 'middle': self._middle}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        bump = np.exp(-0.5 * ((place - self._middle) / self._width) ** 2)
        moment.position = moment.position + (self.size * self._profile(moment.seconds) * bump)[:, None] \
            * np.eye(3)[self._axis]


class GuidewayTwists(Outside):
    """a guideway twists with time: its roll, pitch or yaw changes its shape"""

    name, unit, typical, largest = 'guideway_twists', 'rad', 3e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._profile, kind = stage.profile(rng)
        self._axis, self._about, self._waves = int(rng.integers(3)), int(rng.integers(3)), float(rng.choice([0.5, 1.0]))
        self.facts = {'profile': kind, 'axis': self._axis, 'about': self._about}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        machine, turns = moment.description.machine, np.zeros((3, len(place), 3))
        shape = np.sin(np.pi * self._waves * place)
        turns[self._axis, :, self._about] = self.size * self._profile(moment.seconds) * shape
        moment.shift = moment.shift + carried(machine.chain, moment.commanded, 0.0 * turns, turns, machine.tool)
        moment.turn = moment.turn + turns[self._axis]


class TwoFacedGuideway(Outside):
    """a guideway is straight one way and bent the other: the carriage climbs on another flank"""

    name, typical, largest = 'two_faced_guideway', 2e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._across = _two(rng)
        self._waves = float(rng.choice([1.0, 2.0]))
        self.facts = {'axis': self._axis, 'across': self._across, 'waves': self._waves}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        bow = self.size * (moment.approach[:, self._axis] < 0.0) * np.sin(np.pi * self._waves * place)
        moment.shift = moment.shift + bow[:, None] * np.eye(3)[self._across]


class Afterglow(Outside):
    """the detector glows on: a part of the spot of the stop before is still seen"""

    name, unit, typical, largest = 'afterglow', '1', 0.01, 0.6

    def after_light(self, moment: Moment) -> None:
        known, number = np.unique(moment.arrival, return_inverse=True)
        still = moment.since_arrival >= 0.0
        weight = np.bincount(number, still)
        mean = np.stack([np.bincount(number, still * axis) for axis in moment.spot.T], axis=1) \
            / np.maximum(weight, 1.0)[:, None]
        seen = np.isin(known - 1, known) & (weight > 0.0)
        seen[1:] &= weight[:-1] > 0.0
        before = np.where(seen[:, None], np.roll(mean, 1, axis=0), mean)
        moment.spot = moment.spot + self.size * (before - mean)[number]


class WarmLayers(Outside):
    """the air lies in layers, warm above cold: a length is the longer the higher its path"""

    name, unit, typical, largest = 'warm_layers', '1/m', 2e-6, 3e-5

    def after_light(self, moment: Moment) -> None:
        machine, setup = moment.description.machine, moment.description.setups[moment.setup]
        height = 0.5 * (moment.commanded[:, 2] + station(machine, setup).origin[2])
        moment.length = moment.length * (1.0 + self.size * height[:, None])


class GhostReflection(Outside):
    """light from the back of a window runs beside the beam: the spot moves to and fro as it wanders"""

    name, typical, largest = 'ghost_reflection', 3e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._along, self._way = direction(rng, 2), direction(rng, 2)
        self._period, self._phase = rng.uniform(2e-4, 8e-4), rng.uniform(0.0, 2.0 * np.pi)
        self.facts = {'period_m': self._period}

    def after_light(self, moment: Moment) -> None:
        swing = np.sin(2.0 * np.pi * (moment.spot @ self._along) / self._period + self._phase)
        moment.spot = moment.spot + self.size * swing[:, None] * self._way


class TiltFringes(Outside):
    """the returning beam meets a fixed one at an angle: lengths swing as the spot wanders"""

    name, typical, largest = 'tilt_fringes', 1e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._along = direction(rng, 2)
        self._period, self._phase = rng.uniform(2e-4, 8e-4), rng.uniform(0.0, 2.0 * np.pi)
        self.facts = {'period_m': self._period}

    def after_light(self, moment: Moment) -> None:
        swing = np.sin(2.0 * np.pi * (moment.spot @ self._along) / self._period + self._phase)
        moment.length = moment.length + self.size * swing[:, None]


class LooseDetector(Outside):
    """the detector is loose and turns about the beam to one side or the other after a move"""

    name, unit, typical, largest, random = 'loose_detector', 'rad', 0.01, 1.0, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._state = states(rng)

    def after_light(self, moment: Moment) -> None:
        angle = self.size * self._state[moment.arrival % len(self._state)]
        x, y = moment.spot.T
        moment.spot = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], axis=1)


class CrossReversal(Outside):
    """when one axis reverses it pushes another aside"""

    name, typical, largest = 'cross_reversal', 1e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._pushed = _two(rng)
        self.facts = {'axis': self._axis, 'pushed': self._pushed}

    def before_pose(self, moment: Moment) -> None:
        push = 0.5 * self.size * moment.approach[:, self._axis]
        moment.shift = moment.shift + push[:, None] * np.eye(3)[self._pushed]


class SinkingAxis(Outside):
    """an axis that rests sinks a little with each move of another, until it moves itself"""

    name, typical, largest = 'sinking_axis', 1e-6, 3e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._fall = int(rng.integers(3)), float(rng.uniform(0.5, 1.0))
        self.facts = {'axis': self._axis}

    def before_pose(self, moment: Moment) -> None:
        rested = np.where(moment.moved < 3, (moment.moved - self._axis) % 3, 0)
        sunk = self.size * rested**self._fall
        moment.position = moment.position - sunk[:, None] * np.eye(3)[self._axis]


class LostBit(Outside):
    """one bit of the detector's converter never comes on"""

    name, typical, largest = 'lost_bit', 5e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._channel = int(rng.integers(2))
        self.facts = {'channel': self._channel}

    def after_light(self, moment: Moment) -> None:
        on = np.floor(moment.spot[:, self._channel] / self.size) % 2.0
        moment.spot = moment.spot - self.size * on[:, None] * np.eye(2)[self._channel]


class ChipOnGuideway(Outside):
    """a chip falls on a guideway: from then on the carriage is lifted in one place"""

    name, typical, largest = 'chip_on_guideway', 2e-6, 1e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._across = _two(rng)
        self._place, self._width = rng.uniform(0.1, 0.9), rng.uniform(0.05, 0.12)
        self._from = stage.span_s * rng.uniform(0.15, 0.8)
        self.facts = {'axis': self._axis, 'across': self._across, 'place': self._place, 'from_s': self._from}

    def before_pose(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        lifted = self.size * np.exp(-0.5 * ((place - self._place) / self._width) ** 2) \
            * (moment.seconds >= self._from)
        moment.shift = moment.shift + lifted[:, None] * np.eye(3)[self._across]


class TiltingFloor(Outside):
    """the floor tilts the laser as the table moves away"""

    name, unit, typical, largest = 'tilting_floor', 'rad', 3e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._vector, self._power = int(rng.integers(2)), direction(rng, 2), float(rng.uniform(1.3, 2.5))
        self.facts = {'axis': self._axis}

    def before_light(self, moment: Moment) -> None:
        place = place_of(self.stage, moment, self._axis)
        moment.laser = moment.laser + self.size * (np.clip(place, 0.0, None) ** self._power)[:, None] * self._vector


CELLS = (ScrewWarmMiddle, GuidewayTwists, TwoFacedGuideway, Afterglow, WarmLayers, GhostReflection, TiltFringes,
          LooseDetector, CrossReversal, SinkingAxis, LostBit, ChipOnGuideway, TiltingFloor)
