"""The source's beams slowly turn.

A collimator or its mount warms up and points elsewhere.  The length changes with the cosine, hardly,
and with where the beams strike a tilted mirror; the returning spot walks by about twice the path for
a mirror's turn but by what the geometry leaves of a beam's turn: derivatives of the model tell.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, at_once, drawn_size, drift_profiles, follow, saturating


class BeamPointingDrift(Effect):
    name = 'beam_pointing_drift'
    short = 'Laser beam turns slowly'
    needs_times = True
    title = 'The laser beam slowly changes its direction.'
    parameters = (Parameter('amp', 'rad', -1e-4, 1e-4, 2, 'turn about u, v reached in the end'),
                  Parameter('tau', 's', 100.0, 5000.0, meaning='time constant'))
    course_of = ('amp',)
    sources = ('Dahlem et al. 2018, section 4 (laser misalignment)',)
    remedy = 'Switch the laser on hours before, fix the base unit on a stiff stand, keep warm air away.'
    signature = 'Spot and length move as if the laser had been turned, more and more with time.'
    neighbours = ('mirror_mount_creep turns the mirror: its spot grows with the distance in another way and '
                  'it begins at each mounting; structural_thermal_drift moves lengths, hardly spots.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'amp': drawn_size(rng, 1e-6, 1e-4, 2),
                'tau': float(np.exp(rng.uniform(np.log(200.0), np.log(4000.0))))}

    def before_light(self, moment: Moment) -> None:
        moment.laser = moment.laser + self.now(moment.seconds, saturating(moment.seconds, self.tau)[:, None] * self.amp)

    def appearance(self, view: StopView) -> list[Form]:
        return at_once(view, view.by_laser, ('u', 'v'), 1e-5, 'rad') \
            + [follow(view, profile, view.by_laser, ('u', 'v'), 1e-5, 'rad') for profile in drift_profiles(view)]

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        return fitted.profile(fitted.view.by_laser)
