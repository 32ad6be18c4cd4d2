"""More effects from outside the vocabulary, of wide worlds: what else was met at machines.

Mistakes of the set-up that no cell file says (a standoff, a cut beam), detectors that err otherwise than the
vocabulary's do, mounts and axes with two states, and what hangs on one thing and is read in another.  A gain that
flickers is not among them: a spot that is pulled to the middle by an amount that varies is ambient light.
"""

import numpy as np

from stepdiag_ros.blind.hidden import Stage, direction, walk_of
from stepdiag_ros.blind.outside import Outside
from stepdiag_ros.effects.base import Moment


def states(rng: np.random.Generator, count: int = 8000) -> np.ndarray:
    """Two states (count,), ±½, that change at random from one arrival to the next."""
    return np.cumsum(rng.random(count) < rng.uniform(0.05, 0.4)) % 2 - 0.5


class ClippedBeam(Outside):
    """the mirror's edge cuts the beam: light is lost, the spot moves away from the edge, the length a little"""

    name, typical, largest = 'clipped_beam', 5e-6, 2e-3

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._edge = rng.uniform(0.2, 0.7) * float(np.max(stage.travel / stage.cell.description.plan.steps))
        self._bearing = direction(rng, 2)
        self._light, self._leak = rng.uniform(0.1, 0.6), rng.normal(0.0, 0.1)
        self.facts = {'edge_m': self._edge, 'light': self._light}

    def after_light(self, moment: Moment) -> None:
        walk = walk_of(moment)
        beyond = walk @ self._bearing - self._edge
        cut = np.clip(beyond / self._edge, 0.0, 1.0)
        moment.spot = moment.spot - self.size * cut[:, None] * self._bearing
        moment.length = moment.length + self._leak * self.size * cut[:, None]
        moment.intensity = moment.intensity * (1.0 - self._light * cut)
        moment.quality = moment.quality * (1.0 - 0.5 * self._light * cut)


class OtherStandoff(Outside):
    """the base unit stands nearer or farther than the description says"""

    name, typical, largest = 'other_standoff', 3e-3, 0.2

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._sign = float(rng.choice([-1.0, 1.0]))

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot * np.maximum(1.0 + self._sign * self.size / moment.length[:, :1], 0.1)


class DetectorShear(Outside):
    """the detector's axes are not square to each other"""

    name, unit, typical, largest = 'detector_shear', '1', 0.02, 0.4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._row, self._sign = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]))

    def after_light(self, moment: Moment) -> None:
        spot = moment.spot.copy()
        spot[:, self._row] += self._sign * self.size * moment.spot[:, 1 - self._row]
        moment.spot = spot


class HalfPlaneGain(Outside):
    """one half of the detector has another gain"""

    name, unit, typical, largest = 'half_plane_gain', '1', 0.03, 0.6

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._column, self._sign = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]))

    def after_light(self, moment: Moment) -> None:
        spot = moment.spot.copy()
        spot[:, self._column] += self._sign * self.size * np.maximum(spot[:, self._column], 0.0)
        moment.spot = spot


class BistableAxis(Outside):
    """an axis has two rests, one beside the other, and comes to either"""

    name, typical, largest, random = 'bistable_axis', 2e-6, 1e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._axis, self._state = int(rng.integers(3)), states(rng)
        self.facts = {'axis': self._axis}

    def before_pose(self, moment: Moment) -> None:
        position = moment.position.copy()
        position[:, self._axis] += self.size * self._state[moment.arrival % len(self._state)]
        moment.position = position


class RattlingMirror(Outside):
    """the mirror is loose and leans to one side or the other after a move"""

    name, unit, typical, largest, random = 'rattling_mirror', 'rad', 3e-6, 5e-4, True

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector, self._state = direction(rng, 2), states(rng)

    def before_light(self, moment: Moment) -> None:
        moment.mirror = moment.mirror + self.size * self._state[moment.arrival % len(self._state), None] * self._vector


class WarmSpot(Outside):
    """a warm motor below the beams: where the path passes it, the reading is off"""

    name, typical, largest = 'warm_spot', 1e-6, 1e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._place = rng.uniform(0.2, 0.8, 3)
        self._width = rng.uniform(0.15, 0.35)

    def after_light(self, moment: Moment) -> None:
        away = moment.commanded / self.stage.travel - self._place
        near = np.exp(-0.5 * np.sum(away**2, axis=1) / self._width**2)
        moment.length = moment.length + self.size * near[:, None]


class Ringing(Outside):
    """the mirror's arm rings after each move and dies away"""

    name, unit, typical, largest, inside = 'ringing', 'rad', 2e-6, 3e-4, 'coherent'

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._hertz, self._tau = rng.uniform(2.0, 8.0), rng.uniform(0.1, 0.4)
        self._vector = direction(rng, 2)
        self.facts = {'frequency_Hz': self._hertz, 'tau_s': self._tau}

    def before_light(self, moment: Moment) -> None:
        since = np.maximum(moment.since_arrival, 0.0)
        swing = np.exp(-since / self._tau) * np.sin(2.0 * np.pi * self._hertz * since)
        moment.mirror = moment.mirror + self.size * swing[:, None] * self._vector


class SpotFollowsLength(Outside):
    """the length's electronics leak into the detector's, and saturate there"""

    name, typical, largest = 'spot_follows_length', 5e-6, 5e-4

    def __init__(self, stage: Stage, rng: np.random.Generator):
        super().__init__(stage, rng)
        self._vector = direction(rng, 2)
        self._knee = rng.uniform(0.4, 0.8) * float(np.linalg.norm(stage.travel))

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot + self.size * np.tanh(moment.length[:, :1] / self._knee) * self._vector


MORE = (ClippedBeam, OtherStandoff, DetectorShear, HalfPlaneGain, BistableAxis, RattlingMirror, WarmSpot, Ringing,
        SpotFollowsLength)
