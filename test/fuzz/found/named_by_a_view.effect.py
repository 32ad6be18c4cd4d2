"""Everything that an effect may do."""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import follow, saturating
from stepdiag_ros.effects.timeforms import time_profiles


class Own(Effect):
    name = 'own'
    title = 'The tool grows, the spot is pulled.'
    short = 'tool growth'
    parameters = (Parameter('amp', 'm', 0.0, 5e-5, meaning='growth'),
                  Parameter('tau', 's', 5.0, 300.0, meaning='time constant'))
    remedy = 'Wait.'

    def before_pose(self, moment: Moment) -> None:
        grown = self.amp * saturating(moment.seconds, self.tau)
        moment.shift = moment.shift - grown[:, None] * np.array([0.0, 0.0, 1.0])

    def before_light(self, moment: Moment) -> None:
        moment.laser = moment.laser + 1e-9 * moment.rng.normals('turn', 0, len(moment.seconds), 2)

    def after_light(self, moment: Moment) -> None:
        moment.spot = moment.spot * 1.0

    def appearance(self, view: StopView) -> list[Form]:
        along_z = -view.by_shift[2:]
        return [follow(view, profile, along_z, (view,), 1e-5) for profile in time_profiles(view.elapsed)]
