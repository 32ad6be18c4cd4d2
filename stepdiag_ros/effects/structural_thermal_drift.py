"""The tool point drifts against the workpiece with time: the structure warms up or cools down.

A shift of the tool common to all positions, of any direction, slow against a run.  The reset at
each run's start takes away what came before it; the residual is the drift inside the runs.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import drift_profiles, each_alone, follow
from stepdiag_ros.effects.timeforms import time_profiles


class StructuralThermalDrift(Effect):
    name = 'structural_thermal_drift'
    short = "Machine's structure drifts"
    needs_times = True
    title = 'The tool point drifts against the workpiece as the machine structure changes temperature.'
    parameters = (Parameter('amp', 'm', -6e-5, 6e-5, 3, 'shift along X, Y, Z reached in the end'),
                  Parameter('tau', 's', 100.0, 5000.0, meaning='time constant'))
    course_of = ('amp',)
    sources = ('ISO 230-3', 'Mayr et al. 2012, Thermal issues in machine tools')
    remedy = 'Warm the machine up before measuring, or measure in a shorter time.'
    signature = 'A shift of the tool that follows the clock, the same at all positions.'
    neighbours = ('air_refraction_drift grows with the distance; squareness_drift and scale_thermal_expansion '
                  'with a position; drifts of mirror and beam show in the spot.')

    def before_pose(self, moment: Moment) -> None:
        grown = 1.0 - np.exp(-moment.seconds / self.tau)
        moment.shift = moment.shift + self.now(moment.seconds, grown[:, None] * self.amp)

    def appearance(self, view: StopView) -> list[Form]:
        pace, axes = time_profiles(view.elapsed, view.watches), ('X', 'Y', 'Z')
        return [follow(view, profile, view.by_shift, axes, 1e-5) for profile in drift_profiles(view)] \
            + each_alone(view, pace, view.by_shift, axes, 1e-5)

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        return fitted.profile(fitted.view.by_shift)
