"""The reading jumps by a constant and stays there until the next reset.

The counter of an interferometer loses or wins fringes when the beam is interrupted, the mirror is too
fast or the signal too weak.  From one stop of one run on, the displacement is wrong by one amount.
"""

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.made import Made
from stepdiag_ros.effects.patterns import Drawn
from stepdiag_ros.guard import limits
from stepdiag_ros.model.machine import AXES

QUARTER = 3.825e-7
"""λ/4 at 1.53 µm [m]."""


WAVELENGTHS = (632.8e-9, 1.53e-6)
"""Of the lasers that interferometers count with [m]: helium-neon, telecom diode."""
KNOWN_WAVE = 5e-4
"""Share to which the unit of a count is known: 632.8 nm are 632.99 nm in vacuum, and a laser's stated wavelength is
rounded."""


def whole_fringes(jump: float, sigma: float) -> float:
    """Log evidence that a jump [m], known to ``sigma`` [m], is a whole number of counts, against any size.

    A counter loses λ/2 or λ/4 at a time, as light goes to and fro once or twice.  Its size has a comb for a
    density, ``q Σ N(jump; kq, σ²)`` against an even one, averaged over the units q that are in use: 0 where the size
    is known less well than to a count, ``ln(q / σ√2π)`` on a tooth, far below nothing between the teeth.
    """
    sigma = max(sigma, KNOWN_WAVE * abs(jump), 1e-12)
    logs = []
    for unit in (wave / part for wave in WAVELENGTHS for part in (2.0, 4.0)):
        reach = int(np.ceil(6.0 * sigma / unit)) + 1
        teeth = (round(jump / unit) + np.arange(-reach, reach + 1)) * unit
        terms = -0.5 * ((jump - teeth[teeth != 0.0]) / sigma) ** 2
        logs.append(np.log(unit / (sigma * np.sqrt(2.0 * np.pi))) + np.logaddexp.reduce(terms))
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def _slipped(shape: tuple[int, int], after: np.ndarray, beams: slice) -> np.ndarray:
    """One on the lengths of ``beams`` at the stops ``after``, else nothing: (1, n, c) of ``shape`` (n, c)."""
    column = np.zeros((1, *shape))
    column[0, after[:, None], np.arange(shape[1] - 2)[beams]] = 1.0
    return column


class CountSlip(Effect):
    name = 'count_slip'
    short = 'Laser lost count'
    repeatable = True
    title = 'The laser lost count once: from there to the next reset all lengths are wrong by one amount.'
    parameters = (Parameter('jump', 'm', -2e-5, 2e-5, limits.BEAMS,
                            'what is added from the slip on, of each beam; one number: of all'),
                  Parameter('arrival', '1', 1.0, 1e4, meaning='number of the move in which it happens'))
    course_of = ('jump',)
    sources = ('ISO 230-1:2012, laser interferometers: interruption of the beam',)
    remedy = ('Repeat the run; align for more signal, move more slowly, keep the beam free of chips and '
              'coolant.')
    signature = 'A step of the displacement at one stop of one run, constant to the end of that run.'
    neighbours = ('backlash steps at every turn of an axis; structural_thermal_drift bends slowly; a slip is '
                  'in one run only.')

    imitated_by = 'an axis that loses a step'

    def size_evidence(self, form: Form, values: np.ndarray, sigma: np.ndarray) -> float:
        """Whole counts or any size, as :func:`whole_fringes`."""
        return whole_fringes(float(values[0]), float(sigma[0]))

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        count = int(rng.integers(2, 60)) * int(rng.choice([-1, 1]))
        return {'jump': count * QUARTER, 'arrival': float(rng.integers(5, 120))}

    def after_light(self, moment: Moment) -> None:
        slipped = moment.arrival >= round(self.arrival)
        lost = self.now(moment.seconds, slipped[:, None] * self.jump)
        moment.length = moment.length + lost[:, :moment.length.shape[1]]

    def appearance(self, view: StopView) -> list[Form]:
        """One form for every stop at which it may have happened; beams together and each on its own."""
        forms = []
        which = [slice(None)] + ([slice(k, k + 1) for k in range(view.beams)] if view.beams > 1 else [])
        for run in np.unique(view.run):
            rows = np.flatnonzero(view.run == run)
            rows = rows[np.argsort(view.time[rows], kind='stable')]
            for place in range(1, len(rows)):
                stop = int(view.index[rows[place]])
                # What lasts as long as the axis that moved stays where it is may be an error of its arrival.
                moved = view.axis[rows[place:]]
                last = bool(moved[0] < len(AXES) and np.all(moved[1:] != moved[0]))
                for beams in which:
                    beam = '' if beams == slice(None) else f', beam {beams.start}'
                    column = Made((1, *view.reading.shape), _slipped, view.reading.shape, rows[place:], beams)
                    forms.append(Form(
                        f'{view.run_ids[run]} from stop {stop} on{beam}', column,
                        ('jump',), np.full(1, 1e-6), shape={'run': int(run), 'index': stop}, of_one_arrival=last))
        return forms
