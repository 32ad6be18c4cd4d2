"""The mirror's mount relaxes after mounting.

Glue, spring or magnet give way, fast at first, then slower: the mirror turns on the tool.  It begins anew
whenever the mirror is mounted for a setup, by another amount.  A turn ``α u + β v`` moves the spot by
``(−2Lβ, 2Lα)`` and the length by what the strike's lever makes of it.
"""

from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import (
    Drawn,
    by_setup,
    drawn_size,
    follow,
    power_law,
    relaxations,
    relaxing,
    saturating,
)
from stepdiag_ros.effects.timeforms import drift_form
from stepdiag_ros.model.description import path_of

BETWEEN_MOUNTINGS = 0.4
"""Typical difference of the amount from mounting to mounting, as a share of it."""
FASTEST_S = 20.0
"""Least time constant of a mount: what is over sooner is a mirror that jumped."""

LETS_GO = 1.8
"""Exponent of a mount that gives way faster and faster, tuned from half to twice of it: creep's third stage."""


class MirrorMountCreep(Effect):
    name = 'mirror_mount_creep'
    short = "Mirror's mount creeps"
    needs_times = True
    title = "The mirror's mount gives way slowly after mounting."
    parameters = (Parameter('amp', 'rad', -1e-4, 1e-4, 2, 'turn about u, v reached in the end'),
                  Parameter('tau', 's', FASTEST_S, 2000.0, meaning='time constant'),
                  Parameter('spread', '1', 0.0, 1.0,
                            meaning='standard deviation of the amount from mounting to mounting'))
    course_of = ('amp',)
    sources = ('Yoder, Mounting Optics in Optical Instruments, 2nd ed., ch. on adhesives',)
    remedy = 'Wait after mounting, clamp harder on three points, do not glue.'
    signature = 'Spot grows as 2 L times a turn that relaxes from the start of each setup.'
    neighbours = ('beam_pointing_drift turns the light, not the mirror; psd_zero_offset does not change; '
                  'the nominal misalignment does not relax.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'amp': drawn_size(rng, 1e-6, 1e-4, 2),
                'tau': float(np.exp(rng.uniform(np.log(30.0), np.log(1500.0)))),
                'spread': float(rng.choice([0.0, 0.3]))}

    def before_light(self, moment: Moment) -> None:
        amount = 1.0 + self.spread * moment.rng.normals(f'mounting/{moment.setup}', 0, 1, 2)[0]
        relaxed = saturating(moment.mount_seconds, self.tau)[:, None] * self.amp * amount
        moment.mirror = moment.mirror + self.now(moment.seconds, relaxed)

    def appearance(self, view: StopView) -> list[Form]:
        profiles = [*relaxations(view.mount_time, FASTEST_S), power_law(view.mount_time, LETS_GO)]
        forms = [follow(view, profile, view.by_mirror, ('u', 'v'), 1e-5, 'rad') for profile in profiles]
        if len(np.unique(view.setup)) > 1:
            own, names = by_setup(view, view.by_mirror, ('u', 'v'))
            forms += [follow(view, profile, own, names, 1e-5, 'rad', 'each mounting another amount')
                      for profile in profiles]
            # The same glue, clamped in much the same way.
            both, size = np.concatenate([view.by_mirror, own]), np.full(2 + len(names), 1e-5 * BETWEEN_MOUNTINGS)
            size[:2] = 1e-5
            forms += [drift_form(view, profile, both, ('u', 'v', *names), size,
                                 'each mounting nearly the same amount', 'rad')
                      for profile in (*profiles, relaxing(view.mount_time, FASTEST_S))]
            # A mount that stays on the tool while base unit and mirror's face are turned, but for a further run.
            since = np.where(_further(view), view.mount_time, view.elapsed)
            forms += [follow(view, profile, view.by_mirror, ('u', 'v'), 1e-5, 'rad', 'mounted once')
                      for profile in relaxations(since, FASTEST_S)]
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        sizes, tau = fitted.exponential(fitted.view.by_mirror, fitted.view.mount_time)
        return {'amp': sizes.tolist(), 'tau': tau, 'spread': 0.0}


def _further(view: StopView) -> np.ndarray:
    """Which stops (n,) are of a setup that came back: for that the mirror was mounted anew."""
    return np.array([path_of(name) != name for name in view.setup_names])[view.setup]
