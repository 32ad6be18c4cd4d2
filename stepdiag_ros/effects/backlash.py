"""The position reached depends on the direction of approach.

Play, friction and wind-up leave an axis behind on the side it came from: by half the reversal error,
against its last motion.  Reported is the whole reversal error B of each axis (ISO 230-2).
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView


class Backlash(Effect):
    name = 'backlash'
    title = 'An axis stops at a different place depending on the direction it came from.'
    parameters = (Parameter('B', 'm', 0.0, 3e-5, 3, 'reversal error of X, Y, Z'),)
    sources = ('ISO 230-2, reversal error B',)
    remedy = 'Check the ball screw, its bearings and the scale mount; set the reversal compensation.'

    def before_pose(self, moment: Moment) -> None:
        moment.position = moment.position - 0.5 * self.B * moment.approach

    def appearance(self, view: StopView) -> list[Form]:
        half = -0.5 * view.approach.T[:, :, None] * view.by_shift
        # Wind-up that grows along the travel: the reversal differs from end to end.
        share = view.commanded.T / np.array(view.description.machine.volume)[:, None] - 0.5
        both = np.concatenate([half, half * share[:, :, None]])
        names = ('X', 'Y', 'Z')
        return [Form('constant reversal', half, names, np.full(3, 3e-6)),
                Form('reversal changing along the axis', both,
                     names + tuple(f'{a} along travel' for a in names), np.full(6, 3e-6))]
