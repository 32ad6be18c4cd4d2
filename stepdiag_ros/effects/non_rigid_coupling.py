"""An axis's error motion depends on where another axis stands.

A slide that runs out bends the beam that carries it: the error motion of axis ``a`` then depends on the
position of axis ``b`` too.  In the simplest case it is the product of both positions; what depends on
one of them alone is an ordinary error curve of that axis, or next to it, and is absorbed.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from stepdiag_ros.effects.adoption import Fitted
from stepdiag_ros.effects.base import Effect, Form, Moment, Parameter, StopView
from stepdiag_ros.effects.patterns import Drawn, drawn_size
from stepdiag_ros.model.machine import AXES, CURVES, carried

SHIFT, TURN = 5e-6, 1e-5
"""Typical sizes with both axes at their ends [m], [rad]."""


class NonRigidCoupling(Effect):
    name = 'non_rigid_coupling'
    short = 'Machine bends with the position of another axis'
    title = 'The machine bends: an error of one axis depends on where another axis stands.'
    parameters = (Parameter('motion', '1', 0.0, 17.0, meaning='which error motion: EXX … ECZ, or its number'),
                  Parameter('by', '1', 0.0, 2.0, meaning='on which other axis it depends: X, Y, Z, or its number'),
                  Parameter('amp', 'm or rad', -5e-5, 5e-5, meaning='size with both axes at their ends'),
                  Parameter('power', '1', 1.0, 2.0, meaning='of the other axis\'s position'),
                  Parameter('bend', '1', -1.0, 1.0, 2, 'share of it that grows with the square of the own axis\'s '
                            'position besides, and of the other\'s', detail=True))
    sources = ('Schwenke et al. 2008, CIRP Annals 57, 660, non-rigid behaviour', 'ISO 230-1:2012, 3.1')
    remedy = ('Compensate in the volume with a grid instead of axis by axis; look for overhanging slides '
              'and weak guideways.')
    signature = 'Grows with the product of two axes\' positions, the same at every time and direction.'
    neighbours = ('squareness_drift grows with one axis\'s position and time; mirror_curvature follows the '
                  'strike point and is also in the spot.')

    def __init__(self, **values: object):
        number = {'motion': CURVES, 'by': tuple(AXES)}
        for name, known in number.items():
            given = values.get(name, 0 if name == 'motion' else 1)
            if isinstance(given, str):
                if given not in known:
                    raise ValueError(f'{self.name}: {name} is {given!r}; known are {", ".join(known)}')
                given = known.index(given)
            values[name] = given
        super().__init__(**({'power': 1.0} | values))
        self.axis = round(self.motion) // 6
        if round(self.by) == self.axis:
            raise ValueError(f'{self.name}: {CURVES[round(self.motion)]} cannot depend on its own axis once more; '
                             'name another axis in "by"')

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Drawn:
        motion = int(rng.integers(18))
        by = int(rng.choice([b for b in range(3) if b != motion // 6]))
        turning = motion % 6 > 2
        size = drawn_size(rng, 2e-6, 8e-5) if turning else drawn_size(rng, 1e-6, 3e-5)
        return {'motion': CURVES[motion], 'by': AXES[by], 'amp': size,
                'power': float(rng.choice([1.0, 2.0]))}

    def before_pose(self, moment: Moment) -> None:
        machine = moment.description.machine
        motion, by = round(self.motion), round(self.by)
        share = moment.commanded / np.array(machine.volume)
        # Rounding may leave a start corner a hair below zero.
        own, other = share[:, self.axis], np.maximum(share[:, by], 0.0)
        size = self.amp * own * (other ** self.power + other * (self.bend[0] * own + self.bend[1] * other))
        shifts, turns = np.zeros((2, 3, len(size), 3))
        (turns if motion % 6 > 2 else shifts)[self.axis, :, motion % 3] = size
        moment.shift = moment.shift + carried(machine.chain, moment.commanded, shifts, turns, machine.tool)
        moment.turn = moment.turn + turns[self.axis]

    def appearance(self, view: StopView) -> list[Form]:
        share = view.commanded / np.array(view.description.machine.volume)
        forms = []
        for a, b in combinations(range(3), 2):
            product = share[:, a] * share[:, b]
            pair = f'{AXES[a]}·{AXES[b]}'
            columns, names, scales, mine = [], [], [], []
            for axis, other in ((a, b), (b, a)):
                for k in range(6):
                    # A shift by a product is the same motion whichever of the two axes it is given to.
                    if k < 3 and axis == b:
                        continue
                    motion = view.by_motion[6 * axis + k]
                    name = f'{CURVES[6 * axis + k]} by {AXES[other]}'
                    scale = SHIFT if k < 3 else TURN
                    column = product[:, None] * motion
                    bent = [column, column * share[:, [axis]], column * share[:, [other]]]
                    units = 'm' if k < 3 else 'rad'
                    mine.append(Form(f'{name}, product', column[None], (name,), np.full(1, scale), units))
                    mine.append(Form(f'{name}, bent', np.stack(bent),
                                     (name, f'{name} ({axis + 1}²)', f'{name} ({other + 1}²)'),
                                     np.full(3, scale), units))
                    columns.append(column)
                    names.append(name)
                    scales.append(scale)
            together = Form(f'all motions by {pair}', np.stack(columns), tuple(names), np.array(scales), 'm, rad')
            # A slide that runs out shifts and turns what carries it in more than the one motion that is seen.
            forms += [*(replace(form, beside=together) for form in mine), together]
        return forms

    def guess(self, fitted: Fitted) -> Mapping[str, object]:
        # One error motion by one other axis: the pair that comes nearest.
        view = fitted.nominal
        share = view.commanded / np.array(view.description.machine.volume)
        nearest, best = np.inf, {}
        for motion, name in enumerate(CURVES):
            own = motion // 6
            for other in (k for k in range(3) if k != own):
                for power in (1.0, 2.0):
                    product = share[:, own] * share[:, other]**power
                    size, missed = fitted.solve((product[:, None] * view.by_motion[motion])[None])
                    if missed < nearest - 1e-9:
                        nearest = missed
                        best = {'motion': name, 'by': 'XYZ'[other], 'amp': float(size[0]), 'power': power}
        return best
