"""The reading jumps by a constant and stays there until the next reset.

The counter of an interferometer loses or wins fringes when the beam is interrupted, the mirror is too
fast or the signal too weak.  From one stop of one run on, the displacement is wrong by one amount.
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, on_lengths

QUARTER = 3.825e-7
"""λ/4 at 1.53 µm [m]."""


class CountSlip(Effect):
    name = 'count_slip'
    repeatable = True
    title = 'The laser lost count once: from there to the next reset all lengths are wrong by one amount.'
    parameters = (Parameter('jump', 'm', -2e-5, 2e-5, meaning='what is added from the slip on'),
                  Parameter('arrival', '1', 1.0, 200.0, meaning='number of the move in which it happens'))
    sources = ('ISO 230-1:2012, laser interferometers: interruption of the beam',)
    remedy = ('Repeat the run; align for more signal, move more slowly, keep the beam free of chips and '
              'coolant.')
    signature = 'A step of the displacement at one stop of one run, constant to the end of that run.'
    neighbours = ('backlash steps at every turn of an axis; structural_thermal_drift bends slowly; a slip is '
                  'in one run only.')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        count = int(rng.integers(2, 60)) * int(rng.choice([-1, 1]))
        return {'jump': count * QUARTER, 'arrival': float(rng.integers(5, 120))}

    def after_light(self, moment: Moment) -> None:
        slipped = moment.arrival >= round(self.arrival)
        moment.length = moment.length + self.jump * slipped[:, None]

    def appearance(self, view: StopView) -> list[Form]:
        """One form for every stop at which it may have happened; beams together and each on its own."""
        forms = []
        which = [slice(None)] + ([slice(k, k + 1) for k in range(view.beams)] if view.beams > 1 else [])
        for run in np.unique(view.run):
            rows = np.flatnonzero(view.run == run)
            rows = rows[np.argsort(view.time[rows], kind='stable')]
            for place in range(1, len(rows)):
                after = np.zeros(len(view.run))
                after[rows[place:]] = 1.0
                stop = int(view.index[rows[place]])
                for beams in which:
                    one = np.zeros((len(after), view.beams))
                    one[:, beams] = after[:, None]
                    beam = '' if beams == slice(None) else f', beam {beams.start}'
                    forms.append(Form(
                        f'{view.run_ids[run]} from stop {stop} on{beam}', on_lengths(view, one)[None],
                        ('jump',), np.full(1, 1e-6), shape={'run': int(run), 'index': stop}))
        return forms
