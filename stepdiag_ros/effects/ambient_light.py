"""Background light pulls the spot to the detector's centre, by an amount that varies with time.

The detector weighs all light that falls on it.  Light spread evenly has its centre in the middle: with a
share ``f`` of it in the sum the spot is read ``(1 − f)`` times where it is.  Sun and lamps change; the
sum signal rises with them, and where it is recorded steadily enough it tells how much.  A setup that was
measured with less light in the beam has as much background, so a larger share: this tells a constant
background from a wrong gain.
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, at_once, drift_profiles, follow, recorded
from stepdiag_ros.effects.timeforms import drift_form, with_constant

DIMMED = 0.7
"""A setup whose sum signal is a smaller share of the brightest's than this had less light in its beam: no
background that a detector is used with changes so much."""
NOTICEABLE = 2.0e-4
"""Relative standard deviation of the sum signal over the stops from which it may be background."""


class AmbientLight(Effect):
    name = 'ambient_light'
    short = 'Room light on the spot sensor'
    title = 'Changing room light on the position sensor pulls the spot towards its centre.'
    parameters = (Parameter('level', '1', 0.0, 0.2, meaning='background at the start, as a share of the beam'),
                  Parameter('swing', '1', 0.0, 0.2, meaning='most that comes and goes on top of it'),
                  Parameter('period', 's', 300.0, 7200.0, meaning='of coming and going'))
    course_of = ('level',)
    course_begins = False
    sources = ('Andersson 2008, Position sensitive detectors: background light',)
    remedy = 'Shade the detector, use an interference filter, or modulate the beam and detect in phase.'
    signature = 'The spot shrinks towards the centre by a share that follows the clock; the sum signal rises.'
    neighbours = 'psd_gain is a share that does not change; a constant background is indistinguishable from it.'

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        return {'level': float(rng.uniform(0.0, 0.05)),
                'swing': float(np.exp(rng.uniform(np.log(0.005), np.log(0.15)))),
                'period': float(np.exp(rng.uniform(np.log(400.0), np.log(7200.0))))}

    def after_light(self, moment: Moment) -> None:
        comes = self.level + self.swing * np.sin(np.pi * moment.seconds / self.period) ** 2
        background = self.now(moment.seconds, comes[:, None])[:, 0]
        moment.spot = moment.spot / (1.0 + background)[:, None]
        moment.intensity = moment.intensity * (1.0 + background)

    def appearance(self, view: StopView) -> list[Form]:
        pull = view.zeros(1)
        pull[0, :, view.beams:] = -view.spot_model
        beam = _beam(view)
        pull_of_light = pull / beam[:, None]
        forms = [follow(view, with_constant(profile), pull_of_light, ('share',), 0.02, '1')
                 for profile in drift_profiles(view)]
        switched = at_once(view, pull_of_light, ('share',), 0.02, '1')
        return self._from_intensity(view, pull, beam) + forms + switched

    @staticmethod
    def _from_intensity(view: StopView, pull: np.ndarray, beam: np.ndarray) -> list[Form]:
        """With the sum I = beam + background: f = (I − min)/I, and what was there at the minimum."""
        total = view.intensity
        if not np.isfinite(total).all() or total.min() <= 0.0 \
                or total.std() < NOTICEABLE * total.mean():
            return []
        least = np.empty_like(total)
        for level in np.unique(beam):
            least[beam == level] = total[beam == level].min()
        rising = recorded(view, ((total - least) / total)[None], 'as the sum signal says')
        always = recorded(view, np.stack([rising.values[0], least.max() / total]),
                          'as the sum signal says, and a constant')
        return [follow(view, rising, pull, ('trust',), 1.0, '1'),
                drift_form(view, always, pull, ('share',), np.ones(1), units='1')]


def _beam(view: StopView) -> np.ndarray:
    """Light in the beam at the stops (n,), 1 but in setups that were measured with less."""
    beam = np.ones(len(view.setup))
    if not np.isfinite(view.intensity).all() or view.intensity.min() <= 0.0:
        return beam
    numbers = np.unique(view.setup)
    level = np.array([np.median(view.intensity[view.setup == number]) for number in numbers])
    for number, share in zip(numbers, level / level.max(), strict=True):
        if share < DIMMED:
            beam[view.setup == number] = share
    return beam
