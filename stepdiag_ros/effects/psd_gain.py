"""The detector's scale is wrong, alike or apart in x and y.

Read is ``(1 + g)`` times the spot.  The gain of a lateral-effect diode is set by its length and by
the amplifiers' resistors; a wrong length in the driver makes both axes wrong alike.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size
from stepdiag_ros.effects.timeforms import TimeProfile, drift_form, with_constant

SIZE = 0.02
"""Typical error of a gain."""
AGEING = 0.15
"""Typical change of the error during a log, as a share of it."""


class PsdGain(Effect):
    name = 'psd_gain'
    short = "Spot sensor's scale is wrong"
    title = "The position sensor's scale is wrong."
    parameters = (Parameter('x', '1', -0.1, 0.1, meaning='gain error along u'),
                  Parameter('y', '1', -0.1, 0.1, meaning='gain error along v'))
    course_of = ('x', 'y')
    course_begins = False
    sources = ('Dahlem et al. 2018, section 4', 'Andersson 2008, Position sensitive detectors')
    remedy = 'Calibrate the detector on a stage with known shifts, or enter its gain.'
    signature = 'The spot is too large or too small by a fixed share, wherever it lies.'
    neighbours = ('ambient_light shrinks the spot by a share that varies with time; psd_nonlinearity by a '
                  'share that grows with the spot; a constant share of light is indistinguishable from a gain.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        x = drawn_size(rng, 0.003, 0.1)
        return {'x': x, 'y': x if rng.random() < 0.5 else drawn_size(rng, 0.003, 0.1)}

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot * (1.0 + self.now(moment.seconds, np.array([[self.x, self.y]])))

    def appearance(self, view: StopView) -> list[Form]:
        spot, first = view.spot_model, view.beams
        columns = view.zeros(2)
        columns[0, :, first], columns[1, :, first + 1] = spot[:, 0], spot[:, 1]
        gain = np.eye(2, first + 2, first)
        forms = []
        for label, names, parts, gains in (
                ('alike in x and y', ('both',), columns.sum(axis=0, keepdims=True), gain.sum(axis=0, keepdims=True)),
                ('apart in x and y', ('x', 'y'), columns, gain)):
            scale = np.full(len(names), SIZE)
            forms += [Form(label, parts, names, scale, '1', gain=gains),
                      replace(drift_form(view, _ageing(view.time), parts, names, scale, label, '1'),
                              names=(*names, *(f'{name} ageing' for name in names)),
                              gain=np.concatenate([gains, np.zeros_like(gains)]))]
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        view = fitted.view
        columns = view.zeros(2)
        columns[0, :, view.beams], columns[1, :, view.beams + 1] = view.spot_model.T
        return dict(zip('xy', fitted.solve(columns)[0].tolist(), strict=True))


def _ageing(time: np.ndarray) -> TimeProfile:
    """A gain and a straight line about the middle of the log: amplifiers age and warm up, so that a small share of it
    changes in the course of the log, in a long dwell too."""
    span = max(float(np.ptp(time)), 1e-9)
    late = (time - time.mean()) / span
    return with_constant(TimeProfile('ageing', late[None], np.full((1, len(time)), 1.0 / span), {},
                                sizes=np.array([AGEING])))
