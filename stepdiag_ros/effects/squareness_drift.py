"""The angle between two axes changes during the log.

A column or a bridge that warms up on one side leans: the squareness errors are not the same at the end
as at the beginning.  What changes is a shift that grows with one axis's position and with time.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size, drift_profiles, each_alone, follow, saturating
from stepdiag_ros.effects.timeforms import time_profiles
from stepdiag_ros.model.machine import CURVES, SQUARENESS, SQUARENESS_SHIFT


class SquarenessDrift(Effect):
    name = 'squareness_drift'
    short = 'Squareness changes during the log'
    needs_times = True
    title = 'The angle between two axes changes while the log is taken.'
    parameters = (Parameter('amp', 'rad', -5e-5, 5e-5, 3, 'change of EC0Y, EB0Z, EA0Z reached in the end'),
                  Parameter('tau', 's', 100.0, 5000.0, meaning='time constant'))
    course_of = ('amp',)
    sources = ('ISO 230-1:2012, 3.6 squareness', 'ISO 230-3')
    remedy = 'Warm the machine up, shield the column from sun and draught, measure faster.'
    signature = "Sideways shift that grows with an axis's position and with time."
    neighbours = ('scale_thermal_expansion shifts along the axis, not across; structural_thermal_drift does '
                  'not depend on position.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'amp': drawn_size(rng, 1e-6, 5e-5, 3),
                'tau': float(np.exp(rng.uniform(np.log(200.0), np.log(4000.0))))}

    def before_pose(self, moment: Moment) -> None:
        angles = self.now(moment.seconds, saturating(moment.seconds, self.tau)[:, None] * self.amp)
        for name, angle in zip(SQUARENESS, angles.T, strict=True):
            axis, per_metre = SQUARENESS_SHIFT[name]
            moment.shift = moment.shift + (angle * moment.commanded[:, axis])[:, None] * per_metre

    def appearance(self, view: StopView) -> list[Form]:
        signature = np.stack([self._column(view, name) for name in SQUARENESS])
        pace = time_profiles(view.elapsed, view.watches)
        return [follow(view, profile, signature, SQUARENESS, 1e-5, 'rad', begun=True)
                for profile in drift_profiles(view)] \
            + each_alone(view, pace, signature, SQUARENESS, 1e-5, 'rad', begun=True)

    @staticmethod
    def _column(view: StopView, name: str) -> np.ndarray:
        axis, per_metre = SQUARENESS_SHIFT[name]
        along = int(np.flatnonzero(per_metre)[0])
        motion = view.by_motion[CURVES.index(f'E{"XYZ"[along]}{"XYZ"[axis]}')]
        return per_metre[along] * view.commanded[:, [axis]] * motion

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        return fitted.profile(np.stack([self._column(fitted.view, name) for name in SQUARENESS]))
