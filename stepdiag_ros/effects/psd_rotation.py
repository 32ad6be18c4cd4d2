"""The detector is turned about the beam.

Read is the spot turned by an angle ``θ``, which the detector turned the other way about ``d`` shows: with
``t = tan ½θ`` to the spot ``(x, y)`` come ``sin θ`` times ``(−y − t x, x − t y)``.  Turned by 5° that is hardly more
than a shear; by 20° the spot is 6 % short besides.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size, nearly_alike

FAR = (0.22, 0.36)
"""Turns [rad] beyond the small ones: between and about them a spot is shortened by what one of them says to a twentieth
of the turn."""


class PsdRotation(Effect):
    name = 'psd_rotation'
    short = 'Spot sensor is mounted turned'
    title = 'The position sensor is mounted turned about the beam.'
    parameters = (Parameter('angle', 'rad', -0.5, 0.5, meaning='turn of the read spot from u towards v'),)
    course_of = ('angle',)
    course_begins = False
    sources = ('Dahlem et al. 2018, section 4',)
    remedy = ("Turn the detector until a turn of the mirror about u moves the spot along v only, or enter "
              'the angle.')
    signature = 'Each coordinate of the spot takes on a fixed share of the other, with opposite signs.'
    neighbours = ('psd_gain stretches, psd_nonlinearity bends; a real tilt about u does not follow the one '
                  'about v.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'angle': drawn_size(rng, 0.002, 0.1)}

    def after_light(self, moment: Moment) -> None:
        angle = self.now(moment.seconds, np.full((1, 1), self.angle))[:, 0]
        (x, y), c, s = moment.spot.T, np.cos(angle), np.sin(angle)
        moment.spot = np.stack([c * x - s * y, s * x + c * y], axis=1)

    def appearance(self, view: StopView) -> list[Form]:
        forms = []
        for turn in (0.0, *(side * far for far in FAR for side in (-1.0, 1.0))):
            words = f'turned by some {np.degrees(turn):+.0f}°, ' if turn else ''
            forms += [replace(form, label=words + form.label) for form in nearly_alike(
                view, _turned(view, turn), ('angle',), 0.01, 'rad')]
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        return {'angle': float(np.arcsin(np.clip(fitted.coefficients[0][0], -1.0, 1.0)))}


def _turned(view: StopView, angle: float) -> np.ndarray:
    """What the spot (1, n, c) takes on, per sine, near a turn by ``angle`` [rad]."""
    x, y = view.spot_model.T
    short = np.tan(0.5 * angle)
    column = view.zeros(1)
    column[0, :, view.beams], column[0, :, view.beams + 1] = -y - short * x, x - short * y
    return column
