"""The detector's zero is not at zero angle.

The spot is read a constant away from where it is.  A constant angle would move it by ``2 L α``, growing
with the distance; a constant offset does not, which tells the two apart (Dahlem et al. 2018, 3a and 3b).
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import by_setup, nearly_alike


class PsdZeroOffset(Effect):
    name = 'psd_zero_offset'
    short = "Spot sensor's zero is off"
    title = "The position sensor's zero is not where the beam returns at zero angle."
    parameters = (Parameter('x', 'm', -2e-3, 2e-3, meaning='offset along u'),
                  Parameter('y', 'm', -2e-3, 2e-3, meaning='offset along v'))
    course_of = ('x', 'y')
    course_begins = False
    sources = ('Dahlem et al. 2018, section 4 and fig. 5 (3a, 3b)',)
    remedy = 'Set the detector to zero with a retro-reflector in the beam, or enter the offset.'
    signature = 'A constant added to the spot, in all setups, at all distances.'
    neighbours = 'a tilt of laser or mirror also shifts the spot, but more with growing distance.'

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot + self.now(moment.seconds, np.array([[self.x, self.y]]))

    def appearance(self, view: StopView) -> list[Form]:
        columns = view.zeros(2)
        columns[0, :, view.beams] = columns[1, :, view.beams + 1] = 1.0
        forms = nearly_alike(view, columns, ('x', 'y'), 3e-5)
        if len(np.unique(view.setup)) > 1:
            own, names = by_setup(view, columns, ('x', 'y'))
            forms.append(Form('another in each setup', own, names, np.full(len(names), 3e-5)))
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        columns, beams = fitted.nominal.zeros(2), fitted.nominal.beams
        columns[0, :, beams] = columns[1, :, beams + 1] = 1.0
        return dict(zip('xy', fitted.solve(columns)[0].tolist(), strict=True))
