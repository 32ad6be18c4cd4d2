"""The detector is turned about the beam.

Read is the spot turned by a small angle ``θ``: ``(x − θ y, y + θ x)``, which the detector turned the
other way about ``d`` shows.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size, nearly_alike


class PsdRotation(Effect):
    name = 'psd_rotation'
    short = 'Spot sensor is mounted turned'
    title = 'The position sensor is mounted turned about the beam.'
    parameters = (Parameter('angle', 'rad', -0.1, 0.1, meaning='turn of the read spot from u towards v'),)
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
        c, s = np.cos(self.angle), np.sin(self.angle)
        moment.spot = moment.spot @ np.array([[c, s], [-s, c]])

    def appearance(self, view: StopView) -> list[Form]:
        spot = view.spot_model
        column = view.zeros(1)
        column[0, :, view.beams], column[0, :, view.beams + 1] = -spot[:, 1], spot[:, 0]
        return nearly_alike(view, column, ('angle',), 0.01, 'rad')

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        return {'angle': float(fitted.coefficients[0][0])}
